"""Polarity: antiparallel and within rounding of it, no direction, long runs, the normal, wraps."""

import mpmath as mp
import numpy as np
import pytest

from cellsys.errors import CellsysError
from cellsys.integrate import CVODES, DOP853, Exponential, simulate
from cellsys.laws.polarity import exact_steps, heading_features, heading_rows
from cellsys.loop import AntiparallelTurn, MPol, PolarityLaw
from cellsys.system import Block, OdeSystem
from tests import naive
from tests.hard.stress import SEED, Case, Choice, Power, Real, hold
from tests.loop.systems import make
from tests.loop.test_polarity import between, unit

X, Y, Z = np.eye(3)


def exact(p, d, kappa, dt):
    """tan(theta/2) decays by exp(-kappa |p| |d| dt), 60 digits [notes: theory, polarity law]."""
    with mp.workdps(60):
        a, b = mp.matrix([mp.mpf(float(v)) for v in p]), mp.matrix([mp.mpf(float(v)) for v in d])
        n, m = mp.norm(a), mp.norm(b)
        a, b = a / n, b / m
        s, r = mp.norm(a + b) ** 2 / 2, mp.norm(a - b) ** 2 / 2
        if s == 0:
            return p
        E = mp.exp(-mp.mpf(kappa) * n * m * mp.mpf(dt))
        c = (a.T * b)[0]
        out = n * (2 * E * (a - c * b) + (s - E**2 * r) * b) / (s + E**2 * r)
        return np.array([float(v) for v in out])


def near(direction, gap, azimuth):
    """A unit vector `gap` rad from the opposite of `direction`."""
    d = np.asarray(direction) / np.linalg.norm(direction)
    side = np.cross(d, Z if abs(d[2]) < 0.9 else X)
    side /= np.linalg.norm(side)
    other = np.cross(d, side)
    across = np.cos(azimuth) * side + np.sin(azimuth) * other
    return -np.cos(gap) * d + np.sin(gap) * across


def step_is_exact(gap, azimuth, elevation, size, strength, tau):
    """One step from `gap` rad off the antipode, against 60 digits.

    p is a double: gap is known to 1e-16 absolutely, relative 1e-16/gap, and leaves as exp(tau).
    """
    d = strength * unit(0.7, elevation)
    p = size * near(d, gap, azimuth)
    law = PolarityLaw(kappa=0.05)
    dt = tau / (0.05 * size * strength)
    got, want = law.step(p, d, dt), exact(p, d, 0.05, dt)
    assert abs(np.linalg.norm(got) - size) < 4e-15 * size
    # The direction depends on the gap by d(theta) = sin(theta) d(gap)/gap <= 1e-16/gap * 20.
    rows = exact_steps(p[None], d[None], 0.05, dt)[0]
    bound = min(2.1, 1e-14 + 2e-15 / max(gap, 1e-300)) * size
    assert np.abs(got - want).max() < bound
    assert np.abs(rows - want).max() < bound


@pytest.mark.parametrize("gap", [1.0, 1e-4, 1e-7, 1e-10, 1e-12])
def test_near_the_antipode(gap):
    law = PolarityLaw(kappa=1.0)
    p, tau = np.array([-np.cos(gap), np.sin(gap), 0.0]), np.log(1.0 / gap)
    got, want = law.step(p, X, tau), exact(p, X, 1.0, tau)
    # the gap is stored as a component, to 1e-16 relative: nothing is lost at any of them
    assert np.abs(got - want).max() < 2e-13
    if gap <= 1e-8:
        # naive: the angle by arccos is 0 or wrong by its square root of rounding
        lost = naive.polarity_by_angle(p, X, 1.0, tau)
        assert np.abs(lost - want).max() > 0.1
    for p_exact in (-X, -Y, np.array([0.0, 0.0, -3.0])):
        assert np.array_equal(law.step(p_exact, -p_exact, 1e7), p_exact)
    leaves = PolarityLaw(kappa=1.0, antiparallel=AntiparallelTurn(seed=3)).step(-X, X, 20.0)
    assert between(leaves, X) < 1e-5


