"""The matrix as its own system: gradient flow, passive in every step, exact in its limits."""

from functools import lru_cache

import numpy as np
import pytest
import scipy.linalg as sla
import scipy.sparse as sp

import cellsys as cs
from cellsys.errors import (
    DataError,
    DimensionError,
    IntegrationError,
    ParameterError,
    RankError,
    SceneError,
)
from cellsys.field.descent import StepMemory, StepProblem, implicit_step
from cellsys.laws.fibre import axial
from tests.mechanics.scenes import clutch, small, table

FEW = {"places": 25, "per_place": 4}  # quick modes; accuracy is not what these tests are about
LAWS = {
    "buckling": {},
    "stiffening": {"matrix_elasticity": {"law": "stiffening"}},
    "linear": {"matrix_elasticity": {"law": "linear"}},
    "bending": {"fibre_bending": {"rigidity": "2000 pN um^2"}},
}


@lru_cache(maxsize=8)
def field(law="buckling", order=40, linear=False):
    return cs.GalerkinField(system=small(**LAWS[law]), order=order, linear=linear, **FEW)


@lru_cache(maxsize=8)
def full(law="buckling"):
    return cs.full_field(small(**LAWS[law]))


def patch_loads(f, n, seed, size=60.0):
    """Random loads on the surface nodes (n, nodes, 3), pN."""
    rng = np.random.default_rng(seed)
    loads = np.zeros((n, *f.nodes.shape))
    loads[:, f.surface] = size * rng.standard_normal((n, len(f.surface), 3))
    return loads


# Energy, force, tangent


def oracle_force(disc, u, law, spring):
    """Forces of fibres and foundation in plain numpy."""
    i, j = disc.fibres.T
    d = (disc.position + u)[j] - (disc.position + u)[i]
    now = np.sqrt((d**2).sum(axis=1) + 1e-12)
    g, _ = axial(now / disc.length - 1.0, *law)
    pull = (disc.stiffness * disc.length * g / now)[:, None] * d
    out = np.zeros_like(u)
    np.add.at(out, i, pull)
    np.add.at(out, j, -pull)
    out[:, 2] -= spring * u[:, 2]
    return out


def test_force_is_that_of_the_fibres_of_the_scene():
    system = small()
    f, whole = field(), full()
    law = next(e.law for e in system.elements if e.name == "matrix.matrix_elasticity")
    q = 0.3 * np.random.default_rng(0).standard_normal(f.order)
    u = f.displacement(q)
    expected = oracle_force(system.matrix, u, law, 500.0)
    scale = np.abs(expected).max()
    # The compiled loop fuses products; the sums are over ten fibres.
    assert np.abs(f.force(q) - f.project(expected)).max() < 1e-10 * scale
    assert np.abs(whole.force(whole.project(u)) - whole.project(expected)).max() < 1e-10 * scale


@pytest.mark.parametrize("law", list(LAWS))
@pytest.mark.parametrize("kind", [field, full])
def test_force_and_tangent_are_derivatives_of_the_energy(kind, law):
    f = kind(law)
    rng = np.random.default_rng(1)
    q = f.project(0.05 * rng.standard_normal(f.nodes.shape))
    d = f.project(rng.standard_normal(f.nodes.shape))
    h = 1e-6  # um: rounding 1e-16 U/h and curvature of the law h^2/w^2 both below 1e-6
    rise = (f.energy(q + h * d) - f.energy(q - h * d)) / (2 * h)
    assert abs(rise + f.force(q) @ d) < 1e-6 * np.linalg.norm(f.force(q)) * np.linalg.norm(d)
    change = -(f.force(q + h * d) - f.force(q - h * d)) / (2 * h)
    assert np.linalg.norm(change - f.tangent(q) @ d) < 1e-6 * np.linalg.norm(change)
    assert f.energy(np.zeros(f.order)) == pytest.approx(0.0, abs=1e-9)


def test_inclusion_and_gradient_are_respected():
    spec = table()
    plain = cs.full_field(cs.build(cs.Scene.parse(spec))).stiffness
    spec["matrix"]["gradient"] = {"direction": "0 deg", "per_um": 0.02}
    graded = cs.full_field(cs.build(cs.Scene.parse(spec))).stiffness
    assert abs(graded - plain).max() > 0.05 * abs(plain).max()


