"""The plant of equivariant cells by python-control against the nonlinear step of cells and field.

Independent of the plant: `CellsOnField.step`, fixed points of an exchange, one step after contact.
"""

import dataclasses
import tomllib

import control as ct
import matplotlib.pyplot as plt
import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import DimensionError, ParameterError
from cellsys.field import GalerkinField
from cellsys.samples.commands import harmonic_value
from tests.population.test_equivariant_cells import PAIR, PORT, STATES, cells, model
from tests.study.scenes import TINY

HEADINGS = np.array([0.3, 2.0])
POINTS = np.array([[0.0, 0.0], [3.0, 3.0]])


@pytest.fixture(scope="module")
def field():
    system = cs.build(cs.Scene.parse(tomllib.loads(TINY)))
    return GalerkinField(system=system, order=40, linear=True, places=20)


def riding(field, gamma=0.02):
    """One vertex, so that the plant has no clock, and a centroid that rides on the matrix."""
    m = model(gamma, vertices=1, field=field, sensor=False)
    weights = 0.3 * np.random.default_rng(5).standard_normal(PORT.n_hats)
    dynamics = dataclasses.replace(
        m.dynamics, riding=dataclasses.replace(m.dynamics.riding, R_y=weights)
    )
    return dataclasses.replace(m, dynamics=dynamics)


def start(K=2, seed=1):
    return np.column_stack([np.random.default_rng(seed).standard_normal((K, STATES)), PAIR])


def after(found, amplitude, heading):
    """[z, q, centroids] after one nonlinear step from `start`."""
    run = found.simulate(
        [0.0, 10.0], z0=start(), amplitude=[amplitude], heading=[heading], tolerance=1e-13
    )
    z, q = run.block("z")[1], run.block("field.modes")[1]
    return np.concatenate([z[:, :-2].ravel(), q, z[:, -2:].ravel()]), run


def flat_start(order):
    z = start()
    return np.concatenate([z[:, :-2].ravel(), np.zeros(order), z[:, -2:].ravel()])


@pytest.mark.parametrize("gamma", [0.0, 0.02])
def test_in_harmonics_a_step_is_exact(field, gamma):
    m = riding(field, gamma)
    found = cells(m, field, PAIR, headings=HEADINGS)
    plant = found.plant(commands="harmonics", points=POINTS)
    amplitude, heading = np.array([1.2, 0.7]), np.array([0.5, 1.8])
    known, run = after(found, amplitude, heading)
    u = [harmonic_value(n, amplitude[k], heading[k]) for k in range(2) for n in m.input_names]
    u = np.array([*u, *np.zeros(6), 1.0])
    step = ct.forced_response(plant, [0.0, 10.0], np.column_stack([u, u]), flat_start(field.order))
    # Loads settle to 1e-13; the rest are two orders of the same sums.
    assert np.abs(step.states[:, 1] - known).max() < 1e-11 * np.abs(known).max()
    y = dict(zip(plant.output_labels, step.outputs[:, 1], strict=True))
    z = run.block("z")[1]
    assert abs(y["cell2_y"] - z[1, -1]) < 1e-11
    assert abs(y["cell1_p_x"] - np.cos(0.5)) < 1e-14
    assert abs(y["cell2_p_y"] - np.sin(1.8)) < 1e-14
    line = (PAIR[1] - PAIR[0]) / np.linalg.norm(PAIR[1] - PAIR[0])
    assert abs(y["gap1_2"] - line @ (z[1, -2:] - z[0, -2:])) < 1e-11
    near = field.surface[np.argmin(np.linalg.norm(field.nodes[field.surface][:, :2], axis=1))]
    moved = found.matrix_displacement(run)[1][near]
    np.testing.assert_allclose([y[f"matrix1_{a}"] for a in "xyz"], moved, atol=1e-12)


def test_in_heading_and_amplitude_it_is_the_slope(field):
    found = cells(riding(field), field, PAIR, headings=HEADINGS)
    plant = found.plant()
    assert plant.input_labels == [
        *("cell1_amplitude", "cell1_heading", "cell2_amplitude", "cell2_heading"),
        "one",
    ]
    at = plant.A @ flat_start(field.order) + plant.B @ np.array([1.0, 0.3, 1.0, 2.0, 1.0])
    known, _ = after(found, np.ones(2), HEADINGS)
    assert np.abs(at - known).max() < 1e-11
    h = 1e-4
    for k in range(2):
        for column, (da, dh) in enumerate(((h, 0.0), (0.0, h))):
            more, turn = np.zeros(2), np.zeros(2)
            more[k], turn[k] = da, dh
            ends = [after(found, 1 + s * more, HEADINGS + s * turn)[0] for s in (1, -1)]
            slope = (ends[0] - ends[1]) / (2 * h)
            # central differences: h^2 q^3 / 6 of charge 5
            assert np.abs(slope - plant.B[:, 2 * k + column]).max() < 1e-6
    p = plant.D @ np.array([1.0, 0.3, 1.0, 2.0, 1.0])
    np.testing.assert_allclose(p[[2, 3]], [np.cos(0.3), np.sin(0.3)], atol=1e-15)
    assert plant.output_labels[2:4] == ["cell1_p_x", "cell1_p_y"]