def test_no_direction_and_huge_or_tiny_ones():
    law = PolarityLaw(kappa=1 / 60)
    assert np.array_equal(law.step(Y, np.zeros(3), 1e7), Y)
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        for size in (1e-300, 1e-160, 1e-8, 1e8, 1e150, 1e300):
            got = law.step(Y, size * X, 30.0)
            want = exact(Y, size * X, 1 / 60, 30.0) if 1e-20 < size < 1e20 else None
            assert abs(np.linalg.norm(got) - 1.0) < 1e-15
            if want is not None:
                assert np.abs(got - want).max() < 1e-15
            elif size < 1e-20:
                assert np.abs(got - Y).max() < 1e-15
            else:
                assert np.abs(got - X).max() < 1e-15
    assert np.isnan(naive.normalised_direction(np.zeros(3))).all()


def rows_are_steps(seed, exponent):
    """`exact_steps` is `exact_step`, row by row, with zeros and antipodes among them."""
    rng = np.random.default_rng(seed)
    p = rng.standard_normal((12, 3))
    d = rng.standard_normal((12, 3)) * exponent
    p[0], d[1], d[2] = 0.0, 0.0, -p[2] * exponent
    p[3] = [0.0, 0.0, 1.0]
    law = PolarityLaw(kappa=0.1)
    dt = 5.0 / exponent
    rows = exact_steps(p, d, 0.1, dt)
    for k in range(12):
        # 4e-16: the two sum their squares in different orders; a row 1e-6 from the antipode
        # would multiply that by 1e6, and random ones are not that near
        one = law.step(p[k], d[k], dt)
        theta = between(p[k], d[k]) if np.any(p[k]) and np.any(d[k]) else 0.0
        if k == 2:
            continue  # -p times a rounded factor: on the antipode or beside it, either is right
        assert np.abs(rows[k] - one).max() < 1e-13 * (1 + np.tan(min(theta, 3.14) / 2))
        assert abs(np.linalg.norm(rows[k]) - np.linalg.norm(p[k])) < 1e-14


@pytest.mark.parametrize("ratio", [1.0, 10.0, 1e3])
def test_a_direction_that_turns_faster_than_the_polarity_follows(ratio):
    """d at rate w > kappa: p lags; many steps of the exact law against DOP853 on the law itself."""
    kappa, w = 1 / 60, ratio / 60
    law = PolarityLaw(kappa=kappa)

    def direction(t):
        return np.array([np.cos(w * t), np.sin(w * t), 0.0])

    system = OdeSystem(
        states=[Block("p", (3,))], x0=Y, forcing=lambda t, p: law.rate(p, direction(t))
    )
    t = np.linspace(0.0, 20.0 / w, 3)
    want = simulate(system, DOP853(rtol=1e-12, atol=1e-13), t).x[-1]

    def error(n):
        p, h = Y.copy(), t[-1] / n
        for k in range(n):
            p = law.step(p, direction((k + 0.5) * h), h)
        assert abs(np.linalg.norm(p) - 1) < 1e-14
        return np.abs(p - want).max()

    # midpoint of d: second order in w h; the first is already small where w >> kappa
    coarse, fine = error(400), error(1600)
    assert fine < coarse / 12
    assert fine < 1e-4
    if ratio == 1.0:
        # naive: explicit steps grow by (kappa h)^2/2 each
        h = t[-1] / 400
        grown = naive.euler_polarity(Y, [direction(k * h) for k in range(400)], kappa, h)
        assert np.linalg.norm(grown) > 1.01