# Modes


def test_modes_are_orthonormal_nested_and_hold_the_rim():
    f = field()
    overlap = f.modes.T @ f.modes
    assert np.abs(overlap - np.eye(f.order)).max() < 1e-12
    held = np.repeat(small().matrix.clamped, 3)
    assert not f.modes[held].any()
    again = cs.GalerkinField(system=small(), order=10, **FEW)
    assert np.array_equal(again.modes, f.modes[:, :10])
    assert np.array_equal(f.truncated(10).modes, again.modes)
    other = cs.GalerkinField(system=small(), order=10, seed=1, **FEW)
    assert sla.subspace_angles(other.modes, again.modes).max() > 0.01


def test_snapshots_enter_the_modes():
    shift = np.zeros((1, *field().nodes.shape))
    shift[0, field().surface[3]] = 1.0  # one node alone: no smooth load does that
    f = cs.GalerkinField(system=small(), order=20, snapshots=shift, **FEW)

    def missed(g):
        left = shift[0] - g.displacement(g.project(shift[0]))
        return np.linalg.norm(left) / np.linalg.norm(shift)

    # Half of the weight in one direction: it is all but the first mode.
    assert missed(f) < 0.01
    assert missed(field().truncated(20)) > 0.5


# Steps


def test_a_full_basis_gives_the_full_field():
    whole = full()
    f = cs.GalerkinField(system=small(), modes=whole.modes.toarray(), tolerance=1e-9)
    loads = patch_loads(f, 3, seed=2)
    one = f.displacement(f.simulate(loads, 10.0).x)
    two = whole.displacement(cs.FullField(system=small(), tolerance=1e-9).simulate(loads, 10.0).x)
    # Both leave 1e-9 of the load; soft directions have 1e3 times less stiffness than stiff ones.
    assert np.abs(one - two).max() < 1e-6 * np.abs(two).max()


def test_small_loads_move_the_linear_field():
    f, lin = field(), field(linear=True)
    lin = cs.GalerkinField(system=small(), modes=f.modes, linear=True)
    load = f.project(patch_loads(f, 1, seed=3, size=1e-3))[0]
    q, _ = f.step(np.zeros(f.order), load, 20.0)
    r, _ = lin.step(np.zeros(f.order), load, 20.0)
    # Strains of 1e-6 against a blend of 2e-3, and the step's tolerance of 1e-3 of the load.
    assert np.linalg.norm(q - r) < 5e-3 * np.linalg.norm(r)


@pytest.mark.parametrize("law", list(LAWS))
@pytest.mark.parametrize("dt", [0.5, 10.0, 1e4])
def test_no_step_gains_more_energy_than_its_work(law, dt):
    f = field(law)
    q, memory = np.zeros(f.order), f.memory()
    for load in f.project(patch_loads(f, 12, seed=4, size=400.0)):
        before = f.energy(q)
        end, info = f.step(q, load, dt, memory=memory)
        left = f.drag / dt * (end - q) - f.force(end) - load
        scale = max(np.linalg.norm(load), np.linalg.norm(f.force(q)))
        assert np.linalg.norm(left) <= 1.001 * f.tolerance * scale
        rounding = 1e-10 * (1.0 + before + f.energy(end))
        assert f.energy(end) - before <= load @ (end - q) + rounding
        assert info.gain <= info.work + rounding
        q = end


def test_the_naive_steps_gain_energy_from_nothing():
    """Explicit Euler, and one correction with a lagged tangent that is too soft."""
    f = field()
    loads = f.project(patch_loads(f, 12, seed=4, size=400.0))
    soft = 0.2 * f.stiffness + f.drag / 10.0 * np.eye(f.order)

    def explicit(q, load):
        return q + 10.0 / f.drag * (f.force(q) + load)

    def lagged(q, load):
        return q + sla.solve(soft, f.force(q) + load, assume_a="pos")

    for naive in (explicit, lagged):
        q, worst = np.zeros(f.order), -np.inf
        for load in loads[:4]:
            end = naive(q, load)
            worst = max(worst, f.energy(end) - f.energy(q) - load @ (end - q))
            q = end
        assert worst > 1.0, naive.__name__


