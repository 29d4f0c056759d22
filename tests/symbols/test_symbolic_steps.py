"""Symbolic steps and forms on a field against the runs they are of; parameters of each cell."""

import dataclasses
import tomllib

import casadi as ca
import numpy as np
import pytest
import scipy.linalg as sla

import cellsys as cs
from cellsys.errors import DimensionError, ParameterError
from cellsys.model.network_sensor import LocalSensor
from cellsys.model.stiffness_map import StiffnessMap
from tests.loop.systems import make
from tests.population.systems import model
from tests.population.test_equivariant_cells import PAIR, cells
from tests.population.test_equivariant_cells import model as equivariant
from tests.population.test_load_ports import PORT, cell, field
from tests.study.scenes import TINY


def rolled(form, steps, u=None):
    f, x = form.function(), form.x0
    rows = [x]
    for k in range(steps):
        x = np.asarray(f(x, form.u0 if u is None else u[k], form.p0, k * form.dt)[0]).ravel()
        rows.append(x)
    return np.array(rows)


def local(m):
    """A sensor that uses all its inputs."""
    rng = np.random.default_rng(2)
    known = StiffnessMap(rng.uniform(-12, 12, (60, 2)), rng.uniform(1, 3, 60))
    K = [rng.standard_normal(s) for s in ((3, 1 + m), (3, 2), (3, 2), (2, 1 + m), (3, 3))]
    for part in (K[0], K[1], K[2], K[4]):
        part[2] = 0.0
    return LocalSensor(K_d=K[0], K_s=K[1], map=known, K_t=K[2], M=K[3], a=0.3, K_q=1e-3 * K[4])


def graded(sensor):
    """The same weights as a contrast, of a map of contrasts where there is one."""
    if isinstance(sensor, LocalSensor):
        known = dataclasses.replace(sensor.map, contrasts=True)
        sensor = dataclasses.replace(sensor, map=known, K_t=np.zeros((3, 2)))
    return dataclasses.replace(sensor, noise=0.8)


@pytest.mark.parametrize("sensed", ["linear", "local", "graded", "graded local"])
@pytest.mark.parametrize("law", [cs.PolarityLaw(0.05), cs.PolarityLaw(0.05, cs.AntiparallelTurn())])
def test_the_step_of_a_scheduled_loop_has_the_same_numbers(sensed, law):
    m = equivariant(seed=3)
    sensor = local(m.order) if "local" in sensed else m.sensor
    sensor = graded(sensor) if "graded" in sensed else sensor
    d = sensor.direction(m.z_start)
    p0 = -d if law.antiparallel != cs.AntiparallelStay() else np.array([0.6, 0.8, 0.0])
    loop = cs.closed_loop(m, controller=law, sensor=sensor, p0=p0)
    drive = np.random.default_rng(1).uniform(0.6, 1.4, 12)
    form = cs.symbolic(loop, parameters=("kappa", "K_d"), inputs=("amplitude",))
    assert form.dt == m.dt
    assert form.inputs == ("amplitude",)
    run = loop.simulate(m.dt * np.arange(13), amplitude=drive)
    found = rolled(form, 12, drive[:, None])
    # The same step in another order of sums.
    assert np.abs(found - run.x).max() < 1e-12 * np.abs(run.x).max()
    y = form.function()(form.x0, form.u0, form.p0, 0.0)[1]
    shown = dict(zip(form.outputs, np.asarray(y).ravel(), strict=True))
    assert shown["x"] == m.z_start[-2]
    assert abs(shown["d_x"] - run.d[0, 0, 0]) < 1e-13
    two = form.step(2 * m.dt)
    x = two(form.x0, [1.0], form.p0, 0.0)
    twice = rolled(form, 2)
    assert np.abs(np.asarray(x).ravel() - twice[-1]).max() < 1e-13 * np.abs(twice).max()
    for asked, words in (
        (lambda: form.rk4(1.0), r"rk4\(\) is for loops in continuous time"),
        (lambda: form.step(1.5 * m.dt), "multiple of the loop's step"),
        (lambda: cs.symbolic(loop, parameters=("A",)), "parameters must be"),
        (lambda: cs.symbolic(loop, points=[[0.0, 0.0]]), "points"),
        (lambda: cs.symbolic(loop, place=np.zeros((2, 1 + loop.order))), "place"),
    ):
        with pytest.raises(ParameterError, match=words):
            asked()


def test_a_commanded_heading_drives_the_scheduled_plant():
    m = equivariant(seed=3)
    loop = cs.closed_loop(m, controller=cs.PolarityLaw(0.05))
    rng = np.random.default_rng(4)
    u = np.column_stack([rng.uniform(0.6, 1.4, 9), rng.uniform(-3, 3, 9)])
    form = cs.symbolic(loop, inputs=("amplitude", "heading"))
    known = m.simulate_commands(loop.z0, u[:, 0], u[:, 1])
    found = rolled(form, 9, u)[:, : m.order]
    assert np.abs(found - known).max() < 1e-12 * np.abs(known).max()


