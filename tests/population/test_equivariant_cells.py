"""Equivariant cells on one field: synthetic contractive cells on a small disc."""

import tomllib

import numpy as np
import pytest

import cellsys as cs
from cellsys.cell.charges import command_features
from cellsys.cell.dynamics import CellDynamics, ChargeBlock, ReadOut
from cellsys.cell.model import EquivariantModel
from cellsys.cell.on_field import CellsOnField
from cellsys.cell.port import PolarPort, PortSites
from cellsys.cell.representation import CellRepresentation, ChargeModes
from cellsys.cell.schedule import Clock
from cellsys.cell.shape import ShapeBasis
from cellsys.errors import DimensionError, ParameterError, RepresentationError
from cellsys.field import GalerkinField
from cellsys.loop import PolarityLaw
from cellsys.model import StiffnessSensor
from cellsys.population import Feedback, LoadPorts, Superposition, couple
from cellsys.ports.polar import frozen_port, polar_gather
from cellsys.system import Layout
from tests.cell.refined import reading, refined
from tests.cell.runs import scene
from tests.study.scenes import TINY

ORDERS = (3, 4, 2, 1, 1, 1)  # latent states of charges 0 to 5
STATES = ORDERS[0] + 2 * sum(ORDERS[1:])
INPUTS = command_features(np.ones(1), np.zeros(1), 0).shape[-1]
PORT = PolarPort(reach=8.0, spacing=4.0, orders=4)


@pytest.fixture(scope="module")
def system():
    return cs.build(cs.Scene.parse(tomllib.loads(TINY)))


@pytest.fixture(scope="module")
def field(system):
    return GalerkinField(system=system, order=40, linear=True, places=20)


def model(gamma=0.02, seed=0, norm=0.98, sensor=True, field=None, vertices=2):
    """Random blocks, the same norm at every vertex; loads of some tens of pN/um^2."""
    rng = np.random.default_rng(seed)
    sizes = [PORT.n_hats * k for k in (2, 3, 3, 3, 2, 1)]  # orders of each charge up to 4
    blocks = []
    for q, m in enumerate(ORDERS):
        A = rng.standard_normal((vertices, m, m))
        A = norm * A / np.linalg.norm(A, 2, axis=(1, 2))[:, None, None]
        B = 0.2 * rng.standard_normal((vertices, m, INPUTS))
        C = 5.0 * rng.standard_normal((sizes[q], m))
        blocks.append(ChargeBlock(A, B, gamma, C))
    zero = ReadOut(
        0.05 * rng.standard_normal((vertices, ORDERS[1])),
        0.02 * rng.standard_normal((vertices, INPUTS)),
        np.zeros(PORT.n_hats),
    )
    dynamics = CellDynamics(
        blocks=tuple(blocks), clock=Clock(250.0, vertices), dt=10.0, alone=zero, riding=zero
    )
    m = STATES + 2
    K_d = rng.standard_normal((3, 1 + m))
    K_d[2] = 0.0
    return EquivariantModel(
        dynamics=dynamics,
        representation=CellRepresentation(ShapeBasis(np.eye(3), 4.0, 0), PORT, 0.0, 1.0),
        modes=ChargeModes({}, {}, {}),
        sites=PortSites(np.arange(1), np.zeros((1, 2)), np.ones(1))
        if field is None
        else PortSites.of(field.nodes, field.surface),
        states=Layout([]),
        auxiliaries=Layout([]),
        z_start=np.zeros(m),
        sensor=StiffnessSensor(K_d=K_d) if sensor else None,
    )


def cells(m, field, places, headings=None, **more):
    return couple(m, coupling=LoadPorts(field=field, positions=places, headings=headings), **more)


PAIR = np.array([[-6.0, 0.0], [6.0, 1.0]])


def test_printed_forms_refuse_it_by_name(field):
    for form in (Superposition(), Feedback()):
        with pytest.raises(RepresentationError, match="EquivariantModel has none; use LoadPorts"):
            couple(model(), 3, form)


@pytest.mark.parametrize("gamma", [0.0, 0.02])
def test_certificate(field, gamma):
    found = cells(model(gamma), field, PAIR)
    report = found.stability()
    assert report.verdict == "stable for every K and every placement"
    assert "centroids integrate" in report.reason
    port = frozen_port(model(gamma)).passivity()
    assert port.certified
    assert port.index > -1e-12
    assert found.poles().real.max() < 0
    assert found.pole_set().count == 2 * STATES + 40
    growing = model(gamma, norm=1.2)
    if gamma:
        with pytest.raises(ParameterError, match="passivity index"):
            cells(growing, field, PAIR)
    else:
        assert "every K" not in cells(growing, field, PAIR).stability().verdict