@pytest.mark.parametrize(
    ("method", "end"),
    [
        (Exponential(rtol=1e-6, atol=1e-8), 1e5),
        # the heading is explicit there: a step of 300 s at rest
        pytest.param(Exponential(rtol=1e-6, atol=1e-8), 1e7, marks=pytest.mark.slow),
        (CVODES(rtol=1e-8, atol=1e-10), 1e7),
    ],
)
def test_a_run_of_ten_million_seconds(method, end):
    """z and p arrive at an equilibrium of the loop and stay: |p| = 1, no drift, few steps."""
    loop = make(seed=2, kappa=1 / 60)
    run = loop.simulate(np.array([0.0, end / 10, end]), method)
    p = run.x[:, -3:]
    # CVODES keeps |p| within its tolerance a step; the last 9e6 s are at rest
    assert np.abs(np.linalg.norm(p, axis=1) - 1).max() < 1e-5
    z, p = run.x[-1, :-3], run.x[-1, -3:] / np.linalg.norm(run.x[-1, -3:])
    A, B, b = loop.model.continuous_matrices()
    assert np.abs(A @ z + B @ loop.commands(p) + b).max() < 1e-4
    assert np.abs(loop.controller.rate(p, loop.sensed(z))).max() < 1e-5
    drifted = naive.euler_polarity(unit(0.3, 0.2), [unit(2.0, 0.4)] * 3, 1 / 60, 500.0)
    assert not abs(np.linalg.norm(drifted) - 1.0) < 1.0


@pytest.mark.parametrize("tilt", [0.0, 1e-16, 1e-12, 1e-8])
def test_p_along_the_substrate_normal(tilt):
    """No heading: the loop says so or gives finite numbers; never NaN."""
    p = np.array([tilt, 0.0, 1.0])
    rng = np.random.default_rng(0)
    table = MPol(rng.standard_normal((9, 360)))
    assert np.all(np.isfinite(table.at(p)))
    if tilt == 0.0:
        assert not table.at(p).any()
        assert np.isnan(naive.heading_by_quotient(p)).any()
    loop, t = make(seed=1), np.array([0.0, 1.0, 60.0])
    if tilt == 0.0:
        with pytest.raises(CellsysError, match="normal to the substrate"):
            loop.simulate(t, CVODES(rtol=1e-8, atol=1e-8), p0=p)
        return
    run = loop.simulate(t, CVODES(rtol=1e-8, atol=1e-8), p0=p)
    assert np.all(np.isfinite(run.x))
    assert np.all(np.isfinite(heading_features(p)))
    assert np.all(np.isfinite(heading_rows(p[None])))


def heading_is_one_turn(theta, wraps):
    """theta and theta + 360 n degrees are one heading, for features, maps and the loop's inputs."""
    turned = theta + 2 * np.pi * wraps
    p, q = (np.array([np.cos(a), np.sin(a), 0.0]) for a in (theta, turned))
    # cos of an angle of n turns is known to n rounding units
    tol = 1e-15 * (2 + 2 * np.pi * abs(wraps)) * 4
    assert np.abs(heading_features(p) - heading_features(q)).max() < tol
    assert np.abs(heading_features(p) - heading_rows(p[None])[0]).max() < 1e-15 * 4
    angle = np.arange(360) * np.pi / 180
    table = MPol(np.array([np.cos(angle), np.sin(angle), 0 * angle]))
    # linear interpolation over one degree: (pi/180)^2 / 8 = 3.8e-5
    assert np.abs(table.at(p) - p).max() < 4e-5
    assert np.abs(table.at(q) - table.at(p)).max() < tol * 60


def test_the_wrap_at_zero():
    angle = np.arange(360) * np.pi / 180
    table = MPol(np.array([np.cos(angle), np.sin(angle), 0 * angle]))
    for small in (0.0, 1e-18, 1e-12, 1e-3):
        for sign in (1, -1):
            p = np.array([np.cos(small), sign * np.sin(small), 0.0])
            assert np.abs(table.at(p) - p).max() < 4e-5
    # naive: interpolation without the wrap jumps by a whole column across 360
    p = np.array([np.cos(-0.005), np.sin(-0.005), 0.0])
    assert np.abs(naive.unwrapped_table(table.table, p) - p).max() > 0.5


