"""Cells on one shared field: passivity of the parts, certificate, assembled poles, runs."""

import dataclasses

import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.errors import (
    DimensionError,
    IntegrationError,
    MemoryBudgetError,
    ParameterError,
    RepresentationError,
)
from cellsys.integrate import Exponential, simulate
from cellsys.loop import PolarityLaw
from cellsys.model import StiffnessSensor
from cellsys.population import CellPort, LinearField, LoadPorts, PatchPort, couple
from cellsys.population.ported.ported_run import PortedSteps, PortFlow, initial, ported_loop
from cellsys.spectra import poles
from tests.population.systems import HEADINGS, match, model

PORT = PatchPort(radius=9.0)


def field(side=6, spacing=6.0, foundation=0.02, spring=1.0, drag=5.0):
    """Square lattice of springs on a foundation, clamped nowhere."""
    axis = spacing * (np.arange(side) - 0.5 * (side - 1))
    nodes = np.array([(x, y, 0.0) for x in axis for y in axis])
    n = len(nodes)
    K = foundation * np.eye(3 * n)
    for i in range(n):
        for j in range(i):
            if np.linalg.norm(nodes[i] - nodes[j]) < 1.1 * spacing:
                for a in range(3):
                    p, q = 3 * i + a, 3 * j + a
                    K[[p, q], [p, q]] += spring
                    K[[p, q], [q, p]] -= spring
    return LinearField(nodes, K, drag)


def cell(m=5, seed=0, gamma=0.3, dt=None, margin=0.02, steered=False):
    """A random cell that contracts in a random metric, with a collocated port."""
    rng = np.random.default_rng(seed)
    L = np.eye(m) + 0.3 * rng.standard_normal((m, m))
    P = L @ L.T
    skew, push = rng.standard_normal((2, m, m))
    # In the metric's own coordinates: skew minus positive definite.
    inner = 0.2 * (skew - skew.T) - 0.02 * push @ push.T - margin * np.eye(m)
    A = sla.solve(L.T, inner @ L.T)
    if dt is not None:
        A = sla.expm(dt * A)
    F = rng.standard_normal((2, m))
    B, b = rng.standard_normal((m, 4 if steered else 1)), 0.1 * rng.standard_normal(m)
    made = CellPort.collocated(A, F, gamma=gamma, metric=P, B=B, offset=b, dt=dt)
    if not steered:
        return made
    K_d = rng.standard_normal((3, 1 + m))
    K_d[2] = 0.0
    return dataclasses.replace(made, input_names=HEADINGS, sensor=StiffnessSensor(K_d=K_d))


