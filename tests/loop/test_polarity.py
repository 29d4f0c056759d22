"""The polarity law: tan(theta/2), |p| kept, both degenerate directions, agreement with CVODES."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.integrate import CVODES, simulate
from cellsys.loop import AntiparallelStay, AntiparallelTurn, PolarityLaw
from cellsys.system import Block, OdeSystem
from tests import naive

angles = st.floats(-np.pi, np.pi)


def unit(azimuth, elevation):
    c = np.cos(elevation)
    return np.array([c * np.cos(azimuth), c * np.sin(azimuth), np.sin(elevation)])


def between(p, d):
    """Angle of two vectors, accurate at 0 and at pi (Kahan)."""
    a, b = p / np.linalg.norm(p), d / np.linalg.norm(d)
    return 2.0 * np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b))


sizes = st.floats(0.1, 5.0)


@given(angles, angles, angles, angles, sizes, sizes, st.floats(0.0, 8.0))
def test_half_angle_decays_exponentially(a, b, c, e, size, strength, tau):
    p, d = size * unit(a, b), strength * unit(c, e)
    law = PolarityLaw(kappa=0.3)
    dt = tau / (0.3 * size * strength)
    theta = between(p, d)
    if theta > np.pi - 1e-2:
        return  # tan diverges: the antiparallel tests
    got = law.step(p, d, dt)
    expected = 2.0 * np.arctan(np.tan(0.5 * theta) * np.exp(-tau))
    # rounding of the unit vectors, amplified by at most tan(theta/2) = 200
    assert abs(between(got, d) - expected) < 1e-12 * (1.0 + np.tan(0.5 * theta))
    assert abs(np.linalg.norm(got) - size) < 4e-16 * size * 4
    # p turns in the plane of p and d
    assert abs(np.dot(got, np.cross(p, d))) < 1e-12 * size**2 * strength


@given(angles, angles, st.floats(0.01, 3.0), st.floats(0.01, 3.0))
def test_two_steps_are_one(a, c, first, second):
    p, d = unit(a, 0.2), unit(c, -0.4)
    law = PolarityLaw(kappa=1.0)
    # away from the antipode, where one rounding error grows by exp(t)
    if between(p, d) > np.pi - 0.1:
        return
    assert (
        np.abs(law.step(law.step(p, d, first), d, second) - law.step(p, d, first + second)).max()
        < 1e-12
    )


def test_length_is_kept_over_a_million_steps():
    """|p| to 1e-12 over 1e6 steps towards directions that keep changing; Euler drifts."""
    rng = np.random.default_rng(0)
    law = PolarityLaw(kappa=1 / 60)
    azimuth = rng.uniform(0, 2 * np.pi, 1000)
    directions = [unit(a, 0.3 * np.sin(a)) for a in azimuth]
    p = unit(0.3, 0.2)
    step = law.step
    for k in range(60_000):
        p = step(p, directions[k % 1000], 0.5)
    # every step renormalises: rounding does not add up
    assert abs(np.linalg.norm(p) - 1.0) < 1e-12
    drifted = naive.euler_polarity(unit(0.3, 0.2), directions, 1 / 60, 0.5)
    assert abs(np.linalg.norm(drifted) - 1.0) > 1e-3


@pytest.mark.slow
def test_length_is_kept_over_200_000_steps_in_full():
    """More of the law itself: tests/laws."""
    rng = np.random.default_rng(0)
    law = PolarityLaw(kappa=1 / 60)
    directions = [unit(a, 0.3 * np.sin(a)) for a in rng.uniform(0, 2 * np.pi, 1000)]
    p = unit(0.3, 0.2)
    for k in range(200_000):
        p = law.step(p, directions[k % 1000], 0.5)
    assert abs(np.linalg.norm(p) - 1.0) < 1e-12


def test_antiparallel_stay():
    law = PolarityLaw(kappa=1 / 60, antiparallel=AntiparallelStay())
    for p in (np.array([1.0, 0, 0]), np.array([0.0, 0, 2.0]), np.array([0.0, -3.0, 0])):
        for size in (1e-8, 1.0, 1e8):
            assert np.array_equal(law.step(p, -size * p, 1e9), p)
            assert (
                np.array_equal(law.rate(p, -p), np.zeros(3))
                or np.abs(law.rate(p, -p)).max() < 1e-15
            )


def test_near_the_antipode_p_leaves_as_an_exponential():
    """pi - theta grows as exp(kappa |p| |d| t) while it is small."""
    law, gap = PolarityLaw(kappa=1.0), 1e-6
    d = np.array([1.0, 0, 0])
    p = -unit(gap, 0.0)
    for t in (1.0, 3.0, 6.0):
        angle = np.pi - between(law.step(p, d, t), d)
        # tan against its argument: angle^2 / 12 = 1e-8 relative; pi - theta cancels 6 digits
        assert abs(angle / (gap * np.exp(t)) - 1.0) < 1e-7


def test_perturb_leaves_the_antipode_the_same_way_every_time():
    d, p = np.array([1.0, 0, 0]), np.array([-1.0, 0, 0])
    sides = set()
    for seed in range(8):
        law = PolarityLaw(kappa=1.0, antiparallel=AntiparallelTurn(seed=seed))
        first = law.step(p, d, 0.1)
        assert np.array_equal(first, law.step(p, d, 0.1))
        assert np.array_equal(
            first, PolarityLaw(kappa=1.0, antiparallel=AntiparallelTurn(seed=seed)).step(p, d, 0.1)
        )
        assert first[1] != 0.0
        assert first[2] == 0.0
        assert abs(np.linalg.norm(first) - 1.0) < 1e-15
        # 0.01 rad, then the exact step
        assert abs(np.tan((np.pi - between(first, d)) / 2) - np.tan(0.005) * np.exp(0.1)) < 1e-12
        sides.add(np.sign(first[1]))
    assert sides == {-1.0, 1.0}
    away = unit(0.5, 0.0)
    law = PolarityLaw(kappa=1.0, antiparallel=AntiparallelTurn(seed=1))
    assert np.array_equal(law.step(away, d, 0.1), PolarityLaw(kappa=1.0).step(away, d, 0.1))
    assert np.array_equal(law.step(p, np.zeros(3), 1.0), p)


@pytest.mark.parametrize(
    "options",
    [
        {"angle": 0.0},
        {"angle": 4.0},
        {"angle": float("nan")},
        {"within": 2.0},
        {"within": float("nan")},
    ],
)
def test_perturb_refuses(options):
    with pytest.raises(ParameterError, match="AntiparallelTurn"):
        AntiparallelTurn(**options)


def test_no_direction_and_no_heading():
    law = PolarityLaw()
    p = np.array([0.6, 0.8, 0.0])
    assert np.array_equal(law.step(p, np.zeros(3), 10.0), p)
    assert np.array_equal(law.rate(p, np.zeros(3)), np.zeros(3))
    assert np.array_equal(law.step(np.zeros(3), p, 10.0), np.zeros(3))
    up = np.array([0.0, 0.0, 1.0])
    got = law.step(up, p, 60.0)
    assert abs(np.linalg.norm(got) - 1.0) < 1e-15
    assert abs(np.tan(between(got, p) / 2) - np.exp(-1.0)) < 1e-12
    assert (
        np.array_equal(law.step(p, p, 7.0), p) or np.abs(law.step(p, p, 7.0) - p).max() < 1e-16 * 4
    )
    assert np.array_equal(law.step(p, up, 0.0), p)
    assert np.abs(law.step(p, up, 1e6) - up).max() < 1e-15  # E underflows to 0: arrived


def test_refusals():
    law, p = PolarityLaw(), np.array([1.0, 0, 0])
    for bad in (float("nan"), float("inf")):
        broken = np.array([0.0, bad, 0.0])
        for arguments in ((broken, p, 1.0), (p, broken, 1.0), (p, p, bad)):
            with pytest.raises(DataError, match="not finite"):
                law.step(*arguments)
        with pytest.raises(ParameterError, match="kappa"):
            PolarityLaw(kappa=bad)
    with pytest.raises(ParameterError, match="kappa"):
        PolarityLaw(kappa=-1e-3)
    with pytest.raises(DimensionError, match=r"shape \(3,\)"):
        law.step(p[:2], p, 1.0)


def test_rate_is_the_same_in_numpy_and_casadi():
    law = PolarityLaw(kappa=0.7)
    rng = np.random.default_rng(1)
    p, d = ca.SX.sym("p", 3), ca.SX.sym("d", 3)
    symbolic = ca.Function("rate", [p, d], [law.rate(p, d)])
    for _ in range(20):
        a, b = rng.standard_normal(3), rng.standard_normal(3)
        want = 0.7 * np.cross(a, np.cross(b, a))
        assert np.abs(law.rate(a, b) - want).max() < 1e-14 * 10
        assert np.abs(np.array(symbolic(a, b)).ravel() - law.rate(a, b)).max() < 1e-14 * 10


def test_exact_step_is_the_solution_of_the_rate():
    law = PolarityLaw(kappa=1 / 60)
    p0, d = unit(2.5, 0.3), 1.3 * unit(-0.4, -0.2)

    system = OdeSystem(
        states=[Block("p", (3,))],
        x0=p0,
        W_x=np.zeros((3, 3)),
        forcing=lambda t, x: list_of(law.rate(x, ca.DM(d) if is_symbol(x) else d)),
    )

    def is_symbol(x):
        return not isinstance(x, np.ndarray)

    def list_of(v):
        return [v[i] for i in range(3)]

    t = np.array([0.0, 30.0, 90.0, 240.0])
    run = simulate(system, CVODES(rtol=1e-11, atol=1e-12), t)
    for k in range(1, 4):
        # CVODES at rtol 1e-11: global error a few hundred times that
        assert np.abs(law.step(p0, d, t[k]) - run.x[k]).max() < 1e-8