def test_an_input_map_with_a_jump():
    """A lamellipodium that is on for headings in the upper half only: both sides of the jump, and
    interpolation never leaves the range of its columns."""
    table = np.zeros((3, 360))
    table[0, :180] = 1.0
    for lookup in ("interpolate", "nearest"):
        found = MPol(table, lookup)
        values = [found.at(unit(a, 0.0))[0] for a in np.linspace(-np.pi, np.pi, 2001)]
        assert min(values) >= 0.0
        assert max(values) <= 1.0
        assert found.at(unit(1e-9, 0.0))[0] == pytest.approx(1.0, abs=1e-6)
        assert found.at(unit(np.radians(179.4), 0.0))[0] == pytest.approx(
            0.6 if lookup == "interpolate" else 1.0
        )
    # naive: a trigonometric fit of order 2 overshoots the jump (Gibbs)
    fitted = naive.trigonometric_fit(table[0])
    assert max(fitted) > 1.05
    assert min(fitted) < -0.05


def a_loop_stays_finite(seed, gain, kappa, normalise, start):
    """Random loops, from weak to strong: bounded z, |p| kept, or a refusal with its reason."""
    loop = make(seed=seed, kappa=kappa, gain=gain, normalise=normalise)
    p0 = {
        "random": unit(seed, 0.0),
        "antiparallel": -loop.sensed(loop.z0) / np.linalg.norm(loop.sensed(loop.z0)),
        "near": near(loop.sensed(loop.z0), 1e-12, 0.0),
    }[start]
    t = np.linspace(0.0, 600.0, 13)
    tight = loop.simulate(t, CVODES(rtol=1e-9, atol=1e-11), p0=p0)
    ours = loop.simulate(t, Exponential(rtol=1e-7, atol=1e-9), p0=p0)
    assert np.all(np.isfinite(tight.x))
    # samples inside a step are interpolated: |p| to a hundred tolerances
    assert np.abs(np.linalg.norm(ours.x[:, -3:], axis=1) - 1).max() < 1e-5
    # two codes that share nothing but the law; near the antipode both amplify the start alike
    if start == "random":
        assert np.abs(ours.x - tight.x).max() < 1e-3 * (1 + np.abs(tight.x).max())
    assert np.abs(ours.x).max() < 1e4


def test_explicit_steps_of_a_strong_loop():
    a_loop_stays_finite(3, 10.0, 0.3, False, "random")
    loop = make(seed=3, kappa=0.3, gain=10.0, normalise=False)
    # naive: explicit Euler, a step of 10 s
    assert not np.isfinite(naive.fixed_step_end(loop.system, 6000.0, 10.0)).all()


CASES = (
    Case(
        "step near the antipode",
        step_is_exact,
        {
            "gap": Power(-12, 0.4),
            "azimuth": Real(0, 6.28),
            "elevation": Real(-1.5, 1.5),
            "size": Power(-1, 1),
            "strength": Power(-6, 6),
            "tau": Power(-8, 2.5),
        },
    ),
    Case("rows of steps", rows_are_steps, {"seed": SEED, "exponent": Power(-8, 8)}),
    Case(
        "heading wraps",
        heading_is_one_turn,
        {"theta": Real(-7, 7), "wraps": Choice(0, 1, -1, 100)},
    ),
    Case(
        "closed loop",
        a_loop_stays_finite,
        {
            "seed": SEED,
            "gain": Power(-2, 1),
            "kappa": Power(-4, -0.5),
            "normalise": Choice(True, False),
            "start": Choice("random", "antiparallel", "near"),
        },
    ),
)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_random_instances(case):
    hold(case, 6)
