"""How quickly the package and its command line start."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

from tests.loop.systems import make

ROOT = Path(__file__).resolve().parent.parent
HEAVY = ("control", "casadi", "matplotlib", "numba")
EXTRAS = ("pandas", "xarray", "vtk", "pyvista", "skimage", "shapely", "tifffile", "geff")


def seconds(*code: str) -> float:
    """Wall time of one Python process with these arguments, s."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, *code], cwd=ROOT, capture_output=True, text=True, check=False,
        env=environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return time.perf_counter() - began


def against_numpy(*code: str) -> tuple[float, float]:
    """Shortest of four wall times, s, of a process and of one that only imports numpy.

    They take turns, so that both have met the same load of the machine: what is compared is the
    work, wherever and beside whatever the tests run.
    """
    turns = [(seconds(*code), seconds("-c", "import numpy")) for _ in range(4)]
    return min(t for t, _ in turns), min(t for _, t in turns)


def test_import_is_light():
    """`import cellsys` loads no heavy library: 0.4 s where numpy takes 0.15 s, a third of that
    here, since numpy is not loaded either."""
    code = (
        "import sys, cellsys; import cellsys.io, cellsys.observe; "
        f"print([m for m in {EXTRAS!r} if m in sys.modules])"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()
    assert loaded == "[]", "an extra is loaded before anybody asks for it"
    code = f"import sys, cellsys; print([m for m in {HEAVY!r} if m in sys.modules])"
    loaded = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()
    assert loaded == "[]"
    took, numpy = against_numpy("-c", "import cellsys")
    assert took < 2.0 * numpy


def test_help_is_quick():
    """`cellsys --help`, exit code 0, in less than five imports of numpy (0.15 s on a machine that
    does nothing else, so 0.8 s there)."""
    done = subprocess.run(
        [sys.executable, "-m", "cellsys", "--help"],
        cwd=ROOT, capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for command in ("run", "reduce", "poles", "bode", "stability", "effects", "schema"):
        assert command in done.stdout
    took, numpy = against_numpy("-m", "cellsys", "--help")
    assert took < 5.0 * numpy
    # naive: a command line that loads what its commands may need
    heavy = "; ".join(f"import {name}" for name in HEAVY)
    assert seconds("-c", f"{heavy}; import matplotlib.pyplot, scipy.linalg") > 5.0 * numpy


def test_a_saved_model_is_asked_without_heavy_libraries(tmp_path):
    """`poles`, `bode` and `stability` need no python-control, which is half of their time, no
    compiled kernels and no matplotlib."""
    loop = make(planar=True)
    path = replace(loop.model, sensor=loop.sensor).save(tmp_path / "model.npz")
    for command in ("poles", "bode", "stability"):
        code = (
            f"import sys; sys.argv = ['cellsys', {command!r}, {str(path)!r}]\n"
            "import cellsys.cell.model\n"
            "from cellsys.cli import main\n"
            "try:\n    main()\nexcept SystemExit as end:\n    assert not end.code\n"
            f"print([m for m in {HEAVY!r} if m in sys.modules])"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
        )
        # bode runs the loop to where it is linearised, by CVODES of casadi
        assert done.stdout.splitlines()[-1] == ("['casadi']" if command == "bode" else "[]")
