"""Roll-outs: every order and reductor, a million seconds, growth, inputs never seen."""

import time
from functools import cache

import mpmath as mp
import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.cell import Equivariant
from cellsys.errors import CellsysError, IntegrationError
from cellsys.integrate import CVODES, simulate
from cellsys.model import LatentModel, TrainedRange
from cellsys.reduction import PCR, TPWL, Contractive, Jacobian, LeastSquares, Ridge, reduce
from cellsys.samples import snapshots
from cellsys.system import OdeSystem
from tests import naive
from tests.cell.runs import data as small_cell
from tests.hard.stress import SEED, Case, Choice, Int, Power, Real, hold
from tests.reduction.systems import one_step_data, spreading_data, stable_matrix

HORIZONS = np.array([0.0, 1.0, 2.0, 10.0, 1e3, 1e6])


def exact_roll(A, b, z0, t):
    """z(t) of z' = A z + b at 60 digits."""
    with mp.workdps(60):
        m = len(A)
        whole = mp.zeros(m + 1)
        for i in range(m):
            for j in range(m):
                whole[i, j] = mp.mpf(float(A[i, j]))
            whole[i, m] = mp.mpf(float(b[i]))
        start = mp.matrix([*map(float, z0), 1.0])
        # rates below 2 1/s: at 1e6 s the exponential is that of a fixed point, found by squaring
        out = mp.expm(whole * mp.mpf(t) / 2**24, method="taylor")
        for _ in range(24):
            out = out * out
        return np.array([float(v) for v in (out * start)[:m]])


def every_order_is_bounded_or_refused(seed, order, method, data):
    """The roll-out over 1e6 s is finite, or refused with its rate before it overflows."""
    made = one_step_data(seed=seed % 20) if data == "small" else spreading_data(seed=seed % 5)
    model = reduce(made, order=order, method=method)
    t = model.dt * np.array([0, 1, 7, 500, round(1e6 / model.dt)])
    z0, z, said = model.z_start, (), None
    try:
        z = model.predict(z0, None, t)
    except IntegrationError as refusal:
        said = refusal
    if not len(z):
        assert model.growth() > 0
        assert f"{model.growth():.3g}" in str(said)
        assert 0 < said.time <= t[-1]
        return
    assert np.all(np.isfinite(z))
    if isinstance(method, Contractive):
        A, _, b = model.step_matrices()
        assert np.abs(np.linalg.eigvals(A)).max() <= 1.0
    if model.growth() < -1e-4:
        # at rest by then: exp(-100)
        A, _, b = model.step_matrices()
        assert np.abs(A @ z[-1] + b - z[-1]).max() < 1e-6 * (1 + np.abs(z[-1]).max())


@cache
def slow_chain():
    """Eight overdamped masses on cubic springs, rates of 1e-5 to 4e-3 1/s, and three runs."""
    n = 8
    W = 1e-3 * (np.eye(n, k=1) - np.eye(n))

    def springs(t, x):
        d = [x[0], *(x[k] - x[k - 1] for k in range(1, n))]
        return [v + 0.5 * v * v * v for v in d]

    names = [f"x{k}" for k in range(n)]
    system = OdeSystem(
        states=names, auxiliaries=[f"f{k}" for k in range(n)], x0=np.linspace(0.3, 2.0, n),
        W_eta=W, law=springs,
    )  # fmt: skip
    starts = [system.x0, *np.random.default_rng(0).uniform(-1, 1, (2, n))]
    t = np.linspace(0.0, 4000.0, 81)
    runs = [simulate(system, CVODES(rtol=1e-9, atol=1e-11), t, x) for x in starts]
    return system, snapshots(runs)