def ported(dt, K=2, x=PAIR):
    placed = cs.LoadPorts(field=field(), positions=x, headings=np.arange(K) * 2.0, port=PORT)
    return cs.couple(cell(m=3, dt=dt, steered=True), coupling=placed, controller=cs.PolarityLaw())


def test_cells_on_a_field():
    still = ported(None)
    form = cs.symbolic(still, parameters=("kappa", "K_d"), points=[[0.0, 0.0]])
    assert form.inputs == ("load1_x", "load1_y", "load1_z")
    run = still.simulate([0.0, 5.0], cs.DOP853(rtol=1e-8, atol=1e-8))
    step, x = form.step(0.25), form.x0
    for _ in range(20):
        x = step(x, form.u0, form.p0, 0.0)
    n = len(form.x0) - 6
    shown = np.concatenate([run.x[-1, :n], run.p[-1].ravel()])
    # Steps of order 4; the sensed direction passes close to zero and turns fast there.
    assert np.abs(np.asarray(x).ravel() - shown).max() < 1e-5 * np.abs(shown).max()
    pushed = np.asarray(form.function()(form.x0, [1.0, 0, 0], form.p0)[0]).ravel()
    rest = np.asarray(form.function()(form.x0, form.u0, form.p0)[0]).ravel()
    plant = still.plant(points=[[0.0, 0.0]])
    column = plant.B[:, plant.input_labels.index("load1_x")]
    np.testing.assert_allclose((pushed - rest)[:n], column, atol=1e-12 * np.abs(pushed).max())

    stepped = ported(10.0)
    form = cs.symbolic(stepped)
    run = stepped.simulate(10.0 * np.arange(6))
    found = rolled(form, 5)
    assert np.abs(found - run.x).max() < 1e-12 * np.abs(run.x).max()


def test_equivariant_cells_on_a_galerkin_field():
    system = cs.build(cs.Scene.parse(tomllib.loads(TINY)))
    disc = cs.GalerkinField(system=system, order=8, linear=True, places=8)
    m = equivariant(vertices=1, field=disc)
    law = cs.PolarityLaw(0.03)
    found = cells(m, disc, PAIR, headings=np.array([0.3, 2.0]), controller=law)
    form = cs.symbolic(found, inputs=("amplitude",))
    run = found.simulate([0.0, 10.0], amplitude=[[1.2, 0.7]], tolerance=1e-13)
    x = rolled(form, 1, np.array([[1.2, 0.7]]))[1]
    z, q = run.block("z")[1], run.block("field.modes")[1]
    known = np.concatenate([z[:, :-2].ravel(), q, z[:, -2:].ravel(), run.p[1].ravel()])
    # Loads settle to 1e-13; the rest are two orders of the same sums.
    assert np.abs(x - known).max() < 1e-11 * np.abs(known).max()
    names = {"cell1_x", "cell2_y", "gap1_2", "cell2_p_x"}
    assert names <= set(form.outputs)
    told = cs.symbolic(found, inputs=("heading",))
    held = found.simulate([0.0, 10.0], heading=[[1.0, -1.0]], tolerance=1e-13)
    x = rolled(told, 1, np.array([[1.0, -1.0]]))[1]
    assert np.abs(x[-6:] - held.p[1].ravel()).max() < 1e-14
    bare = cells(equivariant(vertices=1, field=disc, sensor=False), disc, PAIR, headings=[0.3, 2.0])
    form = cs.symbolic(bare, parameters=(), inputs=("heading",))
    kept = rolled(form, 3)  # a cell without a sensor keeps its commanded heading
    assert np.abs(kept[-1][-6:-3] - [np.cos(0.3), np.sin(0.3), 0.0]).max() < 1e-14
    with pytest.raises(ParameterError, match="parameters must be"):
        cs.symbolic(bare)


def test_every_cell_has_its_own_parameters():
    loop = cs.couple(model(m=3, steered=True), 3, headings=[0.0, 1.0, 2.0])
    form = cs.symbolic(loop, parameters=("kappa", "sensor.gain"), per_cell=True)
    names = [f"cell{k}_{n}" for n in ("kappa", "sensor.gain") for k in (1, 2, 3)]
    assert list(form.parameters) == names
    f, p = form.function(), form.p0.copy()
    before = np.asarray(f(form.x0, form.u0, p)[0]).ravel()
    p[1] *= 2.0
    after = np.asarray(f(form.x0, form.u0, p)[0]).ravel()
    turns = (after - before)[-9:].reshape(3, 3)
    np.testing.assert_allclose(turns[1], before[-6:-3], rtol=1e-12)
    assert not turns[[0, 2]].any()