def test_steps_converge_at_first_order():
    f = field()
    load = f.project(patch_loads(f, 1, seed=5))[0]

    def end(n):
        run = f_fine.simulate(np.tile(load, (n, 1)), 0.8 / n)
        return run.x[-1]

    f_fine = cs.GalerkinField(system=small(), modes=f.modes, tolerance=1e-10)
    best = end(256)
    error = [np.linalg.norm(end(n) - best) for n in (8, 16, 32)]
    ratios = np.array(error[:-1]) / np.array(error[1:])
    assert np.all((ratios > 1.7) & (ratios < 2.5))  # 2 at first order, bent by the reference


def test_memory_saves_evaluations_and_changes_nothing_else():
    f = cs.GalerkinField(system=small(), modes=field().modes, tolerance=1e-8)
    load = f.project(patch_loads(f, 1, seed=6))[0] * np.linspace(0.1, 1.0, 15)[:, None]
    run = f.simulate(load, 10.0)
    q, spent = np.zeros(f.order), 0
    for item in load:
        q, info = f.step(q, item, 10.0)
        spent += info.iterations
    assert np.linalg.norm(q - run.x[-1]) < 1e-5 * np.linalg.norm(q)
    assert run.statistics["evaluations"] < spent
    assert run.statistics["least_balance"] >= 0.0


def test_a_guess_beyond_a_barrier_is_not_believed():
    """Two wells, the one at q = 1 higher: the step from -1 must not end there without work."""

    def energy(q):
        return float(5.0 * (q @ q - 1.0) ** 2 + q.sum())

    def force(q):
        return -20.0 * (q @ q - 1.0) * q - 1.0

    problem = StepProblem(
        drag=1e-3,
        energy=energy,
        force=force,
        kept=lambda r: r / 60.0,
        fresh=lambda q: lambda r: r / (60.0 * q @ q),
    )
    q0 = np.array([-1.02])
    memory = StepMemory(dt=1.0, q=q0, force=force(q0), energy=energy(q0), move=np.array([2.0]))
    options = {"tolerance": 1e-6, "cap": 200, "t": 0.0}
    end, info = implicit_step(problem, q0, np.zeros(1), 1.0, memory=memory, **options)
    assert end[0] < -1.0
    assert info.gain <= 0.0
    assert info.fresh > 0
    # Naive: the nearest stationary point of the guess, with an energy that nobody paid for.
    naive = q0 + 2.0
    for _ in range(100):
        naive = naive + force(naive) / 60.0
    assert abs(force(naive)[0]) < 1e-9
    assert energy(naive) - energy(q0) > 1.5


def test_a_step_that_does_not_converge_says_so():
    f = cs.GalerkinField(system=small(), modes=field().modes, iterations=3, tolerance=1e-10)
    load = f.project(patch_loads(f, 1, seed=7, size=400.0))[0]
    with pytest.raises(IntegrationError, match="cap 3") as caught:
        f.step(np.zeros(f.order), load, 10.0, t=35.0)
    assert caught.value.time == 35.0
    assert caught.value.step == 10.0


# Linear plant


def test_the_plant_is_passive_between_collocated_ports():
    f = field()
    patterns = dict(zip(("a", "b"), patch_loads(f, 2, seed=8, size=1.0), strict=True))
    plant = f.plant(patterns)
    assert plant.dt == 0
    assert plant.input_labels == ["f_a", "f_b"]
    assert plant.output_labels == ["v_a", "v_b"]
    E = f.project(np.array(list(patterns.values())))
    assert np.allclose(plant.B, E.T / f.drag)
    assert cs.poles(plant).real.max() < 0
    for omega in np.logspace(-4, 4, 30):
        H = plant.C @ np.linalg.solve(1j * omega * np.eye(f.order) - plant.A, plant.B) + plant.D
        low = sla.eigvalsh(0.5 * (H + H.conj().T))[0]
        assert low > -1e-12 * np.abs(H).max()
    # The displacement port is the velocity port's integral.
    H = plant.C @ np.linalg.solve(0.1j * np.eye(f.order) - plant.A, plant.B) + plant.D
    u = f.plant(patterns, output="displacement")
    G = u.C @ np.linalg.solve(0.1j * np.eye(f.order) - u.A, u.B)
    assert np.allclose(0.1j * G, H, rtol=1e-9)
    named = f.plant(f.surface[:1])
    assert named.ninputs == 3


