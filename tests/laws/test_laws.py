"""The laws alone: polarity, fibre, clutch, Bell bonds, lamellipodium, sensed direction."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from cellsys.laws.bell import (
    CAP,
    bell_off_rate,
    bond_number_rate,
    bond_number_step,
    contraction_rate,
    contraction_step,
)
from cellsys.laws.clutch import binding_rate, unbinding_rate
from cellsys.laws.fibre import NEVER, axial, axial_energy
from cellsys.laws.lamellipodium import protrusion, smoothstep
from cellsys.laws.polarity import exact_step, heading_features, rate
from cellsys.laws.sensing import (
    contrast,
    cue,
    cue_rows,
    cue_slope,
    fibre_ends,
    graded,
    measure_moment,
    nodal_mean,
    stiffest_direction,
    stress_direction,
    ungraded,
)
from tests.naive import euler_polarity

angles = st.floats(-3.1, 3.1)
KAPPA = 1.0 / 60.0


def unit(theta, z=0.0):
    v = np.array([np.cos(theta), np.sin(theta), z])
    return v / np.linalg.norm(v)


# Polarity


@given(angles, angles, st.floats(0.0, 2000.0))
def test_half_angle_law(theta_p, theta_d, time):
    """tan(theta/2) falls by exp(-kappa t), to 1e-12 of a turn."""
    p, d = unit(theta_p), unit(theta_d)
    theta = np.arctan2(p[0] * d[1] - p[1] * d[0], p @ d)
    turned = exact_step(p, d, KAPPA, time)
    left = np.arctan2(turned[0] * d[1] - turned[1] * d[0], turned @ d)
    # atan of the law, so that theta near pi does not divide by zero.
    expected = 2.0 * np.arctan(np.tan(0.5 * theta) * np.exp(-KAPPA * time))
    # Near the unstable heading tan(theta/2) amplifies the rounding of p and d (2e-16) by
    # d theta/d theta_0 <= |tan(theta_0/2)| + 1.
    slack = 1e-12 + 4e-16 * (1.0 + np.tan(0.5 * abs(theta)) ** 2)
    assert abs(left - expected) < slack


@given(angles, angles, st.floats(0.1, 50.0), st.floats(0.1, 50.0))
def test_two_steps_are_one(theta_p, theta_d, a, b):
    p, d = unit(theta_p), unit(theta_d)
    once = exact_step(p, d, KAPPA, a + b)
    twice = exact_step(exact_step(p, d, KAPPA, a), d, KAPPA, b)
    # The unstable heading amplifies rounding as above.
    theta = abs(np.arctan2(p[0] * d[1] - p[1] * d[0], p @ d))
    assert np.abs(once - twice).max() < 1e-13 * (1.0 + np.tan(0.5 * theta) ** 2)


def test_exact_step_solves_the_differential_equation():
    p, d = unit(0.3, 0.2), unit(2.9, -0.4)
    run = solve_ivp(
        lambda t, y: rate(y, d, KAPPA), (0, 200), p, rtol=1e-12, atol=1e-14, method="DOP853"
    )
    # Local tolerance 1e-12, a contracting equation: global error stays near it.
    assert np.abs(run.y[:, -1] - exact_step(p, d, KAPPA, 200.0)).max() < 1e-11


@pytest.mark.parametrize("n", [20_000, pytest.param(300_000, marks=pytest.mark.slow)])
def test_length_is_kept_over_many_steps(n):
    """|p| within 1e-12 after 1e6 steps, d turning all the time; explicit Euler is seen to drift."""
    p = unit(0.7)
    heading = np.linspace(0.0, 40.0, n)
    directions = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(n)])
    worst = 0.0
    for k in range(n):
        p = exact_step(p, directions[k], KAPPA, 0.5)
        if k % 1000 == 0:
            worst = max(worst, abs(np.linalg.norm(p) - 1.0))
    assert max(worst, abs(np.linalg.norm(p) - 1.0)) < 1e-12
    drifted = euler_polarity(unit(0.7), directions[:1000], KAPPA, 0.5)
    assert abs(np.linalg.norm(drifted) - 1.0) > 1e-6


def test_length_of_any_vector_is_kept():
    p = 3.0 * unit(0.2, 0.5)
    turned = exact_step(p, 0.1 * unit(2.0), KAPPA, 30.0)
    assert np.linalg.norm(turned) == pytest.approx(3.0, rel=1e-15)


@pytest.mark.parametrize("theta", [0.0, 0.4, np.pi])
def test_both_equilibria_stay(theta):
    p = unit(theta)
    assert exact_step(p, p, KAPPA, 1e4) == pytest.approx(p, abs=1e-15)
    back = exact_step(p, -p, KAPPA, 1e4)
    assert back == pytest.approx(p, abs=1e-15)
    assert np.abs(rate(p, -p, KAPPA)).max() < 1e-17


@pytest.mark.parametrize(("p", "d"), [((0, 0, 0), (1, 0, 0)), ((1, 0, 0), (0, 0, 0))])
def test_nothing_turns_without_a_direction(p, d):
    assert np.array_equal(exact_step(np.array(p, float), np.array(d, float), KAPPA, 5.0), p)


def test_the_law_is_the_triple_product():
    rng = np.random.default_rng(0)
    p, d = rng.standard_normal((2, 3))
    assert rate(p, d, 2.0) == pytest.approx(2.0 * np.cross(p, np.cross(d, p)), rel=1e-13)


def test_symbols_and_numbers_agree():
    import casadi as ca

    rng = np.random.default_rng(1)
    p, d = rng.standard_normal((2, 3))
    P, D = ca.SX.sym("p", 3), ca.SX.sym("d", 3)
    f = ca.Function("f", [P, D], [rate(P, D, 0.1), heading_features(P, 3)])
    r, features = (np.asarray(v).ravel() for v in f(p, d))
    assert r == pytest.approx(rate(p, d, 0.1), rel=1e-14)
    assert features == pytest.approx(heading_features(p, 3), rel=1e-14)
    theta = np.arctan2(p[1], p[0])
    expected = [g(k * theta) for k in (1, 2, 3) for g in (np.cos, np.sin)]
    assert features == pytest.approx(expected, abs=1e-14)


# Fibre

LAWS = {
    "linear": (1.0, 0.002, NEVER, 0.0),
    "buckling": (0.3, 0.002, NEVER, 9.0),
    "stiffening": (0.3, 0.002, 0.05, 9.0),
}
strains = st.floats(-0.9, 2.0)


@pytest.mark.parametrize("name", LAWS)
@given(e=strains)
def test_fibre_force_is_the_slope_of_its_energy(name, e):
    law, h = LAWS[name], 1e-5
    g, slope = axial(e, *law)
    # Central differences: h^2/6 of the third derivative (<= 1/blend^2 near 0) plus rounding eps/h.
    third = 0.35 / max(abs(e), law[1]) ** 2 if name != "linear" else 0.0
    by_difference = (axial_energy(e + h, *law) - axial_energy(e - h, *law)) / (2 * h)
    assert by_difference == pytest.approx(
        g, abs=h * h * (third + 20) + 1e-15 / h * (1 + e * e * 10)
    )
    g_up, g_down = axial(e + h, *law)[0], axial(e - h, *law)[0]
    kink = 10 * h / 0.05 if name == "stiffening" else 0.0  # the slope's own slope jumps at onset
    fourth = 0.35 / max(abs(e), law[1]) ** 3 if name != "linear" else 0.0
    assert (g_up - g_down) / (2 * h) == pytest.approx(slope, abs=h * h * fourth + kink + 1e-9)


@pytest.mark.parametrize("name", LAWS)
def test_fibre_energy_is_the_integral_of_its_force(name):
    for e in (-0.3, -0.001, 0.0005, 0.04, 0.3, 1.5):
        exact, bound = quad(
            lambda q: axial(q, *LAWS[name])[0], 0.0, e, limit=200, epsabs=1e-13, points=[e / 2]
        )
        assert axial_energy(e, *LAWS[name]) == pytest.approx(exact, abs=1e-11 + 10 * bound)


@given(strains, strains)
def test_fibre_force_rises_with_strain(a, b):
    low, high = min(a, b), max(a, b)
    for law in LAWS.values():
        assert axial(low, *law)[0] <= axial(high, *law)[0] + 1e-15


def test_fibre_slopes_have_the_values_of_the_parameters():
    assert axial(-0.5, *LAWS["buckling"])[1] == pytest.approx(0.3, abs=1e-5)
    assert axial(0.5, *LAWS["buckling"])[1] == pytest.approx(1.0, abs=1e-5)
    assert axial(2.0, *LAWS["stiffening"])[1] == pytest.approx(10.0, abs=1e-5)
    assert axial(0.0, *LAWS["buckling"]) == pytest.approx((0.0, 0.65), abs=1e-15)


# Bonds


@given(st.floats(-5.0, 500.0), st.floats(0.0, 1.0), st.floats(0.0, 1e5))
def test_clutch_rates_are_finite_and_ordered(z, n, load):
    on, off = binding_rate(z, 0.1, 0.9, 0.2), unbinding_rate(n, load, 0.025, 600.0)
    assert 0.0 <= on <= 0.1
    assert np.isfinite(off)
    assert off >= 0.025
    assert unbinding_rate(n, load + 1.0, 0.025, 600.0) > off


@given(st.floats(0.0, 100.0), st.floats(0.0, 60.0), st.floats(0.001, 5.0))
def test_bond_number_step_is_the_exact_solution(load, n, dt):
    numbers = {"k_on": 0.5, "k_0": 0.01, "n_max": 50.0, "f_b": 3.5}
    total = 0.5 + bell_off_rate(load, 0.01, 3.5)
    n_new = bond_number_step(n, load, dt, **numbers)
    # d/dt of the formula at dt = 0 is the rate; and it relaxes with the sum of both rates.
    assert bond_number_rate(n_new, load, **numbers) == pytest.approx(
        bond_number_rate(n, load, **numbers) * np.exp(-total * dt), rel=1e-9, abs=1e-9 * total * 50
    )
    assert 0.0 <= n_new <= max(50.0, n)
    half = bond_number_step(n, load, 0.5 * dt, **numbers)
    assert bond_number_step(half, load, 0.5 * dt, **numbers) == pytest.approx(n_new, abs=1e-12)


def test_the_exponent_is_capped():
    assert bell_off_rate(1e9, 0.01, 5.0) == pytest.approx(0.01 * np.exp(CAP), rel=1e-15)
    with np.errstate(over="ignore"):
        assert not np.isfinite(0.01 * np.exp(1e9 / 5.0))  # what the cap is for


@settings(max_examples=30)
@given(st.floats(0.05, 1.5), st.floats(0.03, 1.5), st.floats(0.01, 60.0))
def test_contraction_step_is_the_exact_solution(length, rest, dt):
    """Against a stiff solver; 1e-8 is its tolerance of 1e-10 with the kinks at slack and stall."""
    kappa, v_m, f_st, least = 40.0, 0.01, 5.0, 0.03
    new = contraction_step(length, rest, dt, kappa, v_m, f_st, least)

    def slope(t, y):
        return contraction_rate(kappa * np.maximum(length - y, 0.0), v_m, f_st)

    def floor(t, y):
        return y[0] - least

    floor.terminal = True
    floor.direction = -1
    run = solve_ivp(slope, (0, dt), [rest], rtol=1e-10, atol=1e-12, events=floor, max_step=0.5)
    expected = max(run.y[0, -1], least)
    assert new == pytest.approx(expected, abs=1e-8)
    assert least <= new <= max(rest, least)


def test_no_contraction_speed_means_no_contraction():
    assert contraction_step(1.0, 0.8, 10.0, 40.0, 0.0, 5.0, 0.03) == 0.8


# Lamellipodium


@given(angles, st.floats(-2.0, 4.0))
def test_protrusion_turns_with_the_cell(theta, z):
    """Turning positions and heading turns the force: equivariance to rounding."""
    rng = np.random.default_rng(3)
    x = np.column_stack([rng.standard_normal((40, 2)) * 5.0, np.full(40, z)])
    c, s = np.cos(theta), np.sin(theta)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    straight = protrusion(x, unit(0.4), 600.0, 2.5, 0.1, 0.5, 0.3)
    turned = protrusion(x @ R.T, R @ unit(0.4), 600.0, 2.5, 0.1, 0.5, 0.3)
    # The smoothstep's slope 3.75 per unit of cosine times rounding of positions of size 10.
    assert np.abs(turned - straight @ R.T).max() < 600.0 * 1e-13


def test_protrusion_pushes_the_leading_sector_only():
    theta = np.linspace(-np.pi, np.pi, 181)[:-1]
    x = np.column_stack([8 * np.cos(theta), 8 * np.sin(theta), np.zeros(180)])
    force = protrusion(x, np.array([1.0, 0, 0]), 600.0, 2.5, 0.1, 0.5, 0.3)
    size = np.hypot(force[:, 0], force[:, 1])
    assert np.all(size[np.cos(theta) < 0.1 - 1e-9] == 0.0)
    assert size[np.cos(theta) > 0.5 + 1e-9] == pytest.approx(600.0, rel=1e-6)
    assert force[:, 2] == pytest.approx(-0.3 * size, abs=1e-4)
    assert np.all(
        protrusion(x + [0, 0, 2.5], np.array([1.0, 0, 0]), 600.0, 2.5, 0.1, 0.5, 0.3) == 0
    )
    assert np.all(protrusion(x, np.array([0, 0, 1.0]), 600.0, 2.5, 0.1, 0.5, 0.3) == 0)


@given(st.floats(-1.0, 2.0), st.floats(-1.0, 2.0))
def test_smoothstep_is_monotone_between_zero_and_one(a, b):
    low, high = smoothstep(np.array([min(a, b), max(a, b)]), 0.1, 0.5)
    assert 0.0 <= low <= high <= 1.0


# Sensing


def ring(n=60, radius=10.0):
    theta = 2 * np.pi * np.arange(n) / n
    nodes = np.column_stack([radius * np.cos(theta), radius * np.sin(theta), np.zeros(n)])
    fibres = np.column_stack([np.arange(n), (np.arange(n) + 1) % n])
    return theta, nodes, fibres


@given(angles)
def test_the_stiff_side_is_found(theta_0):
    theta, nodes, fibres = ring()
    middle = theta + np.pi / len(theta)
    stiffness = 1.0 + 0.5 * np.cos(middle - theta_0)
    d = stiffest_direction(nodes, fibres, stiffness, np.zeros(3), unit(0.0), 14.0, 1e-3)
    # A regular ring with a first-harmonic stiffness: the sum is exact up to rounding.
    assert d == pytest.approx(unit(theta_0), abs=1e-12)
    s = stress_direction(nodes, fibres, stiffness, np.zeros(3), unit(0.0), 4.0, 14.0, 1e-3)
    assert s == pytest.approx(unit(theta_0), abs=1e-12)


def test_nothing_stands_out_keeps_the_heading():
    _, nodes, fibres = ring()
    p = unit(1.1)
    same = np.ones(len(fibres))
    assert np.array_equal(stiffest_direction(nodes, fibres, same, np.zeros(3), p, 14.0, 1e-3), p)
    for reach in (5.0, 14.0):
        d = stress_direction(nodes, fibres, -same, np.zeros(3), p, 4.0, reach, 1e-3)
        assert np.array_equal(d, p)


def network(seed=0):
    rng = np.random.default_rng(seed)
    nodes = rng.uniform(-30, 30, (4000, 3))
    nodes[:, 2] = 0.0
    pairs = rng.integers(0, 4000, (12000, 2))
    return nodes, pairs[pairs[:, 0] != pairs[:, 1]], rng


def test_contrast_of_a_slope_is_a_third_of_the_reach():
    """A measure 1 + a x on a fine grid: g = a reach/3, less the soft edge of the window."""
    x = np.arange(-20.0, 20.1, 0.25)
    grid = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    g = contrast(grid, 1.0 + 0.02 * grid[:, 0], np.zeros(2), 14.0)
    assert g[0] == pytest.approx(0.02 * 13.5 / 3, rel=0.01)
    assert abs(g[1]) < 1e-12
    assert np.abs(contrast(grid, np.full(len(grid), 3.0), np.zeros(2), 14.0)).max() < 1e-12


def test_contrast_does_not_see_the_density_of_nodes():
    """Twice as many nodes on one side: the sum sees it, the mean over fibres and nodes does not."""
    nodes, fibres, rng = network()
    dense = np.concatenate([nodes, nodes[nodes[:, 0] > 0] + [0.01, 0.0, 0.0]])
    g = contrast(dense, np.ones(len(dense)), np.zeros(3), 14.0)
    q, total = measure_moment(dense, np.ones(len(dense)), np.zeros(3), 0.0, 14.0)
    assert np.hypot(*q) / total > 0.1
    assert np.hypot(*g) < 1e-12
    value = rng.uniform(1, 2, len(fibres))
    mean = nodal_mean(fibres, value, fibre_ends(4000, fibres))
    at = int(fibres[0, 0])
    assert mean[at] == pytest.approx(
        np.mean([v for f, v in zip(fibres, value, strict=True) for end in f if end == at])
    )


@pytest.mark.parametrize("size", [1e-6, 0.01, 0.05, 0.3, 1e3])
def test_graded_cue_and_its_inverse(size):
    g = size * np.array([0.6, -0.8])
    d, x = graded(g, 0.05), size / 0.05
    assert np.hypot(*d) == pytest.approx(x**2 / (1 + x**2), rel=1e-12)
    assert np.hypot(*d) < 1.0 or size == 1e3
    assert d[0] * g[1] == pytest.approx(d[1] * g[0], rel=1e-12)
    assert np.allclose(cue(g, 0.05), d, rtol=1e-12)
    assert np.allclose(cue_rows(g[None], 0.05)[0], d, rtol=1e-12)
    if size < 1.0:
        assert np.allclose(ungraded(d, 0.05), g, rtol=1e-6)
    h = 1e-7 * size
    slope = np.column_stack([(graded(g + h * e, 0.05) - graded(g - h * e, 0.05)) / (2 * h)
                             for e in np.eye(2)])  # fmt: skip
    assert np.allclose(cue_slope(g, 0.05), slope, rtol=1e-5, atol=1e-7 * np.abs(slope).max())
    assert not graded(np.zeros(2), 0.05).any()
    assert not cue_slope(np.zeros(2), 0.05).any()