def places(K, seed=0, radius=14.0):
    """Random places, overlapping ones included."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-radius, radius, (K, 2)), rng.uniform(0, 2 * np.pi, K)


@pytest.mark.parametrize("dt", [None, 10.0])
def test_collocated_port_is_passive_and_certified(dt):
    for seed in range(4):
        found = cell(seed=seed, dt=dt).passivity()
        assert found.certified
        assert found.index > -1e-14  # rounding of the response
        assert found.contraction < 0
        assert found.residual < 1e-13
        assert abs(found.gamma - 0.3) < 1e-12
    none = cell(gamma=0.0, dt=dt).passivity()
    assert none.certified
    assert none.index == 0.0


def test_naive_ports_are_not_passive():
    good = cell(dt=10.0)
    wrong_sign = dataclasses.replace(good, C=-good.C)
    assert wrong_sign.passivity().active
    # without (I + A)/2 the step's port is active although the continuous one is passive
    plain = -0.3 * sla.solve(good.metric, good.F.T)
    assert dataclasses.replace(good, C=plain).passivity().index < -1e-4
    free = dataclasses.replace(good, C=np.random.default_rng(0).standard_normal((5, 2)))
    found = free.passivity()
    assert found.active
    assert not found.certified
    # a cell that grows in its metric is not certified
    assert not dataclasses.replace(good, A=1.2 * good.A).passivity().certified


@pytest.mark.parametrize("dt", [None, 10.0])
def test_storage_falls_by_the_work_done_on_the_matrix(dt):
    """|z|_P^2 / (2 gamma) + U does not grow: exactly, step by step, for any velocities."""
    c, rng = cell(dt=dt), np.random.default_rng(1)
    if dt is None:
        for z, y in zip(rng.standard_normal((20, 5)), rng.standard_normal((20, 2)), strict=True):
            gain = z @ c.metric @ (c.A @ z + c.C @ y) / 0.3
            assert gain <= -(c.F @ z) @ y + 1e-12
        return
    for z, y in zip(rng.standard_normal((20, 5)), 3 * rng.standard_normal((20, 2)), strict=True):
        end = c.A @ z + c.C @ y
        f = 0.5 * c.F @ (z + end)
        gain = (end @ c.metric @ end - z @ c.metric @ z) / (2 * 0.3)
        assert gain <= -f @ y + 1e-12 * (abs(gain) + abs(f @ y))


@pytest.mark.parametrize("dt", [None, 10.0])
def test_whole_is_stable_for_many_placements(dt):
    matrix = field()
    for seed in range(5):
        for K in (1, 3, 20):
            x, theta = places(K, seed)
            cells = couple(
                cell(seed=seed, dt=dt),
                coupling=LoadPorts(field=matrix, positions=x, headings=theta, port=PORT),
            )
            assert cells.poles().real.max() < 0
    report = cells.stability()
    assert report.verdict == "stable for every K and every placement"
    assert "centroids integrate" in report.reason
    assert cells.certificate.holds
    assert cells.pole_set().count == 20 * 5 + matrix.order


@pytest.mark.parametrize("dt", [None, 10.0])
def test_certificate_needs_no_matrix(dt):
    x, theta = places(900, 3)
    cells = couple(
        cell(dt=dt), coupling=LoadPorts(field=field(), positions=x, headings=theta, port=PORT)
    )
    assert cells.stability().verdict == "stable for every K and every placement"
    assert cells.route.startswith("certificate only")
    with pytest.raises(MemoryBudgetError, match="certifies any number"):
        cells.poles()


def test_freely_fitted_input_is_refused_and_unstable_from_some_number_of_cells():
    good, matrix = cell(margin=0.05), field(spring=0.2, foundation=0.005, drag=1.0)
    rng = np.random.default_rng(7)
    free = dataclasses.replace(good, C=0.05 * rng.standard_normal((5, 2)))
    top = []
    for K in (1, 10, 40):
        x, theta = places(K, 1, radius=6.0)
        theta[:] = 0.0
        with pytest.raises(ParameterError, match="passivity index"):
            couple(free, coupling=LoadPorts(field=matrix, positions=x, headings=theta, port=PORT))
        cells = couple(
            free,
            coupling=LoadPorts(
                field=matrix, positions=x, headings=theta, port=PORT, allow_active=True
            ),
        )
        top.append(cells.poles().real.max())
        again = couple(
            good, coupling=LoadPorts(field=matrix, positions=x, headings=theta, port=PORT)
        )
        assert again.poles().real.max() < 0
    assert top[0] < 0 < top[-1]
    report = cells.stability()
    assert report.verdict == "unstable"
    assert report.spectral_abscissa == pytest.approx(top[-1])
    with pytest.raises(IntegrationError, match=r"grow"):
        cells.simulate(np.array([0.0, 400.0 / top[-1]]), z0=np.ones(5))


def test_one_cell_is_the_single_closed_cell():
    c, matrix = cell(), field()
    x, theta = np.array([[1.0, -2.0]]), np.array([0.7])
    cells = couple(c, coupling=LoadPorts(field=matrix, positions=x, headings=theta, port=PORT))
    E = PORT.gather(matrix, x[0], 0.7)
    G, D = -matrix.stiffness / matrix.drag, E.T / matrix.drag
    single = np.block([[c.A + c.C @ E @ D @ c.F, c.C @ E @ G], [D @ c.F, G]])
    assert np.abs(cells.matrix() - single).max() < 1e-12
    # and a step of dt against solving the exchange as it stands
    s = cell(dt=10.0)
    cells = couple(s, coupling=LoadPorts(field=matrix, positions=x, headings=theta, port=PORT))
    z, q = np.random.default_rng(0).standard_normal(5), np.zeros(matrix.order)
    run = cells.simulate(np.array([0.0, 10.0]), z0=z)
    end, q_end = run.block("z")[-1, 0], run.block("q")[-1]
    y = E @ (q_end - q) / 10.0
    assert np.abs(s.A @ z + s.offset + s.C @ y - end).max() < 1e-12
    f = 0.5 * s.F @ (z + end)
    left = matrix.drag * (q_end - q) / 10.0 + matrix.stiffness @ q_end - E.T @ f
    assert np.abs(left).max() < 1e-12


@pytest.mark.parametrize("dt", [None, 10.0])
def test_exchanging_two_cells_changes_nothing(dt):
    matrix, c = field(), cell(dt=dt, steered=True)
    x, theta = places(4, 2)
    t = np.linspace(0, 60, 7)
    z0 = np.random.default_rng(1).standard_normal((4, 5))
    swap = [1, 0, 2, 3]
    method = None if dt else Exponential(rtol=1e-9, atol=1e-9)
    a = couple(
        c, coupling=LoadPorts(field=matrix, positions=x, headings=theta, port=PORT)
    ).simulate(t, method, z0=z0)
    b = couple(
        c, coupling=LoadPorts(field=matrix, positions=x[swap], headings=theta[swap], port=PORT)
    ).simulate(t, method, z0=z0[swap])
    # another order of sums and of one linear solve
    assert np.abs(a.block("z")[:, swap] - b.block("z")).max() < 1e-9
    assert np.abs(a.block("q") - b.block("q")).max() < 1e-9
    assert np.abs(a.p[:, swap] - b.p).max() < 1e-9


def test_far_apart_equals_isolated():
    matrix, c = field(side=12, foundation=2.0), cell()  # attenuates within a spacing
    x = np.array([[-27.0, 0.0], [27.0, 0.0]])
    t = np.linspace(0, 60, 4)
    z0 = np.random.default_rng(1).standard_normal((2, 5))
    port = PatchPort(radius=5.0)
    pair = couple(
        c, coupling=LoadPorts(field=matrix, positions=x, headings=None, port=port)
    ).simulate(t, z0=z0)
    near = couple(
        c, coupling=LoadPorts(field=matrix, positions=0.07 * x, headings=None, port=port)
    ).simulate(t, z0=z0)
    for k in range(2):
        alone = couple(
            c, coupling=LoadPorts(field=matrix, positions=x[k : k + 1], headings=None, port=port)
        )
        alone = alone.simulate(t, z0=z0[k]).block("z")[:, 0]
        size = np.abs(alone).max()
        # 54 um are 9 spacings, each of which divides the displacement by about 4
        assert np.abs(pair.block("z")[:, k] - alone).max() < 1e-5 * size
        assert np.abs(near.block("z")[:, k] - alone).max() > 1e-3 * size


def test_superposed_loads_are_exact_and_superposed_cells_are_not():
    """On one linear field the response to all loads is the sum of the responses to each."""
    matrix, c = field(), cell(gamma=0.0)
    x, theta = places(3, 4)
    t = np.linspace(0, 60, 5)
    z0 = np.random.default_rng(1).standard_normal((3, 5))
    together = couple(
        c, coupling=LoadPorts(field=matrix, positions=x, headings=theta, port=PORT)
    ).simulate(t, z0=z0)
    assert couple(
        c, coupling=LoadPorts(field=matrix, positions=x, headings=theta, port=PORT)
    ).route.startswith("cascade")
    alone = [
        couple(
            c,
            coupling=LoadPorts(
                field=matrix, positions=x[k : k + 1], headings=theta[k : k + 1], port=PORT
            ),
        ).simulate(t, z0=z0[k])
        for k in range(3)
    ]
    total = sum(a.block("q") for a in alone)
    assert np.abs(total - together.block("q")).max() < 1e-11 * np.abs(total).max()
    # with a strong port the neighbours change the loads: isolated runs no longer add up
    c = cell(gamma=20.0)
    together = couple(
        c, coupling=LoadPorts(field=matrix, positions=x, headings=theta, port=PORT)
    ).simulate(t, z0=z0)
    total = sum(
        couple(
            c,
            coupling=LoadPorts(
                field=matrix, positions=x[k : k + 1], headings=theta[k : k + 1], port=PORT
            ),
        )
        .simulate(t, z0=z0[k])
        .block("q")
        for k in range(3)
    )
    assert np.abs(total - together.block("q")).max() > 1e-2 * np.abs(total).max()


@pytest.mark.slow
@pytest.mark.parametrize("dt", [None, 10.0])
def test_a_hundred_steered_cells_stay_bounded(dt):
    x, theta = places(100, 5)
    cells = couple(
        cell(m=3, dt=dt, steered=True),
        coupling=LoadPorts(field=field(), positions=x, headings=theta, port=PORT),
    )
    t = np.linspace(0, 240, 5)
    method = None if dt else Exponential(rtol=1e-3, atol=1e-3)
    run = cells.simulate(t, method, z0=np.ones(3))
    alone = couple(
        cell(m=3, dt=dt, steered=True),
        coupling=LoadPorts(field=field(), positions=x[:1], headings=theta[:1], port=PORT),
    ).simulate(t, method, z0=np.ones(3))
    assert np.abs(run.block("z")).max() < 5 * np.abs(alone.block("z")).max()
    assert np.abs(np.linalg.norm(run.p, axis=2) - 1).max() < 1e-12


def test_plant_and_poles_agree():
    x, theta = places(3, 0, radius=6.0)
    for c in (cell(), cell(gamma=0.0)):
        cells = couple(
            c, coupling=LoadPorts(field=field(side=3), positions=x, headings=theta, port=PORT)
        )
        plant = cells.plant()
        assert plant.dt == 0
        assert plant.ninputs == 3 + 1  # the offset's
        assert plant.input_labels[-1] == "one"
        assert match(poles(plant), cells.poles()) < 1e-9
    step = couple(
        cell(dt=10.0),
        coupling=LoadPorts(field=field(side=3), positions=x, headings=theta, port=PORT),
    )
    assert step.plant().dt == 10.0
    continuous = np.log(np.asarray(poles(step.plant()))) / 10.0
    assert match(continuous, step.poles()) < 1e-9
    assert "LoadPorts" in step.pole_set().note


def test_refusals():
    matrix, (x, theta) = field(side=3), places(2, radius=6.0)
    with pytest.raises(DimensionError, match="differ"):
        couple(cell(), 3, LoadPorts(field=matrix, positions=x, headings=theta, port=PORT))
    with pytest.raises(ParameterError, match="leave positions out"):
        couple(
            cell(),
            coupling=LoadPorts(field=matrix, positions=x, headings=theta, port=PORT),
            positions=x,
        )
    with pytest.raises(RepresentationError, match="load port"):
        couple(model(), coupling=LoadPorts(field=matrix, positions=x, headings=theta, port=PORT))
    with pytest.raises(ParameterError, match="no matrix node"):
        couple(
            cell(), coupling=LoadPorts(field=matrix, positions=x + 500.0, headings=theta, port=PORT)
        ).poles()
    with pytest.raises(ParameterError, match="field must be a matrix field"):
        LoadPorts(field=3.0, positions=x)
    with pytest.raises(DimensionError, match="loads"):
        couple(
            cell(),
            coupling=LoadPorts(
                field=matrix, positions=x, headings=theta, port=PatchPort(components=3)
            ),
        )
    with pytest.raises(ParameterError, match="grid"):
        couple(
            cell(dt=10.0), coupling=LoadPorts(field=matrix, positions=x, headings=theta, port=PORT)
        ).simulate([0.0, 5.0])
    with pytest.raises(ParameterError, match="positive definite"):
        CellPort(A=-np.eye(2), F=np.eye(2), metric=-np.eye(2))
    softer = LinearField(matrix.nodes, matrix.stiffness - np.eye(27), 5.0)
    cells = couple(cell(), coupling=LoadPorts(field=softer, positions=x, headings=theta, port=PORT))
    assert not cells.certificate.holds
    assert cells.stability().verdict == "unstable"


def test_index_of_many_loads_is_that_of_the_whole_response():
    """Looked at in the span of F and C alone; against all 60 loads at every frequency."""
    rng = np.random.default_rng(3)
    few = cell(seed=1)
    mix = np.linalg.qr(rng.standard_normal((60, few.n_loads)))[0]
    for C in (few.C @ mix.T, few.C @ mix.T + 0.1 * rng.standard_normal((few.order, 60))):
        port = dataclasses.replace(few, F=mix @ few.F, C=C)
        least, gain = [], []
        for omega in port.frequencies():
            H = port.response(float(omega))
            least.append(np.linalg.eigvalsh(0.5 * (H + H.conj().T))[0])
            gain.append(np.linalg.norm(H, 2))
        assert abs(port.passivity().index - min(least) / max(gain)) < 1e-13


def test_the_estimate_covers_the_error_of_steps():
    """Against the same whole with sixteen steps for one: its power 1/16, the same held answer."""
    x, theta = places(3, 5)
    plant, law = cell(m=3, dt=2.0, steered=True), PolarityLaw(1 / 60)
    cells = couple(
        plant,
        coupling=LoadPorts(field=field(), positions=x, headings=theta, port=PORT),
        controller=law,
    )
    t = 2.0 * np.arange(101)
    run = cells.simulate(t, z0=np.ones(3))
    flow, parts = PortFlow(cells), 16
    root = np.real(sla.fractional_matrix_power(flow.M, 1 / parts))
    assert np.abs(np.linalg.matrix_power(root, parts) - flow.M).max() < 1e-9
    held = sum(np.linalg.matrix_power(root, i) for i in range(parts))
    flow.M, flow.drive = root, np.linalg.solve(held, flow.drive)
    loop = ported_loop(cells)
    start = initial(cells, loop, np.ones(3), None, None)
    steps = PortedSteps(cells=cells, flow=flow, loop=loop, x0=start, dt=2.0 / parts)
    fine = simulate(steps, None, t)
    error = np.abs(run.x - fine.x).max(axis=0)
    for block in run.states:
        part = run.states.slice(block.name)
        assert error[part].max() > 1e-4
        assert error[part].max() <= run.error.absolute[part].max() <= 20 * error[part].max()
    assert "heading in 8 sub-steps" in str(run)


@pytest.mark.parametrize("steered", [True, False])
def test_the_estimate_covers_the_error_of_the_integrator(steered):
    x, theta = places(3, 5)
    cells = couple(
        cell(m=3, steered=steered),
        coupling=LoadPorts(field=field(), positions=x, headings=theta, port=PORT),
    )
    t = np.linspace(0, 240, 7)
    methods = [Exponential(rtol=r, atol=r) for r in (1e-4, 1e-11)]
    run, exact = (cells.simulate(t, method, z0=np.ones(3)) for method in methods)
    error, told = np.abs(run.x - exact.x).max(), run.error.absolute.max()
    if steered:
        assert error <= told <= 20 * error
        assert "a tenth of the tolerance" in str(run)
    else:  # an exact flow, whatever the tolerance
        assert told < 1e-11
        assert "exact flow" in str(run)