def test_the_model_is_the_field_at_rest():
    f = cs.GalerkinField(system=small(), modes=field().modes, linear=True)
    model = f.model()
    assert np.allclose(np.sort(model.poles().real), np.sort(-sla.eigvalsh(f.stiffness) / f.drag))
    q = np.random.default_rng(9).standard_normal(f.order)
    assert np.allclose(model.reconstruct(q), f.displacement(q).ravel(), atol=1e-12)
    assert len(model.blocks["field"]) == 3 * len(f.nodes)
    load = np.random.default_rng(10).standard_normal(f.order)
    settled = model.predict(np.zeros(f.order), load, np.array([0.0, 1e5]))[-1]
    assert np.allclose(f.stiffness @ settled, load, atol=1e-8 * np.abs(load).max())
    # About a loaded state the affine model has the field's own rate there.
    g = field()
    rate = g.force(q) / g.drag
    at = g.model(at=q)
    assert np.allclose(at.A @ q + at.offset, rate, atol=1e-10 * np.abs(rate).max())


def test_passivity_report_sees_an_indefinite_tangent():
    rest = field().passivity(10.0)
    assert rest.passive
    assert rest.index >= -1e-12
    # Squeezed by 10 % on a soft support: compressed fibres push each other sideways.
    soft = small(matrix_elasticity={"law": "linear"}, foundation={"spring": "1 pN/um"})
    f = cs.GalerkinField(system=soft, order=100, **FEW)
    at = f.project(-0.1 * f.nodes * np.array([1.0, 1.0, 0.0]))
    report = f.passivity(10.0, at=at)
    assert report.least_curvature == pytest.approx(sla.eigvalsh(f.tangent(at))[0])
    assert report.least_curvature < report.bound == -2.0 * f.drag / 10.0
    assert report.index < -1e-3
    assert not report.passive
    assert "NOT" in str(report)
    # A smaller step raises the bound until it holds.
    short = 1.9 * f.drag / -report.least_curvature
    assert f.passivity(short, at=at).passive
    # A step from there falls off the saddle and still takes no more than its work.
    load = f.project(patch_loads(f, 1, seed=11, size=10.0))[0]
    end, info = f.step(at, load, 10.0)
    rounding = 1e-10 * f.energy(at)
    assert f.energy(end) - f.energy(at) <= load @ (end - at) + rounding
    assert info.gain <= info.work + rounding


def test_the_full_field_has_the_same_report():
    whole = full()
    assert sp.issparse(whole.modes)
    report = whole.passivity(10.0)
    dense = sla.eigvalsh(whole.stiffness.toarray())
    assert report.least_curvature == pytest.approx(dense[0], rel=1e-4)  # Lanczos at 1e-6
    assert report.passive


# True loads


@pytest.mark.slow
def test_true_loads_of_a_run_give_its_matrix():
    scene = cs.Scene.parse({**table(), "duration": "240 s", "sample": "2 s"})
    run = cs.run_scene(scene)
    truth = run.block("matrix.displacement")
    f = cs.GalerkinField(system=clutch(), order=200)
    loads = f.loads(run)
    whole = cs.full_field(clutch())

    def error(g, every=1):
        u = g.displacement(g.simulate(loads, 2.0, every=every).x)
        return np.linalg.norm(u - truth[::every]) / np.linalg.norm(truth[::every])

    # Averages over 2 s stand at the end of each interval; the rest is the first-order step.
    assert error(whole) < 0.02
    assert error(f) < 0.10
    assert error(f.truncated(50)) > error(f)
    linear = cs.full_field(clutch(), linear=True)
    assert error(linear) > 3.0 * error(whole)
    # Loads at the interval's end take the lag of half an interval away.
    late = whole.simulate(loads, 2.0).x
    met = whole.simulate(whole.loads(run, "end"), 2.0).x
    at = whole.project(truth)
    assert np.linalg.norm(met - at) < 0.7 * np.linalg.norm(late - at)
    with pytest.raises(ParameterError, match="average"):
        f.loads(run, "start")
    # The loads of the run and the matrix's own forces are all there is: C u' = F + loads.
    rate = np.diff(truth, axis=0) / 2.0
    own = run.auxiliary("matrix.matrix_elasticity") + run.auxiliary("matrix.foundation")
    free = ~clutch().matrix.clamped
    left = f.drag * rate - own - loads
    assert np.linalg.norm(left[:, free]) < 0.01 * np.linalg.norm(loads)