@pytest.mark.parametrize("coupling", [cs.Superposition(), cs.Feedback()], ids=lambda f: f.name)
def test_coupling_as_a_parameter_is_a_factor_on_the_weights(coupling):
    w = np.array([[0.0, 0.2, 0.1], [0.2, 0.0, 0.1], [0.1, 0.1, 0.0]])

    def made(factor):
        one = model(m=3, steered=True, centred=True)
        return cs.couple(one, 3, coupling, graph=factor * w, headings=[0.0, 1.0, 2.0])

    form = cs.symbolic(made(1.0), parameters=("coupling",))
    other = made(0.4).system
    x = form.x0 + 0.1
    found = np.asarray(form.function()(x, form.u0, [0.4])[0]).ravel()
    np.testing.assert_allclose(found, other.rhs(0.0, x), atol=1e-13)
    mapped = cs.MappedSuperposition(P_map=0.1 * np.eye(3))
    with pytest.raises(ParameterError, match="parameters must be"):
        cs.symbolic(cs.couple(model(m=3, steered=True), 3, mapped), parameters=("coupling",))


def test_a_sensor_gain_and_a_force_are_factors():
    loop = make(normalise=False)
    form = cs.symbolic(loop, parameters=("sensor.gain", "force"))
    sensor = loop.sensor.K_d.copy()
    sensor[:, 1:] *= 1.5
    other = dataclasses.replace(
        loop,
        sensor=cs.StiffnessSensor(K_d=sensor),
        model=dataclasses.replace(loop.model, B=0.7 * loop.model.B),
    )
    found = np.asarray(form.function()(form.x0, form.u0, [1.5, 0.7])[0]).ravel()
    np.testing.assert_allclose(found, other.system.rhs(0.0, form.x0), atol=1e-14)
    placed = cs.symbolic(loop, place=np.eye(2, 1 + loop.order))
    assert placed.outputs[-2:] == ("x", "y")
    assert np.asarray(placed.function()(form.x0, form.u0, placed.p0)[1])[-2] == 1.0
    with pytest.raises(DimensionError, match="place"):
        cs.symbolic(loop, place=np.eye(2))


def test_steps_are_of_order_four_and_stand_stiff_plants():
    loop = make(kappa=0.05, normalise=False)
    form, fine = cs.symbolic(loop), loop.simulate([0.0, 40.0], cs.DOP853(rtol=1e-12, atol=1e-12))
    miss = []
    for h in (5.0, 2.5):
        x = form.x0
        for _ in range(round(40.0 / h)):
            x = form.step(h)(x, form.u0, form.p0, 0.0)
        miss.append(np.abs(np.asarray(x).ravel() - fine.x[-1]).max())
    assert 9 < miss[0] / miss[1] < 40  # 16
    stiff = dataclasses.replace(
        loop, model=dataclasses.replace(loop.model, A=loop.model.A - 1e4 * np.eye(loop.order))
    )
    x = cs.symbolic(stiff).step(5.0)(form.x0, form.u0, form.p0, 0.0)
    assert np.abs(np.asarray(x)).max() < 10  # naive: Runge-Kutta by steps of 5 s is off by 1e15
    assert np.abs(np.asarray(cs.symbolic(stiff).rk4(5.0)(form.x0, form.u0, form.p0))).max() > 1e10
    free = cs.symbolic(loop, parameters=("A",))
    x = free.step(1.0)(free.x0, free.u0, free.p0, 0.0)
    known = form.step(1.0)(form.x0, form.u0, form.p0, 0.0)
    assert np.abs(np.asarray(x) - np.asarray(known)).max() < 1e-4


@pytest.mark.parametrize("kind", ["single", "scheduled", "coupled"])
def test_sensitivity_of_a_pole_is_a_difference(kind):
    def made(kappa):
        law = cs.PolarityLaw(kappa)
        if kind == "single":
            return make(kappa=kappa)
        if kind == "scheduled":
            return cs.closed_loop(equivariant(seed=3), controller=law, p0=[0.6, 0.8, 0.0])
        one = model(m=3, steered=True)
        return cs.couple(one, 3, headings=[0.0, 1.0, 2.0], controller=law)

    form = cs.symbolic(made(1 / 60))
    J = ca.jacobian(form.rhs, form.x)
    slope = ca.jacobian(ca.vec(J), form.p)
    f = ca.Function("J", [form.x, form.p, form.u, form.t], [J, slope])
    x, n = form.x0 + 0.05, len(form.x0)
    at, rate = (np.asarray(v) for v in f(x, form.p0, form.u0, 30.0))
    values, left, right = sla.eig(at, left=True, right=True)
    dJ = rate.reshape(n, n).T
    found = np.array([
        left[:, k].conj() @ dJ @ right[:, k] / (left[:, k].conj() @ right[:, k]) for k in range(n)
    ])  # fmt: skip
    k = int(np.argmax(np.abs(found)))
    h, moved = 1e-6, []
    for s in (1, -1):
        other = cs.symbolic(made(1 / 60 + s * h))
        g = ca.Function("J", [other.x, other.p, other.u, other.t],
                        [ca.jacobian(other.rhs, other.x)])  # fmt: skip
        poles = np.linalg.eigvals(np.asarray(g(x, other.p0, other.u0, 30.0)))
        moved.append(poles[np.argmin(np.abs(poles - values[k]))])
    known = (moved[0] - moved[1]) / (2 * h)
    assert abs(found[k] - known) < 1e-6 * abs(known)