def every_order_of_the_equations(order, method, points):
    """`Jacobian` and `TPWL` over 1e6 s: bounded and at rest, or refused with rate and time."""
    system, data = slow_chain()
    reductor = Jacobian(system) if method == "Jacobian" else TPWL(system, points=points)
    model = reduce(data, order=order, method=reductor)
    assert model.order == order
    z, said = (), None
    try:
        z = model.predict(model.z_start, None, np.array([0.0, 50.0, 4000.0, 5e5, 1e6]))
    except IntegrationError as refusal:
        said = refusal
    if not len(z):
        assert model.growth() > 0
        assert f"{model.growth():.3g}" in str(said)
        assert 0 < said.time <= 1e6
        return
    assert np.all(np.isfinite(z))
    if model.growth() < -1e-5:
        # another 5e5 s move nothing: exp(-5)
        assert np.abs(z[-1] - z[-2]).max() < 0.01 * (1 + np.abs(z[0]).max())
    if order == 8 and method == "TPWL" and points >= 5:
        # a model of every state follows the run itself, but for the blend of tangents
        run = np.asarray(data.runs[0].x)
        z = model.predict(model.encode(run[0]), None, np.array([0.0, 4000.0]))
        assert np.abs(model.reconstruct(z[1]) - run[-1]).max() < 0.2


@pytest.mark.slow
def test_equations_in_explicit_steps():
    every_order_of_the_equations(8, "TPWL", 5)
    system, _ = slow_chain()
    # naive: explicit steps of 2000 s, on rates up to 4e-3 1/s
    assert not np.isfinite(naive.fixed_step_end(system, 1e6, 2000.0)).all()


@cache
def equivariant(order):
    return reduce(small_cell()[0], order=order, method=Equivariant(iterations=3))


