"""Loops as diagrams of python-control against their own runs; signals keep their names."""

import control as ct
import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import DataError, ParameterError
from cellsys.figures.diagram import block_diagram, shortened, wires
from tests.loop.systems import NAMES, make
from tests.population.systems import model as coupled_model
from tests.population.test_equivariant_cells import model as equivariant_model
from tests.population.test_integrators import ports

TIGHT = {"rtol": 1e-7, "atol": 1e-9, "method": "DOP853"}
METHOD = cs.DOP853(rtol=1e-8, atol=1e-10)
# Two integrators at 1e-7 or tighter, off by some ten times that over a run whose loop is stable.
NEAR = 1e-5


@pytest.mark.parametrize(
    "given", [{}, {"normalise": False}, {"names": ("cell1.amplitude", *NAMES)}]
)
def test_single_loop(given):
    loop, t = make(**given), np.linspace(0.0, 15.0, 4)
    diagram = loop.interconnect()
    found = ct.input_output_response(diagram, t, 0, loop.system.x0, solve_ivp_kwargs=TIGHT)
    run = loop.simulate(t, METHOD)
    assert np.abs(found.states.T - run.x).max() < NEAR
    rows = [diagram.output_labels.index(f"d_{a}") for a in "xyz"]
    assert np.abs(found.outputs[rows].T - run.d[:, 0]).max() < NEAR
    assert diagram.ninputs == 0
    assert diagram.output_labels[:2] == ["z[0]", "z[1]"]
    if given:
        return
    faster = ct.input_output_response(
        diagram, t, 0, loop.system.x0, params={"kappa": 0.1}, solve_ivp_kwargs=TIGHT
    )
    again = make(kappa=0.1).simulate(t, METHOD)
    assert np.abs(faster.states.T - again.x).max() < NEAR
    assert np.abs(faster.states.T - run.x).max() > 1e-2  # the gain is heard


def test_scheduled_loop_step_for_step():
    loop = cs.closed_loop(equivariant_model())
    t = loop.model.dt * np.arange(11)
    found = ct.input_output_response(loop.interconnect(), t, 0, loop.system.x0)
    run = loop.simulate(t)
    # The same operations in the same order, but for python-control's sums of one signal.
    assert np.abs(found.states.T - run.x).max() < 1e-12
    assert np.abs(found.outputs[-3:].T - run.d[:, 0]).max() < 1e-12
    drive = np.random.default_rng(0).uniform(0.5, 1.5, 10)
    opened = loop.interconnect(amplitude=None)
    assert opened.input_labels == ["amplitude"]
    pushed = ct.input_output_response(opened, t, np.append(drive, 1.0), loop.system.x0)
    assert np.abs(pushed.states.T - loop.simulate(t, amplitude=drive).x).max() < 1e-12
    with pytest.raises(DataError, match="amplitude"):
        loop.interconnect(amplitude=np.nan)


@pytest.mark.parametrize("form", [cs.Superposition(), cs.Feedback()], ids=lambda f: f.name)
@pytest.mark.parametrize("weights", ["alike", "symmetric", "directed"])
def test_coupled_loops(form, weights):
    w = np.random.default_rng(0).uniform(0.0, 0.2, (3, 3))
    np.fill_diagonal(w, 0.0)
    graph = {"alike": None, "symmetric": 0.5 * (w + w.T), "directed": w}[weights]
    cells = cs.couple(
        coupled_model(m=3, steered=True, centred=True),
        3,
        form,
        graph=graph,
        headings=[0.0, 1.0, 2.0],
    )
    diagram, t = cells.interconnect(), np.linspace(0.0, 20.0, 5)
    found = ct.input_output_response(diagram, t, 0, cells.system.x0, solve_ivp_kwargs=TIGHT)
    run = cells.simulate(t, METHOD)
    size = np.abs(run.x).max()
    assert np.abs(found.outputs[:18].T - run.x).max() < NEAR * size
    assert np.abs(found.outputs[18:].T - run.d.reshape(5, -1)).max() < NEAR
    assert {"cell3_z[2]", "cell1_p_x", "cell2_d_y"} <= set(diagram.output_labels)