# Refusals


def test_what_is_no_matrix_is_refused():
    spec = table(focal_adhesion=None, matrix_elasticity=None, foundation=None,
                 stiffness_sensing=None, polarity=None)  # fmt: skip
    del spec["matrix"]
    with pytest.raises(SceneError, match="no matrix"):
        cs.GalerkinField(system=cs.build(cs.Scene.parse(spec)))
    with pytest.raises(SceneError, match="no elasticity"):
        cs.full_field(
            small(
                matrix_elasticity=None, stiffness_sensing=None, polarity=None, focal_adhesion=None
            )
        )
    with pytest.raises(ParameterError, match="must be a SpreadingSystem, made by"):
        cs.GalerkinField(system={})
    with pytest.raises(SceneError, match="matrix_creep"):
        cs.GalerkinField(system=small(matrix_creep={}))
    with pytest.raises(SceneError, match="external_strain"):
        cs.GalerkinField(system=small(external_strain={}))


def test_bad_arguments_are_refused():
    f = field()
    with pytest.raises(RankError, match="span at most"):
        cs.GalerkinField(system=small(), order=30, places=2, per_place=3)
    for wrong in ({"order": 0}, {"order": 2.5}, {"tolerance": 0.0}, {"slope": float("nan")}):
        with pytest.raises(ParameterError):
            cs.GalerkinField(system=small(), **wrong)
    with pytest.raises(DataError, match="orthonormal"):
        cs.GalerkinField(system=small(), modes=2.0 * f.modes)
    moving = np.array(f.modes)
    moving[np.flatnonzero(np.repeat(small().matrix.clamped, 3))[0]] = 0.1
    with pytest.raises(DataError, match="clamped"):
        cs.GalerkinField(system=small(), modes=moving)
    with pytest.raises(DimensionError, match="modes"):
        cs.GalerkinField(system=small(), modes=f.modes[:-1])
    q = np.zeros(f.order)
    with pytest.raises(DataError, match="NaN"):
        f.step(q, np.full(f.order, np.nan), 1.0)
    with pytest.raises(DimensionError, match="load"):
        f.step(q, q[:-1], 1.0)
    for dt in (0.0, -1.0, float("inf")):
        with pytest.raises(ParameterError, match="dt"):
            f.step(q, q, dt)
    with pytest.raises(DimensionError, match="loads"):
        f.simulate(np.zeros((4, 3)), 1.0)
    with pytest.raises(ParameterError, match="every"):
        f.simulate(np.zeros((4, f.order)), 1.0, every=3)
    with pytest.raises(DimensionError, match="ports"):
        f.plant(np.zeros((2, 3)))
    with pytest.raises(ParameterError, match="port nodes"):
        f.plant(np.array([10**6]))
    with pytest.raises(ParameterError, match="output"):
        f.plant(f.surface[:1], output="power")
    with pytest.raises(ParameterError, match="order"):
        f.truncated(f.order + 1)


@pytest.mark.parametrize("linear", [True, False])
def test_the_estimate_covers_the_error_of_its_steps(linear):
    f = field(linear=linear)
    loads = f.project(patch_loads(f, 6, 3).mean(axis=0, keepdims=True))[0]
    held = np.repeat(loads[None], 12, axis=0)
    run = f.simulate(held, 10.0)
    fine = f.simulate(np.repeat(held, 64, axis=0), 10.0 / 64).x[::64]
    error = np.abs(run.x - fine).max()
    assert error <= run.error.absolute.max() <= 20 * error
    assert "half the step" in str(run)