def test_a_load_moves_the_matrix_as_the_field_does(field):
    found = cells(riding(field, gamma=0.0), field, PAIR)  # cells that do not feel it
    plant = found.plant(points=POINTS, offset="drop")
    assert "one" not in plant.input_labels
    near = field.surface[np.argmin(np.linalg.norm(field.nodes[field.surface][:, :2], axis=1))]
    nodal = np.zeros((len(field.nodes), 3))
    nodal[near, 1] = 1.0
    q, _ = field.step(np.zeros(field.order), field.project(nodal), 10.0, memory=field.memory())
    column = plant.B[2 * STATES : 2 * STATES + field.order, plant.input_labels.index("load1_y")]
    # a step of the field ends at its own tolerance, 1e-3 of the load
    assert np.abs(column - q).max() < 1e-3 * np.abs(q).max()
    y = (plant.C @ plant.B)[plant.output_labels.index("matrix1_y"), 5]
    assert y > 0


@pytest.mark.parametrize("K", [2, 10, pytest.param(50, marks=pytest.mark.slow)])
def test_lqr_and_bode(field, K):
    angle = np.linspace(0.0, 2 * np.pi, K, endpoint=False)
    places = 12.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    small = field.truncated(20)
    found = cells(riding(small), small, places, headings=angle)
    plant = found.plant(points=POINTS[:1], offset="drop")
    assert plant.dt == 10.0
    assert plant.nstates == K * (STATES + 2) + 20
    if K < 10:
        gain, _, closed = ct.lqr(plant, np.eye(plant.nstates), np.eye(plant.ninputs))
        assert gain.shape == (plant.ninputs, plant.nstates)
        assert np.abs(closed).max() < 1  # the centroids too
    omega = np.geomspace(1e-4, 0.1, 5)
    drawn = ct.frequency_response(plant[f"cell{K}_x", "cell1_heading"], omega)
    ours = cs.frequency_response(plant, omega).response
    row, column = plant.output_labels.index(f"cell{K}_x"), plant.input_labels.index("cell1_heading")
    known = np.squeeze(np.asarray(drawn.complex))
    assert np.abs(ours[row, column] - known).max() < 1e-7 * np.abs(known).max()
    # On a ring a cell has two neighbours, as near but for rounding: whichever it took.
    gap = next(name for name in plant.output_labels if name.startswith("gap1_"))
    lines = ct.bode_plot(plant[gap, "load1_x"], omega).lines
    plt.close("all")
    assert lines.size == 2  # gain and phase


@pytest.mark.parametrize("reads", ["state", "field"])
def test_the_diagram_is_the_run(field, reads):
    m = model(0.02, field=field)
    more = {"sensor": cs.FieldSensor()} if reads == "field" else {}
    found = cells(m, field, PAIR, headings=HEADINGS, controller=cs.PolarityLaw(), **more)
    t = m.dt * np.arange(9)
    diagram = found.interconnect(tolerance=1e-12)
    run = found.simulate(t, tolerance=1e-12)
    got = ct.input_output_response(diagram, t, 0, found.diagram_start).outputs.T
    n = run.x.shape[1] - 6
    # The exchange ends at 1e-12 of the loads, and turning back and forth rounds.
    assert np.abs(got[:, :n] - run.x[:, :n]).max() < 1e-8
    assert np.abs(got[:, n : n + 6] - run.p.reshape(9, 6)).max() < 1e-8
    assert np.abs(got[:, n + 6 :] - run.d.reshape(9, 6)).max() < 1e-8
    assert np.abs(run.p[-1] - run.p[0]).max() > 1e-2
    assert {"cell2_z[0]", "field_q[0]", "cell1_p_x"} <= set(diagram.output_labels)


def test_refusals(field):
    found = cells(riding(field), field, PAIR)
    for given, words in (
        ({"commands": "angle"}, "commands"),
        ({"offset": "shifted"}, "offset"),
    ):
        with pytest.raises(ParameterError, match=words):
            found.plant(**given)
    with pytest.raises(ParameterError, match="lack"):
        found.interconnect()
    with pytest.raises(DimensionError, match="points"):
        found.plant(points=[[0.0, np.nan]])
