"""What a run needs: estimates beside measured peaks, and refusals in time."""

import dataclasses
import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

import cellsys
from cellsys.errors import MemoryBudgetError
from cellsys.scene import Scene, build, load_scene, run_ensemble, run_scene
from cellsys.scene import memory as room
from cellsys.scene.memory import memory_need
from cellsys.store import memory as limits
from cellsys.store.memory import Room
from tests.mechanics.small_scenes import tiny

ROOT = Path(cellsys.__file__).parents[1]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
LAWS = {
    "drag": {}, "membrane_elasticity": {}, "volume": {}, "cortical_tension": {},
}  # fmt: skip
ON_MATRIX = {
    "matrix_elasticity": {"law": "buckling"}, "foundation": {},
    "focal_adhesion": {"kinetics": "clutch"}, "lamellipodium": {"force": "600 pN"},
    "substrate_contact": {}, "stiffness_sensing": {}, "polarity": {"kappa": "1/60 1/s"},
}  # fmt: skip


def spread_out(cells, nodes, samples=4):
    """A square of cells on a disc of so many nodes (none: in the open), four steps."""
    across = math.ceil(math.sqrt(cells)) if cells else 1
    table = {
        "name": "m", "duration": f"{0.5 * samples} s", "sample": "0.5 s", "step": "0.5 s",
        "seed": 1,
        "effects": dict(LAWS) if cells else {"drag": {}},
    }  # fmt: skip
    if nodes:
        wide = max(60.0 * math.sqrt(nodes / 2000.0), 36.0 * (math.sqrt(cells) + 2.0))
        table["matrix"] = {"diameter": f"{wide} um", "nodes": nodes, "modulus": "5 kPa"}
        own = ON_MATRIX if cells else {k: ON_MATRIX[k] for k in ("matrix_elasticity", "foundation")}
        table["effects"] |= own
    if cells:
        middle = (across - 1) / 2
        places = [(18 * (k % across - middle), 18 * (k // across - middle)) for k in range(cells)]
        table["cells"] = [
            {"position": [f"{x} um", f"{y} um"], "polarity": f"{37 * k % 360} deg"}
            for k, (x, y) in enumerate(places)
        ]
    return table


CHAIN = {
    "name": "c", "duration": "2 s", "sample": "0.1 s",
    "matrix": {"kind": "chain", "nodes": 12_000},
    "cells": [{"polarity": "0 deg", "trail_node": 4, "lead_node": 8}],
}  # fmt: skip
SCENES = {
    "one cell, 2000 nodes": spread_out(1, 2000),
    "one cell, 2000 nodes, 400 samples": spread_out(1, 2000, 400),
    "20 000 nodes": spread_out(0, 20_000),
    "50 cells, 5000 nodes": spread_out(50, 5000),
    "200 cells, 5000 nodes": spread_out(200, 5000),
    "200 cells in the open": spread_out(200, 0),
    "a chain of 12 000 nodes": CHAIN,
}
PEAK = """
import json, re, sys
from cellsys.scene import Scene, run_scene
from cellsys.scene.memory import memory_need
scene = Scene.parse(json.loads(sys.stdin.read()))
run_scene(scene)
# ru_maxrss would be that of the process that started this one, if it was larger.
peak = 1024.0 * float(re.search(r"VmHWM:\\s+(\\d+) kB", open("/proc/self/status").read())[1])
print(peak, memory_need(scene, on_disk=False).resident)
"""


def peak_of(scene):
    """Measured peak and estimate, bytes."""
    done = subprocess.run(
        [sys.executable, "-c", PEAK], input=json.dumps(scene), text=True,
        capture_output=True, check=True, cwd=ROOT, env=ENVIRONMENT, timeout=600,
    )  # fmt: skip
    return tuple(map(float, done.stdout.split()))


@pytest.fixture(scope="module")
def compiled():
    """Every loop compiled by scenes of every kind: compiling takes memory too."""
    for scene in (spread_out(2, 300), spread_out(2, 0), spread_out(0, 300), CHAIN):
        peak_of(scene)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_the_estimate_is_within_0_7_to_1_5_of_the_measured_peak(compiled, name):
    peak, need = peak_of(SCENES[name])
    print(f"{name}: peak {peak / 1e6:.0f} MB, estimate {need / 1e6:.0f} MB, {need / peak:.2f}")
    assert 0.7 < need / peak < 1.5


def test_what_the_estimate_grows_with():
    """By its parts: cells and nodes, their product with adhesions, the square with volumes."""

    def need(cells, nodes):
        return memory_need(Scene.parse(spread_out(cells, nodes))).resident - room.PROGRAM

    assert need(0, 4000) == pytest.approx(2 * need(0, 2000), rel=0.01)
    together = need(20, 8000) - need(20, 4000) - (need(1, 8000) - need(1, 4000))
    # naive, as before: matrix and cells alone, nothing for both
    assert together > 0.5 * 19 * 4000 * 720
    assert need(64, 0) > 2.5 * need(32, 0)


@pytest.mark.skipif(sys.platform != "linux", reason="limits are enforced on Linux")
def test_twenty_thousand_nodes_under_a_limit_of_addresses_are_refused_at_once(tmp_path):
    text = (ROOT / "examples" / "spreading.toml").read_text()
    (tmp_path / "s.toml").write_text(
        text.replace('diameter = "60 um"', 'diameter = "190 um"\nnodes = 20000')
    )
    began = time.monotonic()
    done = subprocess.run(
        ["bash", "-c", f"ulimit -v 1700000; {sys.executable} -m cellsys run s.toml -o out"],
        cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    assert "ulimit -v" in done.stderr
    assert "20000 nodes" in done.stderr or "runs map" in done.stderr
    assert time.monotonic() - began < 40.0  # it took for ever


def test_workers_are_counted_together(tmp_path, monkeypatch):
    """Each fits alone, two do not: refused before any begins, with a cure."""
    scene = Scene.parse(tiny("membrane_elasticity", cells=1))
    scenes = [scene, dataclasses.replace(scene, seed=9)]
    one = memory_need(scene).resident
    monkeypatch.setattr(limits, "memory_room", lambda: Room(1.5 * one, "a test"))
    with pytest.raises(MemoryBudgetError, match=r"^2 runs at a time.*use fewer workers"):
        run_ensemble(scenes, tmp_path, workers=2)
    assert list(tmp_path.iterdir()) == []


def test_runs_that_cannot_be_mapped_are_refused_before_they_are_made(tmp_path, monkeypatch):
    scene = Scene.parse(tiny("membrane_elasticity", cells=1))
    each = memory_need(scene).record
    monkeypatch.setattr(room, "mapping_room", lambda: Room(1.5 * each, "ulimit -v"))
    with pytest.raises(MemoryBudgetError, match=r"2 runs map .* of files .* \(ulimit -v\)"):
        run_ensemble([scene, dataclasses.replace(scene, seed=9)], tmp_path)
    assert list(tmp_path.iterdir()) == []
    run = run_scene(scene, tmp_path)
    held = sum(p.stat().st_size for p in tmp_path.glob("*/*.npy"))
    assert 0.7 < each / held < 1.5
    assert len(run) == len(scene.times)


def test_a_long_chain_is_refused_for_the_integrator_alone():
    """LSODA asks for a dense matrix; the system itself is small."""
    scene = load_scene(ROOT / "examples" / "crawler.toml")
    long = dataclasses.replace(scene, matrix=dataclasses.replace(scene.matrix, nodes=300_000))
    assert build(long).states.size > 300_000
    # naive: a MemoryError of numpy about an array nobody asked for
    with pytest.raises(MemoryBudgetError, match=r"chain of 300000 nodes needs .* the chain short"):
        run_scene(long)


def test_nodes_of_a_disc_without_a_number():
    scene = load_scene(ROOT / "examples" / "spreading.toml")
    assert scene.matrix.node_count == len(build(scene).matrix.position)
