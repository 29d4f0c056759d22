"""Axes of cost: their numbers are those of the functions they stand on, their errors those made."""

import dataclasses

import numpy as np
import pytest
import scipy.linalg as sla

import cellsys as cs
from cellsys.accuracy import CostRow
from cellsys.accuracy.cells import step_commands
from cellsys.errors import ParameterError
from tests.loop.systems import make


def chain(seed, samples=60, n=6):
    """A damped chain pulled by a heading that turns."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(0.2 * rng.standard_normal(samples - 1))
    commands = np.column_stack([np.cos(heading), np.sin(heading)])
    A = 0.9 * np.eye(2 * n) + 0.04 * (np.eye(2 * n, k=1) + np.eye(2 * n, k=-1))
    pull = np.ones((2, 2 * n)) * np.arange(2 * n)
    x = np.zeros((samples, 2 * n))
    for k in range(samples - 1):
        noise = 0.05 * rng.standard_normal(2 * n)
        x[k + 1] = A @ x[k] + commands[k] @ pull + noise
    return cs.RunData(x=x, commands=commands, label=f"run {seed}")


@pytest.fixture(scope="module")
def data():
    runs = [chain(seed) for seed in range(6)]
    return cs.snapshots(runs[:4], dt=5.0), cs.snapshots(runs[4:], dt=5.0)


def test_order_axis_has_the_numbers_of_the_comparison(data):
    found = cs.order_cost(*data, [2, 4], [cs.LeastSquares(), cs.Ridge()])
    known = cs.compare_reductors(*data, [2, 4], [cs.LeastSquares(), cs.Ridge()])
    for row, other in zip(found.rows, known.rows, strict=True):
        assert row.errors["held out"] == pytest.approx(other.error)
        assert row.errors["floor"] == pytest.approx(other.floor)
    assert found.baselines == pytest.approx(known.baselines)
    text = str(found)
    assert "mean motion" in text
    assert "LeastSquares m = 4" in text


def test_runs_axis_has_the_numbers_of_the_learning_curve(data):
    found = cs.runs_cost(*data, cs.Ridge(), 4, 12.0, [1, 4], draws=1)
    curve = cs.learning_curve(*data, cs.Ridge(), 4, [1, 4], draws=1)
    assert [r.seconds for r in found.rows] == [12.0, 48.0]
    assert [r.errors["held out"] for r in found.rows] == pytest.approx(list(curve.held_out))
    with pytest.raises(ParameterError, match="run_seconds"):
        cs.runs_cost(*data, cs.Ridge(), 4, 0.0)


def test_cheapest_row_is_the_fastest_that_meets_the_error():
    rows = (CostRow("a", 3.0, {"e": 0.01}), CostRow("b", 1.0, {"e": 0.1}), CostRow("c", 0.1, {}))
    axis = cs.CostAxis("made up", rows, baselines={"nothing": 1.0})
    assert axis.cheapest(0.2).setting == "b"
    assert axis.cheapest(0.05).setting == "a"
    assert axis.cheapest(1e-3) is None
    assert axis.table()[2] == ["c", "0.1", "-"]
    assert axis.table()[3] == ["nothing", "-", "1"]


def test_routes_of_coupling_solve_the_same_cells():
    loop, m = make(3, m=6, gain=0.2), 6
    V = sla.qr(np.random.default_rng(0).standard_normal((3 * m, m)), mode="economic")[0]
    model = dataclasses.replace(
        loop.model, V=V, n_states=3 * m, sensor=loop.sensor, z_start=loop.z0,
        blocks={"field": np.arange(m, 3 * m)},
    )  # fmt: skip
    t = np.arange(0.0, 41.0, 10.0)
    found = cs.coupling_cost(model, [1, 3], t, cs.Superposition(), tolerance=1e-8)
    names = [r.setting for r in found.rows]
    assert names == ["K = 1, exact", "K = 1, modal", "K = 3, exact", "K = 3, modal", "K = 3, dense"]
    # Local tolerance 1e-8 over a stable run of 40 s; the weight that is off adds 1e-13.
    assert max(r.errors["error"] for r in found.rows) < 1e-6
    without = cs.coupling_cost(model, [3], t, cs.Superposition(), dense_up_to=17)
    assert "K = 3, dense" not in [r.setting for r in without.rows]


@pytest.fixture(scope="module")
def scene():
    base = cs.load_scene("spreading")
    matrix = dataclasses.replace(base.matrix, inclusion=None, diameter=44.0, nodes=500)
    cell = dataclasses.replace(base.cells[0], position=(0.0, 0.0), radius=5.0)
    training = dataclasses.replace(base.training, duration=60.0)
    return dataclasses.replace(base, matrix=matrix, cells=(cell,), training=training, duration=60.0)


@pytest.mark.slow
def test_kinetics_beside_five_nanometres(scene):
    found = cs.kinetics_cost(scene, np.array([0.0, 2.0, 4.0]))
    assert [r.setting for r in found.rows] == ["clutch", "switching"]
    for row in found.rows:
        assert row.seconds > 0
        assert set(row.errors) == {"5 nm: cell1.position", "5 nm: matrix.displacement"}
        assert all(0 < e < np.inf for e in row.errors.values())
    less = {k: v for k, v in scene.effects.items() if k != "focal_adhesion"}
    with pytest.raises(ParameterError, match="focal_adhesion"):
        cs.kinetics_cost(dataclasses.replace(scene, effects=less), np.array([0.0, 1.0]))


def test_trained_cells_beside_the_full_order_run(scene, tmp_path):
    train = cs.turning_scenes(scene, 3, seed=101, scatter=3.0)
    ((one,),) = [s.cells for s in cs.turning_scenes(scene, 1, seed=5, scatter=0.0, label="alone")]
    alone = dataclasses.replace(train[0], name="alone", cells=(one,))
    runs = cs.run_ensemble([*train, alone], tmp_path, workers=1)
    known = cs.snapshots(runs[:3])
    model = cs.reduce(known, order=6, method=cs.Equivariant(folds=0, iterations=8))
    field = cs.GalerkinField(system=cs.build(alone), order=20, places=10)
    found = cs.cells_cost([model], field, alone, runs[3], {"full order": runs[3]}, repeats=1)
    reduced, full = found.rows
    assert reduced.setting == "6 latent variables"
    assert 0 < reduced.errors["cells"] < 1  # 1: nothing moves
    # What the row says is what a run through the public coupling says.
    t = runs[3].t[::2]
    amplitude, heading = step_commands(alone, t)
    cells = cs.CellsOnField(model=model, field=field).simulate(amplitude, heading, one.position)
    body = runs[3].block("cell1.position")[::2]
    missed = np.linalg.norm(model.nodes(cells.block("z")[:, 0]) - body)
    missed /= np.linalg.norm(body - body[0])
    assert reduced.errors["cells"] == pytest.approx(missed)
    assert full.setting == "full order (reference)"
    assert not full.errors
    assert full.seconds == runs[3].statistics["wall_time"]
    mute = cs.load_scene("spreading")
    with pytest.raises(ParameterError, match="no commanded heading"):
        step_commands(mute, t)
