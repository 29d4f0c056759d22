"""Process, runs: folders of finished runs with bytes, values, arrays and files changed."""

import json
import shutil
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cellsys.errors import FileFormatError
from cellsys.reduction import reduce
from cellsys.samples import snapshots
from cellsys.scene import Scene, run_scene
from cellsys.scene.ensemble import read_run
from cellsys.store import RunReader, RunWriter
from tests import naive
from tests.hard.damage import ARRAYS, ODD, bounded, forged, nothing_outside, npy
from tests.hard.stress import SEED, Case, Choice, Int, hold
from tests.mechanics.small_scenes import tiny

SHAPES = {"x": (40, 3), "eta": (39, 5)}


def a_damaged_run_folder_is_read_or_refused(seed, changes):
    """Bytes, JSON values and files of a finished run changed."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as name, nothing_outside(Path(name)) as folder:
        writer = RunWriter(folder / "run", SHAPES, {"scene": {"name": "a"}})
        writer.arrays["x"][:] = 1.0
        writer.finish({"statistics": {}, "events": []})
        files = sorted((folder / "run").iterdir())
        for _ in range(changes):
            path = files[int(rng.integers(len(files)))]
            data = bytearray(path.read_bytes()) or bytearray(b" ")
            match int(rng.integers(3)):
                case 0:
                    data[int(rng.integers(len(data)))] = int(rng.integers(256))
                case 1:
                    del data[int(rng.integers(len(data))) :]
                case 2:
                    data += bytes(rng.integers(0, 256, 20, dtype=np.uint8))
            path.write_bytes(bytes(data))
        reader = RunReader(folder / "run")
        assert reader.arrays["x"].shape == SHAPES["x"]
        with pytest.raises(FileFormatError):
            read_run(folder / "run")  # it is not a run of any scene


def test_a_run_that_names_arrays_elsewhere_is_refused(tmp_path):
    np.save(tmp_path / "secret.npy", np.arange(3.0))
    writer = RunWriter(tmp_path / "run", SHAPES, {})
    folder = writer.finish({})
    text = (folder / "run.json").read_text()
    table = json.loads(text)
    for outside in ("../secret", str(tmp_path / "secret")):
        table["shapes"] = {outside: [3]}
        (folder / "run.json").write_text(json.dumps(table))
        with pytest.raises(FileFormatError, match="outside its folder"):
            RunReader(folder)


@cache
def finished(kinetics):
    """Folder of a run of a small scene, as every study writes it; made once."""
    folder = Path(tempfile.mkdtemp(prefix="hard-run-")) / "run"
    table = tiny(
        "membrane_elasticity", "volume", "cortical_tension", "lamellipodium", "matrix_elasticity",
        "foundation", "focal_adhesion", cells=1, focal_adhesion={"kinetics": kinetics},
    )  # fmt: skip
    run_scene(Scene.parse(table | {"sample": "1 s"}), folder)
    return next(folder.iterdir())


def replaced(value, rng, odd):
    """A JSON value with one of its parts, anywhere, replaced by something odd."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        key = list(value)[int(rng.integers(len(value)))]
        return value | {key: replaced(value[key], rng, odd)}
    if isinstance(value, list) and value and rng.random() < 0.9:
        k = int(rng.integers(len(value)))
        return [*value[:k], replaced(value[k], rng, odd), *value[k + 1 :]]
    return odd[int(rng.integers(len(odd)))]


FORGED = tuple(forged(s) for s in ((10**12,), (10**9, 4), (2**62, 2**62), (-5,)))


def a_changed_run_is_read_or_refused(seed, changes, kinetics):
    """A real run with bytes, JSON values or arrays changed: learned from, or refused."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as name, nothing_outside(Path(name)) as folder:
        shutil.copytree(finished(kinetics), folder / "run")
        files = sorted(p for p in (folder / "run").iterdir() if p.is_file())
        for _ in range(changes):
            path = files[int(rng.integers(len(files)))]
            data = bytearray(path.read_bytes()) or bytearray(b" ")
            what = int(rng.integers(6))
            if what == 0:
                data[int(rng.integers(len(data)))] = int(rng.integers(256))
            elif what == 1:
                del data[int(rng.integers(len(data))) :]
            elif what == 2:
                data += bytes(rng.integers(0, 256, 20, dtype=np.uint8))
            elif path.suffix == ".npy":
                # as long as it was, and of another type; or something else altogether
                every = [npy(a) for a in ARRAYS] + list(FORGED)
                data = bytearray(every[int(rng.integers(len(every)))])
                if what == 3:
                    whole = np.load(finished(kinetics) / path.name)
                    data = bytearray(npy(whole.astype(rng.choice(["f4", "c16", "i8", ">f8"]))))
            else:
                try:
                    table = json.loads(path.read_text())
                except ValueError:
                    continue  # changed before
                text = json.dumps(replaced(table, rng, (*ODD, "1e400 um", 10**400, -5)))
                data = bytearray(text.encode())
            path.write_bytes(bytes(data))
        with bounded(0.5):
            run = read_run(folder / "run")
            model = reduce(snapshots([run]), order=3)
        assert np.all(np.isfinite(model.A))


def test_a_run_cut_short_is_refused(tmp_path):
    shutil.copytree(finished("clutch"), tmp_path / "run")
    path = tmp_path / "run" / "x.npy"
    rows, columns = np.load(path).shape
    path.write_bytes(path.read_bytes()[: -8 * columns * 3 - 5])
    with pytest.raises(FileFormatError):
        read_run(tmp_path / "run")
    # naive: as many rows as the length of the file allows, and no word
    assert len(naive.raw_rows(path, columns)) == rows - 4


CASES = (
    Case(
        "run folder damaged",
        a_damaged_run_folder_is_read_or_refused,
        {"changes": Int(1, 4), "seed": SEED},
    ),
    Case(
        "run file changed",
        a_changed_run_is_read_or_refused,
        {"changes": Int(1, 5), "kinetics": Choice("clutch", "switching"), "seed": SEED},
    ),
)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_random_instances(case):
    hold(case, 3)