def every_equivariant_order_is_bounded(order, amplitude, heading):
    """1e6 s under a constant command, whatever its size: bounded, and flagged where it is new."""
    model = equivariant(order)
    K = round(1e6 / model.dt)
    z = model.simulate_commands(model.z_start, np.full(K, amplitude), np.full(K, heading), 0.0)
    assert np.all(np.isfinite(z))
    shape = np.abs(z[:, :-2]).max(axis=1)  # the centroid may go on
    assert shape[K // 2 :].max() <= 1.01 * shape[: K // 2].max() + 1e-9
    said = model.forecast(np.full(5, amplitude), np.full(5, heading)).flags
    low, high = model.monitor.amplitude
    new = not low - 1e-9 <= amplitude <= high + 0.1 * (high - low) + 1e-9
    if new or low <= amplitude <= high:
        assert any("amplitude" in f.what for f in said) == new


def what_was_never_seen_is_flagged(seed, method, factor, when):
    """An input `factor` ranges above what was trained, from sample `when` on: named then."""
    data = one_step_data(seed=seed % 20, commands=True)
    model = reduce(data, order=6, method=method)
    run = data.runs[0]
    c = np.array(data.commands_of(run, model.input_names))
    t = data.dt * np.arange(len(run.x))
    z = np.tile(model.z_start, (len(t), 1))
    assert model.flags(t, z, c) == []  # what was trained on is not
    which = seed % c.shape[1]
    every = np.concatenate([data.commands_of(r, model.input_names) for r in data.runs])[:, which]
    c[when:, which] = every.max() + factor * np.ptp(every)
    said = model.flags(t, z, c)
    assert [(f.what, f.time) for f in said] == [(f"input {model.input_names[which]}", t[when])]
    assert said[0].value == c[when, which]
    assert said[0].bound == every.max()
    later = model.flags(t + 0.0, z + 1e3 * (t > t[when])[:, None], None)
    assert {f.what for f in later} >= {f"latent state z[{i}]" for i in range(model.order)}
    longer = np.append(t, t[-1] + data.dt)
    assert model.flags(longer, np.tile(model.z_start, (len(longer), 1)))[-1].what.startswith("time")


def test_a_prediction_beyond_what_was_trained_says_nothing_by_itself(tmp_path):
    what_was_never_seen_is_flagged(0, PCR(), 3.0, 5)
    model = reduce(one_step_data(commands=True), order=6, method=PCR())
    again = LatentModel.load(model.save(tmp_path / "m.npz"))
    for name in ("inputs", "latent", "time"):
        kept = (getattr(TrainedRange.kept(m), name) for m in (model, again))
        assert np.array_equal(*kept)
    # naive: numbers for an input a hundred ranges away, and no word
    assert np.isfinite(naive.rolled(model.A, 100 * model.z_start, model.dt, 20)).all()
    with pytest.raises(CellsysError, match="no trained range"):
        LatentModel(A=-np.eye(2)).flags([0.0], [[0.0, 0.0]])


def a_million_seconds_are_exact(seed, rate, m):
    """Continuous and step models at 1e6 s against 60 digits."""
    rng = np.random.default_rng(seed)
    A = stable_matrix(m, rng, slowest=rate, fastest=min(1.0, 100 * rate))
    b, z0 = rng.standard_normal(m), rng.standard_normal(m)
    model = LatentModel(A=A, offset=b)
    got = model.predict(z0, None, HORIZONS)
    for k in (1, 3, 5):
        want = exact_roll(A, b, z0, HORIZONS[k])
        # the fixed point is -A^-1 b: rounding times its condition, and times rate * t of the
        # scaling and squaring before that
        size = np.abs(want).max() + np.abs(z0).max()
        assert np.abs(got[k] - want).max() < 1e-9 * size * np.linalg.cond(A)


def growth_is_refused_before_it_overflows(g, spread, step):
    """z' = g z: refused with g and a time, or right."""
    A = np.array([[g, 0.0], [spread, -1.0]])
    dt = min(0.1 / g, 1.0)
    model = LatentModel(A=A, dt=dt if step else None)
    t = dt * np.array([0, 10, 10**4, 10**7])
    exponent = (np.log1p(g * dt) / dt if step else g) * t
    if 330 < exponent[-1] < 350:
        return  # exp(345) = 1e150 is where it is refused
    if exponent[-1] >= 350:
        with pytest.raises(IntegrationError, match="spectral abscissa"):
            model.predict(np.ones(2), None, t)
        return
    z = model.predict(np.ones(2), None, t)
    assert np.all(np.abs(z[:, 0] / np.exp(exponent) - 1) < 1e-6 * (1 + exponent))


@pytest.mark.parametrize("method", [PCR(), LeastSquares(), Ridge(ridge=1e-3)])
def test_every_order_up_to_the_rank(method):
    data = one_step_data()
    for order in range(1, 15):  # 8 states and 6 laws
        every_order_is_bounded_or_refused(0, order, method, "small")
    with pytest.raises(CellsysError, match=r"rank|beyond"):
        reduce(data, order=15, method=method)


def test_ten_million_steps_between_two_samples_take_no_time():
    """Step model of 0.1 s to 1e6 s: powers, not steps; and the same numbers as steps."""
    rng = np.random.default_rng(0)
    A, b, z0 = stable_matrix(5, rng), rng.standard_normal(5), rng.standard_normal(5)
    model = LatentModel(A=A, offset=b, dt=0.01)
    began = time.process_time()
    z = model.predict(z0, None, np.array([0.0, 1e6]))
    assert time.process_time() - began < 1.0
    assert np.abs(A @ z[-1] + b).max() < 1e-10
    few = model.predict(z0, None, np.array([0.0, 9.99, 15.0]))
    each = model.predict(z0, None, 0.01 * np.arange(1501))
    assert np.abs(few[-2:] - each[[999, 1500]]).max() < 1e-12


def inputs_of_any_size_are_carried(size, m, seed):
    """A linear model answers in proportion, up to where squares would overflow."""
    rng = np.random.default_rng(seed)
    A, B = stable_matrix(m, rng), rng.standard_normal((m, 2))
    model = LatentModel(A=A, B=B)
    t = np.array([0.0, 1.0, 5.0, 100.0])
    one = model.predict(np.zeros(m), np.array([1.0, -1.0]), t)
    many = model.predict(np.zeros(m), size * np.array([1.0, -1.0]), t)
    assert np.abs(many - size * one).max() <= 1e-12 * size * np.abs(one).max() * (1 + m)


def test_a_million_seconds():
    a_million_seconds_are_exact(0, 1e-3, 4)
    rng = np.random.default_rng(0)
    A = stable_matrix(4, rng, slowest=1e-3, fastest=0.1)
    z0 = rng.standard_normal(4)
    # naive: steps of 1 s instead of the exponential
    off = naive.rolled(A, z0, 1.0, 10) - exact_roll(A, np.zeros(4), z0, 10.0)
    assert np.abs(off).max() > 1e-3


def test_inputs_of_any_size():
    inputs_of_any_size_are_carried(1e-100, 3, 0)
    A = stable_matrix(3, np.random.default_rng(0))
    want = np.linalg.solve(A, sla.expm(5.0 * A) - np.eye(3)) @ np.ones(3)
    # naive: one absolute tolerance for numbers of any size
    got = naive.integrated_with_one_tolerance(A, 1e-9 * np.ones(3), 5.0) / 1e-9
    assert np.abs(got - want).max() > 1e-3 * np.abs(want).max()


def test_growth_unseen():
    """A rate of 0.5 1/s for 1e4 s: refused; steps without a look end in inf."""
    growth_is_refused_before_it_overflows(0.5, 1.0, step=True)
    assert not np.isfinite(naive.rolled(np.diag([0.5, -1.0]), np.ones(2), 0.2, 10**4)).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_refused(bad):
    model = LatentModel(A=-np.eye(2), B=np.eye(2))
    for z0, u in ((np.array([bad, 0]), None), (np.zeros(2), np.array([0.0, bad]))):
        with pytest.raises(CellsysError, match="NaN or inf"):
            model.predict(z0, u, np.array([0.0, 1.0]))


CASES = (
    Case(
        "every order",
        every_order_is_bounded_or_refused,
        {
            "order": Int(1, 14),
            "method": Choice(
                PCR(), LeastSquares(), Ridge(ridge=1e-3), Contractive(iterations=3),
                Contractive(loss="one-step", iterations=20),
            ),
            "data": Choice("small", "spreading"),
            "seed": SEED,
        },
    ),
    Case(
        "every order of the equations",
        every_order_of_the_equations,
        {
            "order": Int(1, 8),
            "method": Choice("Jacobian", "TPWL"),
            "points": Choice(1, 5, 20),
        },
    ),
    Case(
        "every equivariant order",
        every_equivariant_order_is_bounded,
        {"order": Int(5, 40), "amplitude": Power(-3, 3), "heading": Real(-7, 7)},
        seconds=120.0,  # the first one makes the training runs
    ),
    Case(
        "inputs never seen",
        what_was_never_seen_is_flagged,
        {
            "seed": SEED,
            "method": Choice(PCR(), LeastSquares(), Ridge(ridge=1e-3), Contractive(iterations=3)),
            "factor": Power(-0.8, 6),
            "when": Int(0, 35),
        },
    ),
    Case(
        "a million seconds",
        a_million_seconds_are_exact,
        {"rate": Power(-6, 0), "m": Int(2, 5), "seed": SEED},
    ),
    Case(
        "growth",
        growth_is_refused_before_it_overflows,
        {"g": Power(-6, 2), "spread": Real(0, 10), "step": Choice(False, True)},
    ),
    Case(
        "inputs of any size",
        inputs_of_any_size_are_carried,
        {"size": Power(-100, 100), "m": Int(2, 6), "seed": SEED},
    ),
)  # fmt: skip


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, marks=pytest.mark.slow if "equ" in c.name else ()) for c in CASES],
    ids=lambda c: c.name,
)
def test_random_instances(case):
    hold(case, 4)