def test_gather_is_the_transpose_of_scatter(field):
    m = model(field=field)
    gather = polar_gather(m, field)
    E = gather.gather(field, PAIR[0], 0.0)
    footprint = gather.sites.under(PAIR[0], PORT)
    rng = np.random.default_rng(0)
    q = rng.standard_normal(field.order)
    y = footprint.gather(field.displacement(q)[footprint.nodes])
    flat = np.concatenate([y[0], *(np.r_[y[k].real, y[k].imag] for k in range(1, 6))])
    assert np.abs(E @ q - flat).max() < 1e-12 * np.abs(flat).max()


@pytest.mark.parametrize("gamma", [0.0, 0.02])
def test_one_step_is_that_of_the_frozen_linear_cells(field, gamma):
    """Independent of the exchange: dense algebra against fixed-point steps of cells and field."""
    m = model(gamma, vertices=1, field=field)
    found = cells(m, field, PAIR)
    rng = np.random.default_rng(1)
    z0 = np.column_stack([rng.standard_normal((2, STATES)), PAIR])
    run = found.simulate(
        [0.0, 10.0], z0=z0, amplitude=np.ones((1, 2)), heading=[[0.3, 2.0]], tolerance=1e-13
    )
    whitened = [m.dynamics.split(z) for z in run.block("z")]

    def flat(state):
        parts = [state.x[0], *(p for x in state.x[1:] for p in (x.real, x.imag))]
        return np.concatenate(parts, axis=-1)

    # the commands' part of the step, from cells without a field
    features = m.dynamics.features(np.ones(2), np.array([0.3, 2.0]))
    w = m.dynamics.clock.weights(0.0)
    free = m.dynamics.advance(whitened[0], features, w)
    zero = m.dynamics.advance(whitened[0], [0 * f for f in features], w)
    push = [a - b for a, b in zip(free, zero, strict=True)]
    push = np.concatenate([push[0], *(p for x in push[1:] for p in (x.real, x.imag))], axis=-1)
    M, G = found.frozen().whole
    start = np.concatenate([flat(whitened[0]).ravel(), np.zeros(field.order)])
    end = M @ start + G @ push.ravel()
    assert np.abs(end[: 2 * STATES] - flat(whitened[1]).ravel()).max() < 1e-9
    q = run.block("field.modes")[-1]
    assert np.abs(end[2 * STATES :] - q).max() < 1e-9 * np.abs(q).max()


def test_one_cell_is_the_single_closed_cell(field):
    m = model(field=field)
    t = np.arange(0.0, 101.0, 10.0)
    angle = np.linspace(0, 1, 10)[:, None]
    run = cells(m, field, PAIR[:1]).simulate(t, heading=angle)
    single = CellsOnField(model=m, field=field).simulate(np.ones((10, 1)), angle, PAIR[:1])
    assert np.abs(run.block("z") - single.block("z")).max() < 1e-12
    assert np.abs(run.block("field.modes") - single.block("field.modes")).max() < 1e-12


def test_exchanging_two_cells_changes_nothing(field):
    m, t = model(field=field), np.arange(0.0, 101.0, 10.0)
    angles = np.array([0.3, 2.0])
    law = PolarityLaw()
    a = cells(m, field, PAIR, angles, controller=law).simulate(t, tolerance=1e-12)
    b = cells(m, field, PAIR[::-1], angles[::-1], controller=law).simulate(t, tolerance=1e-12)
    assert np.abs(a.block("z") - b.block("z")[:, ::-1]).max() < 1e-9
    assert np.abs(a.block("field.modes") - b.block("field.modes")).max() < 1e-9
    assert np.abs(a.p - b.p[:, ::-1]).max() < 1e-9
    assert np.abs(np.linalg.norm(a.p, axis=2) - 1).max() < 1e-13
    # the controller turns
    assert np.abs(a.p[-1] - a.p[0]).max() > 0.05


def test_storage_does_not_grow_without_commands(system):
    """Nonlinear field, strong port, moving and overlapping cells: sum of storages falls."""
    field = GalerkinField(system=system, order=40, places=20)
    m = model(0.05, field=field)
    for block in m.dynamics.blocks:
        block.B[:] = 0.0
    places = np.random.default_rng(0).uniform(-5, 5, (4, 2))
    rng = np.random.default_rng(1)
    z0 = np.column_stack([5 * rng.standard_normal((4, STATES)), places])
    whole = CellsOnField(model=m, field=field, tolerance=1e-10)
    state, stored = whole.start(places, z0), []
    for k in range(8):
        stored.append(whole.storage(state))
        state, _ = whole.step(state, np.zeros(4), np.zeros(4), 10.0 * k)
    stored = np.array(stored)
    assert np.all(np.diff(stored) <= 1e-9 * stored[:-1])