@pytest.mark.parametrize("K", [2, 10, 50])
def test_coupled_plants_take_lqr_and_bode(K):
    cells = cs.couple(coupled_model(m=3, steered=True), K)
    plant = cells.plant()
    assert plant.input_labels[-1] == "one"
    assert plant.input_labels[0] == "cell1_cos"
    assert plant.output_labels[-1] == f"cell{K}_z[2]"
    gain, _, closed = ct.lqr(plant, np.eye(plant.nstates), np.eye(plant.ninputs))
    assert gain.shape == (plant.ninputs, plant.nstates)
    assert closed.real.max() < 0
    omega = np.geomspace(1e-3, 1.0, 7)
    drawn = ct.frequency_response(plant["cell1_z[0]", "cell2_cos"], omega)
    ours = cs.frequency_response(plant, omega)
    both = ours.response[0, plant.input_labels.index("cell2_cos")]
    np.testing.assert_allclose(np.squeeze(drawn.complex), both, rtol=1e-8, atol=1e-14)


def test_offset_of_coupled_cells_is_heard():
    cells = cs.couple(coupled_model(steered=True, centred=True), 3)
    loopless = cs.couple(coupled_model(centred=True), 3)
    for known, coordinates in ((cells, "emergent"), (loopless, "isolated")):
        bare = known.plant(coordinates, offset="drop")
        full = known.plant(coordinates)
        assert full.input_labels == [*bare.input_labels, "one"]
        assert np.abs(full.B[:, -1]).max() > 1e-3
    t = np.linspace(0.0, 50.0, 11)
    start = loopless.system.x0
    u = np.vstack([np.zeros((3, 11)), np.ones(11)])
    found = ct.forced_response(loopless.plant("isolated"), t, u, start).outputs.T
    run = loopless.simulate(t, METHOD).x
    assert np.abs(found - run).max() < NEAR * np.abs(run).max()
    with pytest.raises(ParameterError, match="offset"):
        cells.plant(offset="shifted")
    with pytest.raises(ParameterError, match="no polarity loop"):
        loopless.interconnect()


def test_blocks_by_themselves():
    law = cs.PolarityLaw(0.05)
    t = np.linspace(0.0, 40.0, 5)
    d = np.tile([[0.0], [1.0], [0.0]], 5)
    known = np.array([law.step(np.array([1.0, 0.0, 0.0]), d[:, 0], s) for s in t])
    flow = ct.input_output_response(law.block(), t, d, [1.0, 0.0, 0.0], solve_ivp_kwargs=TIGHT)
    assert np.abs(flow.outputs.T - known).max() < 1e-7
    step = ct.input_output_response(law.block(dt=10.0), t, d, [1.0, 0.0, 0.0])
    assert np.abs(step.outputs.T - known).max() < 1e-14
    assert law.block(["cell1_", "cell2_"]).output_labels[3] == "cell2_p_x"
    with pytest.raises(ParameterError, match="dt"):
        law.block(dt=0.0)
    sensor = make().sensor
    z = np.random.default_rng(0).standard_normal(5)
    for normalise, read in ((True, sensor.direction), (False, sensor.raw)):
        block = sensor.block(normalise=normalise)
        assert block.input_labels[:2] == ["z[0]", "z[1]"]
        np.testing.assert_allclose(block.output(0.0, [], z), read(z))


def test_the_figure_shows_every_connection():
    loop = make()
    found = wires(loop.interconnect())
    assert found["plant_m5", "sensor"] == [f"z[{i}]" for i in range(5)]
    assert found["sensor", "controller"] == ["d_x", "d_y", "d_z"]
    assert found["commands", "plant_m5"][-1] == "one"
    said = " ".join(text.get_text() for text in block_diagram(loop.interconnect()).texts)
    for words in ("z[0..4]", "p_x, p_y, p_z", "d_x, d_y, d_z", "controller", "3 states", "one"):
        assert words in said
    each = [f"cell{k}_cos" for k in range(1, 51)]
    assert shortened(each) == "cell1..50_cos"


@pytest.mark.parametrize("dt", [None, 10.0])
def test_linear_cells_on_a_field(dt):
    cells = ports(dt)
    t = np.linspace(0.0, 20.0, 3)
    options = {} if dt else {"solve_ivp_kwargs": TIGHT}
    diagram = cells.interconnect()
    found = ct.input_output_response(diagram, t, 0, cells.diagram_start, **options)
    run = cells.simulate(t, None if dt else METHOD)
    size = np.abs(run.x).max()
    assert np.abs(found.states.T - run.x).max() < (1e-12 if dt else NEAR) * size
    assert {"cell2_z[2]", "cell1_p_x", "cell2_d_y"} <= set(diagram.output_labels)
