"""Margins against closed forms, the closed loop itself, and the naive polynomial route."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
import scipy.linalg as sla
from scipy.optimize import brentq

from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.response import margins, root_locus
from cellsys.spectra import poles, zeros
from tests import naive
from tests.response.gallery import lag_chain, mass_spring

S = ct.tf("s")
EXACT = 1e-8  # what the task asks for; root finding itself ends at a few eps


def ss(expression: ct.TransferFunction) -> ct.StateSpace:
    return ct.ss(expression)


def test_first_order_lag() -> None:
    # |3/(s + 1)| = 1 at sqrt 8, phase -atan sqrt 8; never real and negative.
    found = margins(ss(3 / (S + 1)))
    assert found.gain_margin == np.inf
    assert np.isnan(found.gain_margin_frequency)
    assert found.phase_margin == pytest.approx(180 - np.degrees(np.arctan(np.sqrt(8))), rel=EXACT)
    assert found.phase_margin_frequency == pytest.approx(np.sqrt(8), rel=EXACT)
    assert found.delay_margin == pytest.approx(
        np.radians(found.phase_margin) / np.sqrt(8), rel=EXACT
    )
    assert found.closed_loop_stable


@pytest.mark.parametrize("order", [1, 3, 6])
def test_lag_with_pade_delay(order: int) -> None:
    # A Pade filter den(-s)/den(s) is all-pass; its phase is the sum over the roots of den.
    num, den = ct.pade(1.0, order)
    found = margins(ss(3 / (S + 1) * ct.tf(num, den)))
    roots = np.roots(den)

    def lag(w: float) -> float:
        return np.arctan(w) + 2 * np.sum(np.arctan((w - roots.imag) / -roots.real)).real

    assert found.phase_margin_frequency == pytest.approx(np.sqrt(8), rel=EXACT)
    assert found.phase_margin == pytest.approx(180 - np.degrees(lag(np.sqrt(8))), rel=EXACT)
    crossing = brentq(lambda w: lag(w) - np.pi, 0.1, 8.0, xtol=1e-14)
    # Of all crossings the nearest to 1 in ratio is the first one here.
    assert found.phase_crossings[0] == pytest.approx(
        [crossing, np.hypot(1, crossing) / 3], rel=EXACT
    )
    assert found.gain_margin == pytest.approx(np.hypot(1, crossing) / 3, rel=EXACT)


def test_double_integrator_with_lead() -> None:
    # L = (s + 1)/s^2: |L| = 1 where w^4 = w^2 + 1, the golden ratio.
    w = np.sqrt((1 + np.sqrt(5)) / 2)
    found = margins(ss((S + 1) / S**2))
    assert found.gain_margin == np.inf
    assert found.phase_margin == pytest.approx(np.degrees(np.arctan(w)), rel=EXACT)
    assert found.delay_margin == pytest.approx(np.arctan(w) / w, rel=EXACT)


def test_double_integrator_alone_is_on_the_axis() -> None:
    found = margins(ss(1 / S**2))
    assert found.phase_margin == pytest.approx(0.0, abs=1e-6)
    assert not found.closed_loop_stable


def test_conditionally_stable() -> None:
    # 10 (s + 1)^2 / s^3 loses stability when the gain FALLS to k: k 20 = k^2 100 -> factor 0.05.
    found = margins(ss(10 * (S + 1) ** 2 / S**3))
    assert found.gain_margin == pytest.approx(0.05, rel=EXACT)
    assert found.gain_margin_down == found.gain_margin
    assert found.gain_margin_up == np.inf
    assert found.gain_margin_frequency == pytest.approx(1.0, rel=EXACT)
    assert found.closed_loop_stable


def test_several_crossings_are_all_found() -> None:
    # |0.5/((1 - x + 0.02 j w)(9 - x + 0.01 j w))| = 1 with x = w^2 is a quartic in x; its roots
    # are simple, so that numpy has them to 1e-10.
    first = np.poly1d([-1.0, 1.0]) ** 2 + np.poly1d([0.02**2, 0.0])
    second = np.poly1d([-1.0, 9.0]) ** 2 + np.poly1d([0.01**2, 0.0])
    x = (first * second - 0.25).roots
    crossing = np.sqrt(np.sort(x[(np.abs(x.imag) < 1e-9) & (x.real > 0)].real))
    found = margins(ss(0.5 / ((S**2 + 0.02 * S + 1) * (S**2 + 0.01 * S + 9))))
    assert len(crossing) == 4
    np.testing.assert_allclose(found.gain_crossings[:, 0], crossing, rtol=EXACT)


def test_no_crossover_and_constant() -> None:
    found = margins(ss(0.5 / (S + 1)))
    assert (found.gain_margin, found.phase_margin, found.delay_margin) == (np.inf,) * 3
    found = margins(ct.ss([], [], [], [[-0.5]]))
    assert found.gain_margin == pytest.approx(2.0)
    assert margins(ct.ss([], [], [], [[0.0]])).gain_margin == np.inf


def test_crossing_at_zero_frequency_and_unstable_plant() -> None:
    found = margins(ss(2 / (S - 1)))  # needs the gain: stable for factors above 0.5
    assert found.gain_margin == pytest.approx(0.5, rel=EXACT)
    assert found.gain_margin_frequency == 0.0
    assert found.phase_margin == pytest.approx(60.0, rel=EXACT)
    assert (found.open_loop_unstable, found.encirclements, found.closed_loop_unstable) == (1, -1, 0)
    assert found.closed_loop_stable


def test_crossing_far_beyond_the_grid() -> None:
    found = margins(ss(1e8 / (S + 1)))
    assert found.phase_margin_frequency == pytest.approx(np.sqrt(1e16 - 1), rel=EXACT)
    found = margins(ss(1e-6 / (S * (S + 1))))
    assert found.phase_margin_frequency == pytest.approx(1e-6, rel=1e-6)


def test_crossing_at_the_edge_of_a_given_grid() -> None:
    w = np.sqrt(8)
    L = ss(3 / (S + 1))
    assert margins(L, omega=np.array([0.1, w, 10])).phase_margin_frequency == pytest.approx(w)
    assert margins(L, omega=np.array([0.1, w * (1 - 1e-9)])).phase_margin == np.inf


def test_tangent_crossings_are_not_missed() -> None:
    # The resonance peak of height 1.0001 is narrower than the grid's spacing.
    zeta = 1e-5
    peak = 1 / (2 * zeta * np.sqrt(1 - zeta**2))
    found = margins(ss(1.0001 / peak / (S**2 + 2 * zeta * S + 1)))
    assert len(found.gain_crossings) == 2
    assert margins(ss(0.9999 / peak / (S**2 + 2 * zeta * S + 1))).phase_margin == np.inf


def test_chain_of_100_equal_lags() -> None:
    # (s + 1)^100 turns by 180 deg at tan(pi/100), where |L| = 0.5 cos(pi/100)^100.
    truth = 2 / np.cos(np.pi / 100) ** 100
    L = lag_chain(100, 0.5)
    found = margins(L)
    assert found.gain_margin == pytest.approx(truth, rel=1e-10)
    assert found.gain_margin_frequency == pytest.approx(np.tan(np.pi / 100), rel=1e-10)
    assert found.phase_margin == np.inf
    gain, phase = naive.polynomial_margins(*L)
    assert abs(gain / truth - 1) > 1e-3
    assert np.isfinite(phase)


@pytest.mark.parametrize("n", [3, 30, pytest.param(400, marks=pytest.mark.slow)])
def test_lags_turn_far_below_their_own_frequency(n: int) -> None:
    # 0.999/(s + 1)^n and its mirror in frequency s^n/(s + 1)^n, whose crossing lies far above 1.
    found = margins(lag_chain(n, 0.999))
    assert found.phase_crossings[0, 0] == pytest.approx(np.tan(np.pi / n), rel=1e-10)
    assert found.loci.omega[0] < 0.1 * np.tan(np.pi / n)
    if n > 100:
        return  # the realisation of the mirror has entries of binomial size
    A, B, C, _ = (np.asarray(M) for M in lag_chain(n, 0.999))
    inverse, column = np.linalg.solve(A, np.eye(n)), np.linalg.solve(A, B)
    # C (I/s - A)^-1 B = -C A^-1 (s I - A^-1)^-1 A^-1 B - C A^-1 B
    mirrored = margins((inverse, column, -C @ inverse, -C @ column))
    assert mirrored.phase_crossings[-1, 0] == pytest.approx(1 / np.tan(np.pi / n), rel=1e-8)


def test_gain_margin_moves_a_closed_loop_pole_onto_the_axis() -> None:
    A, B, C, D = mass_spring(10)
    L = (A, B, 0.5 * C, D)
    found = margins(L)
    assert found.closed_loop_stable
    for _, factor in found.phase_crossings:
        values = sla.eigvals(A - factor * B @ (0.5 * C))
        # The distance to the axis is rounding of a 20-state eigenvalue problem.
        assert np.abs(values.real).min() < 1e-10
    locus = root_locus(L, np.linspace(0, 2 * found.gain_margin, 50))
    assert found.gain_margin == pytest.approx(locus.crossings[0], rel=1e-9)


def test_phase_and_delay_margin_put_a_root_on_the_axis() -> None:
    L = ss(2 * (S + 0.5) / (S * (S + 1) * (S**2 + 0.4 * S + 4))) * 0.5
    found = margins(L)
    for w, phase in found.gain_crossings:
        assert abs(1 + complex(L(1j * w)) * np.exp(-1j * np.radians(phase))) < 1e-9
    w = found.delay_margin_frequency
    assert abs(1 + complex(L(1j * w)) * np.exp(-1j * w * found.delay_margin)) < 1e-9


def test_matrix_loop_by_eigenvalue_loci() -> None:
    # T diag(L1, L2) T^-1 with a constant T has the loci L1, L2, whatever T is.
    one, two = ss(1 / (S * (S + 1) * (S + 2))), ss(2 / (S * (S + 1) * (S + 2)))
    T = np.array([[1.0, 2.0], [0.5, -1.0]])
    both = ct.append(one, two)
    L = ct.ss(both.A, both.B @ np.linalg.solve(T, np.eye(2)), T @ both.C, np.zeros((2, 2)), 0)
    found = margins(L)
    worst = margins(two)
    assert found.gain_margin == pytest.approx(3.0, rel=EXACT)
    assert found.phase_margin == pytest.approx(worst.phase_margin, rel=EXACT)
    assert found.delay_margin == pytest.approx(worst.delay_margin, rel=EXACT)
    # A common factor k puts a pole of the closed loop on the axis.
    values = sla.eigvals(L.A - found.gain_margin * L.B @ L.C)
    assert np.abs(values.real).min() < 1e-8


def test_discrete_loop() -> None:
    # k / (z - 1): at z = -1 it is -k/2, so the gain margin is 2/k at the Nyquist frequency.
    found = margins(ct.ss([[1.0]], [[1.0]], [[0.5]], [[0.0]], 0.1))
    assert found.gain_margin == pytest.approx(4.0, rel=EXACT)
    assert found.gain_margin_frequency == pytest.approx(np.pi / 0.1)
    # |0.5/(exp(j x) - 1)| = 1 where 2 sin(x/2) = 0.5; arg is -(pi + x)/2.
    x = 2 * np.arcsin(0.25)
    assert found.phase_margin_frequency == pytest.approx(x / 0.1, rel=EXACT)
    assert found.phase_margin == pytest.approx(90 - np.degrees(x) / 2, rel=EXACT)
    assert found.delay_margin == pytest.approx(np.radians(found.phase_margin) * 0.1 / x, rel=EXACT)


def test_disk_margin() -> None:
    # L = 1/s: (1 - L)/(1 + L) = (s - 1)/(s + 1) has size 1 everywhere, alpha = 2.
    assert margins(ss(1 / S)).disk_margin == pytest.approx(2.0, rel=1e-9)
    # Inside the disk, any factor (2 + a)/(2 - a) keeps the loop stable and one point is reached.
    L = ss(1 / (S * (S + 1) * (S + 2)))
    found = margins(L)
    alpha = found.disk_margin
    assert (2 + alpha) / (2 - alpha) <= found.gain_margin * (1 + 1e-9)
    assert 2 * np.degrees(np.arctan(alpha / 2)) <= found.phase_margin * (1 + 1e-9)


def test_nyquist_count_by_winding() -> None:
    # Z - P from the eigenvalues equals the turns of det(1 + L) seen on the response.
    for k in (0.5, 5.0):
        L = ss(k * (S + 3) / ((S - 1) * (S + 2)) * 2)
        found = margins(L)
        turn = np.unwrap(np.angle(1 + found.loci.values[0]))
        turns = -2 * (turn[-1] - turn[0]) / (2 * np.pi)
        assert found.encirclements == pytest.approx(turns, abs=0.1)


def test_resonant_mass_spring_against_the_polynomial_route() -> None:
    # 48 lightly damped states, peak gain below 1: no crossover; by polynomials there is one, or
    # the route breaks down.
    A, B, C, D = mass_spring(24, damping=0.005)
    peak = np.abs(C @ np.linalg.solve(1j * np.eye(48) * 0.13 - A, B)).item()
    L = (A, B, C / (50 * max(peak, 1.0)), D)
    found = margins(L)
    assert found.phase_margin == np.inf
    assert len(found.gain_crossings) == 0
    try:
        phase = naive.polynomial_margins(*L)[1]
    except np.linalg.LinAlgError:
        phase = np.nan
    assert phase != np.inf


@pytest.mark.parametrize("seed", range(40))
def test_no_crossing_is_missed_or_invented(seed: int) -> None:
    # Independent lists: |L| = 1 at the imaginary eigenvalues of a Hamiltonian matrix, Im L = 0 at
    # the imaginary zeros of L(s) - L(-s); both are safe at this order only.
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 9))
    A = rng.standard_normal((n, n)) * 10 ** rng.uniform(-1, 1)
    B, C = rng.standard_normal((n, 1)), rng.standard_normal((1, n)) * 10 ** rng.uniform(-1, 2)
    d = float(rng.choice([0, 0, 0.3, -0.4, 2.0]))
    found = margins((A, B, C, [[d]]))

    def L(w: float) -> complex:
        return complex((C @ np.linalg.solve(1j * w * np.eye(n) - A, B))[0, 0] + d)

    F, R = A + B @ C * d / (1 - d * d), 1 - d * d
    mu = sla.eigvals(np.block([[F, B @ B.T / R], [-C.T @ C / R, -F.T]]))
    w = np.sort(mu.imag[(abs(mu.real) < 1e-7 * (1 + abs(mu))) & (mu.imag > 1e-9)])
    w = [x for x in w if abs(abs(L(x)) - 1) < 1e-6]
    np.testing.assert_allclose(found.gain_crossings[:, 0], w, rtol=1e-6)

    both = (sla.block_diag(A, -A), np.vstack([B, B]), np.hstack([C, C]), np.zeros((1, 1)))
    z = np.asarray(zeros(both))
    w = np.sort(z.imag[(abs(z.real) < 1e-7 * (1 + abs(z))) & (z.imag > 1e-9)])
    w = [x for x in w if L(x).real < 0 and abs(L(x).imag) < 1e-6 * abs(L(x))]
    at = found.phase_crossings[:, 0]
    np.testing.assert_allclose(at[(at > 0) & np.isfinite(at)], w, rtol=1e-6)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(10))
def test_every_change_of_stability_is_a_phase_crossing(seed: int, dt: float) -> None:
    # A common factor k in all channels, swept in the closed-loop matrix itself.
    rng = np.random.default_rng(seed)
    n, q = int(rng.integers(2, 8)), int(rng.integers(1, 4))
    A = rng.standard_normal((n, n))
    A = sla.expm(0.3 * (A - 0.5 * np.eye(n))) if dt else A
    B, C = rng.standard_normal((n, q)), rng.standard_normal((q, n))
    factors = margins((A, B, C, np.zeros((q, q)), dt)).phase_crossings[:, 1]

    def depth(k: float) -> np.ndarray:
        values = sla.eigvals(A - k * B @ C)
        return np.abs(values) - 1 if dt else values.real

    k = np.geomspace(1e-3, 1e3, 600)
    count = np.array([np.count_nonzero(depth(x) > 0) for x in k])
    for i in np.flatnonzero(np.diff(count)):
        assert np.any((factors >= k[i] * (1 - 1e-6)) & (factors <= k[i + 1] * (1 + 1e-6)))
    for x in factors[(factors > 1e-3) & (factors < 1e3)]:
        assert np.abs(depth(x)).min() < 1e-6 * max(1.0, sla.norm(A - x * B @ C))


def test_integrators_outside_the_loop_are_set_apart() -> None:
    # 1/(s (s + 1)(s + 2)) and beside it a position the loop does not see, and one it cannot move.
    A, B, C, D = (np.asarray(M) for M in ct.ssdata(ss(1 / (S * (S + 1) * (S + 2)))))
    unseen = (
        np.block([[A, np.zeros((3, 1))], [C, np.zeros((1, 1))]]),
        np.vstack([B, [[0.0]]]),
        np.hstack([C, [[0.0]]]),
        D,
    )
    unmoved = (
        sla.block_diag(unseen[0], [[0.0]]),
        np.vstack([unseen[1], [[0.0]]]),
        np.hstack([unseen[2], [[1.0]]]),
        D,
    )
    for L, count in ((unseen, 1), (unmoved, 2)):
        found = margins(L)
        assert found.integrators == count
        assert found.closed_loop_stable
        assert found.gain_margin == pytest.approx(6.0, rel=EXACT)
    assert margins((A, B, C, D)).integrators == 0
    # At its own gain margin the loop has a pole at 0 as well, but one that the loop makes.
    assert not margins(ct.ss([[1.0]], [[1.0]], [[1.0]], [[0.0]], 0)).closed_loop_stable


def test_degenerate_loops_have_defined_margins() -> None:
    A, B, C = -np.eye(2), np.ones((2, 1)), np.ones((1, 2))
    for L, gain, stable in (
        ((A, B, 0 * C, [[0.0]]), np.inf, True),  # L = 0
        ((A, B, C, [[-1.0]]), 1.0, False),  # 1 + L(infinity) = 0: an algebraic loop
        (ct.ss([], [], [], [[-1.0]]), 1.0, False),
        (ss(1 / (S**2 + 1)), np.inf, False),  # undamped, on the axis
        ((1e150 * A, 1e150 * B, C, [[0.0]]), np.inf, True),
        ((np.eye(3, k=-1), np.eye(3, 1), 0.5 * np.eye(1, 3, 2), [[0.0]], 0.1), 2.0, True),
        ((A, np.zeros((2, 0)), np.zeros((0, 2)), None), np.inf, True),
    ):
        found = margins(L)
        assert found.gain_margin == pytest.approx(gain)
        assert found.closed_loop_stable == stable


def test_refusals() -> None:
    with pytest.raises(DimensionError, match="as many outputs as inputs"):
        margins((np.eye(2), np.ones((2, 1)), np.ones((2, 2)), np.zeros((2, 1))))
    with pytest.raises(DataError, match="not finite"):
        margins((np.array([[np.nan]]), [[1.0]], [[1.0]], [[0.0]]))
    with pytest.raises(ParameterError, match="sys must be a linear system: a control"):
        margins("plant")


def test_text_and_poles_agree() -> None:
    found = margins(ss(1 / (S * (S + 1) * (S + 2))))
    assert "gain margin  6" in str(found)
    assert len(poles(ss(1 / (S + 1)))) == 1