@pytest.mark.slow
def test_many_cells_stay_bounded(field):
    m, rng = model(field=field), np.random.default_rng(3)
    t = np.arange(0.0, 301.0, 10.0)
    places = rng.uniform(-8, 8, (100, 2))
    run = cells(m, field, places, rng.uniform(0, 6, 100), controller=PolarityLaw()).simulate(t)
    alone = cells(m, field, places[:1], controller=PolarityLaw()).simulate(t)
    # shapes stay at the level of a single cell; the places integrate
    assert np.abs(run.block("z")[:, :, :-2]).max() < 5 * np.abs(alone.block("z")[:, 0, :-2]).max()


@pytest.mark.slow
def test_far_apart_equals_isolated(field):
    """The farther the neighbour, the smaller its effect."""
    m, t = model(field=field), np.arange(0.0, 51.0, 10.0)
    effect = []
    for distance in (2.0, 6.0, 12.0):
        places = np.array([[-distance, 0.0], [distance, 0.0]])
        pair = cells(m, field, places).simulate(t, tolerance=1e-11).block("z")[:, 0, :-2]
        alone = cells(m, field, places[:1]).simulate(t, tolerance=1e-11).block("z")[:, 0, :-2]
        effect.append(np.abs(pair - alone).max() / np.abs(alone).max())
    assert effect[0] > effect[1] > effect[2]
    assert effect[2] < 0.25 * effect[0]


def test_refusals(field):
    m = model(field=field)
    found = cells(m, field, PAIR)
    with pytest.raises(ParameterError, match="grid"):
        found.simulate([0.0, 5.0])
    with pytest.raises(DimensionError, match="heading"):
        found.simulate([0.0, 20.0], heading=np.zeros((1, 2)))
    with pytest.raises(ParameterError, match="own port"):
        couple(m, coupling=LoadPorts(field=field, positions=PAIR, port=cs.PatchPort()))
    with pytest.raises(ParameterError, match="needs a sensor"):
        cells(model(sensor=False), field, PAIR, controller=PolarityLaw())
    with pytest.raises(DimensionError, match="differ"):
        couple(m, 3, LoadPorts(field=field, positions=PAIR))
    assert "equivariant cells" in str(found)


@pytest.mark.parametrize("linear", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_the_estimate_covers_the_error_of_stepping(linear):
    """Against the same cells and field with sixteen steps for one."""
    coarse, fine = refined(), refined(16)
    small = GalerkinField(system=cs.build(scene()), order=40, linear=linear, places=20)
    law, sensed = PolarityLaw(1 / 30), reading(coarse, 0.2)
    heads, t = np.array([2.0, -1.0]), 10.0 * np.arange(31)

    def run(m):
        found = cells(m, small, PAIR, heads, controller=law, sensor=sensed)
        return found.simulate(t)

    coarse_run, exact = run(coarse), run(fine)
    error, told = np.abs(coarse_run.x - exact.x).max(axis=0), coarse_run.error
    for block in coarse_run.states:
        part = coarse_run.states.slice(block.name)
        assert error[part].max() <= told.absolute[part].max() <= 20 * error[part].max(), block.name
    assert error[coarse_run.states.slice("field.modes")].max() > 1e-4
    assert "two steps of the field" in str(coarse_run)
    following = cells(coarse, small, PAIR).simulate(t, heading=np.zeros((30, 2)))
    assert 0 < following.error.relative < 1


def test_refined_cells_answer_held_inputs_alike():
    """The oracle above: commands and matrix velocities held over a step, one step or sixteen."""
    rng, ported = np.random.default_rng(3), 0
    for one, many in zip(refined().dynamics.blocks, refined(16).dynamics.blocks, strict=True):
        if not one.size:
            continue
        x0, r = rng.normal(size=one.size), rng.normal(size=3)
        velocity = 1e-2 * rng.normal(size=len(one.C))
        ends = []
        for block, parts, pushed in ((one, 1, 0), (one, 1, 1), (many, 16, 1)):
            x, A = x0, block.A[0]
            push = block.gamma * 0.5 * (np.eye(block.size) + A) @ block.C.T @ velocity
            for _ in range(parts):
                x = A @ x + block.B[0] @ r - pushed * push
            ends.append(x)
        free, whole, fine = ends
        # gamma goes with all states alike: exact to (1 - pole)^2/12
        assert np.abs(fine - whole).max() <= 1e-12 + 0.02 * np.abs(whole - free).max()
        ported += np.abs(whole - free).max() > 1e-6
    assert ported
