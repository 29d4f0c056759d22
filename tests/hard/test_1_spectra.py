"""Spectra: defective, clustered, copied, non-normal, marginal, far apart, in other units."""

import mpmath as mp
import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.population import Superposition, couple
from cellsys.response import balanced_truncation, frequency_response, margins, step_response
from cellsys.spectra import damping, poles, stability
from cellsys.spectra.integrators import MARGINAL
from cellsys.system import OdeSystem
from tests import naive
from tests.hard.stress import SEED, Case, Choice, Int, Power, Real, hold
from tests.population.systems import model as cell
from tests.response import gallery

MATRICES = {**gallery.GALLERY, "bidiagonal": gallery.bidiagonal}


def matrix(family, n, depth):
    """A gallery matrix shifted so that its exact abscissa is -depth (+depth: unstable)."""
    A = MATRICES[family](n)
    return A - (exact_poles(A).real.max() + depth) * np.eye(n)


def exact_poles(A, digits=80):
    """Eigenvalues of the matrix of doubles, at 80 digits (as many as n = 14, eps^(1/n) need)."""
    if not np.any(np.tril(A, -1)) or not np.any(np.triu(A, 1)):
        return np.diag(A).astype(complex)
    with mp.workdps(digits):
        values = mp.eig(mp.matrix(A.tolist()), left=False, right=False)
        return np.array([complex(v) for v in values])


def exact_response(A, b, c, omega, digits=40):
    """c (j w I - A)^-1 b at 40 digits."""
    n = len(A)
    with mp.workdps(digits):
        M = -mp.matrix(A.tolist())
        for i in range(n):
            M[i, i] += mp.mpc(0, omega)
        x = mp.lu_solve(M, mp.matrix(b.tolist()))
        return complex(sum(mp.mpf(float(c[i])) * x[i] for i in range(n)))


def poles_lie_within_their_bounds(family, n, depth, scale):
    """Every exact pole has a computed one within its bound, whatever the unit of time."""
    A = scale * matrix(family, n, depth)
    found, true = poles(A), exact_poles(A)
    gap = np.abs(true[:, None] - np.asarray(found)[None])
    # the exact poles are rounded to doubles when they come back
    room = found.error_bound[None] + 1e-14 * np.abs(true).max() + 1e-300
    assert np.all((gap <= room).any(axis=1)), (gap.min(axis=1), found.error_bound)
    assert len(damping(A).poles) == n
    exact = true.real.max()
    verdict = stability(A).verdict
    assert verdict in {"stable": ("stable", MARGINAL, "not decided")}.get(
        "stable" if exact < 0 else "", ("unstable", "not decided")
    )


def responses_are_right(family, n, depth, omega):
    """G(j w) within the accuracy it states, against 40 digits."""
    A = matrix(family, n, depth)
    b, c = np.eye(n)[-1], np.eye(n)[0]
    found = frequency_response((A, b[:, None], c[None], [[0.0]]), [omega])
    true = exact_response(A, b, c, omega)
    bound = found.accuracy[0, 0, 0]
    if np.isfinite(bound) and true != 0:
        assert abs(found.response[0, 0, 0] - true) <= (bound + 1e-14) * abs(true)
    assert np.isfinite(found.response).all()


def units_change_nothing(seed, spread, time):
    """States in units up to 1e8 apart and another unit of time: the same system."""
    A, B, C, D = gallery.mass_spring(4, damping=0.3)
    rng = np.random.default_rng(seed)
    T = 2.0 ** rng.integers(-int(np.log2(spread)), int(np.log2(spread)) + 1, len(A))
    other = (time * A * T[:, None] / T[None], time * B * T[:, None], C / T[None], D)
    a, b = np.sort_complex(poles(A)), np.sort_complex(poles(other)) / time
    # the chain is nearly normal: rounding times a condition number of a few
    assert np.abs(a - b).max() < 1e-12 * np.abs(a).max()
    w = np.array([0.1, 1.0, 3.0])
    one = frequency_response((A, B, C, D), w).response
    two = frequency_response(other, time * w).response
    assert np.abs(one - two).max() < 1e-10 * np.abs(one).max()
    assert margins((A, B, 3 * C, D)).gain_margin == pytest.approx(
        margins((other[0], other[1], 3 * other[2], D)).gain_margin, rel=1e-8
    )
    assert stability(other).verdict == "stable"


def test_naive_poles_in_other_units():
    A = gallery.poorbal(1e8)[0]
    exact = np.sort_complex(poles(gallery.mass_spring(4, damping=0.3)[0]))
    assert np.abs(np.sort_complex(poles(A)) - exact).max() < 1e-12
    # naive: QR without balancing on states 1e16 apart
    assert np.abs(np.sort_complex(naive.unbalanced_poles(A)) - exact).max() > 1e-6


def lags_keep_their_margins(n, gain):
    """gain/(s + 1)^n: phase -180 deg at w = tan(pi/n), gain margin (1 + w^2)^(n/2) / gain."""
    found = margins(gallery.lag_chain(n, gain))
    w = np.tan(np.pi / n)
    crossing = (1 + w * w) ** (n / 2) / gain
    if crossing > 1 and gain < 1:  # no crossing of |L| = 1: all gain margins are above 1
        assert found.gain_margin == pytest.approx(crossing, rel=1e-7)
        assert found.phase_margin == np.inf
    assert any(abs(k / crossing - 1) < 1e-7 for _, k in found.phase_crossings)
    assert found.closed_loop_stable == (gain < crossing * gain)


def test_a_hundred_lags():
    found = margins(gallery.lag_chain(100, 0.5))
    exact = (1 + np.tan(np.pi / 100) ** 2) ** 50 / 0.5
    assert found.gain_margin == pytest.approx(exact, rel=1e-9)
    # the same lags in turned coordinates: triangular no longer, so that eigenvalues are off by
    # eps^(1/100) and a polynomial made of them, with coefficients up to 1e29, by 11 digits
    A, B, C, D = gallery.lag_chain(100, 0.5)
    Q = sla.qr(np.random.default_rng(0).standard_normal((100, 100)))[0]
    turned = (Q @ A @ Q.T, Q @ B, C @ Q.T, D)
    want = 0.5 / (1 + 0.3j) ** 100
    assert abs(frequency_response(turned, [0.3]).response[0, 0, 0] / want - 1) < 1e-9
    assert abs(naive.polynomial_response(*turned, 0.3) / want - 1) > 1e-6


def widely_spread_steps(low, high, seed):
    """Rates 10^low .. 10^high 1/s, mixed by a rotation: steps at every scale of time."""
    rng = np.random.default_rng(seed)
    rates = 10.0 ** np.linspace(low, high, 5)
    A, B, C = np.diag(-rates), rates[:, None], rng.standard_normal((2, 5))
    t = np.array([0.0, *(1.0 / rates[::-1])])
    got = step_response((A, B, C, np.zeros((2, 1))), t).y
    want = C @ -np.expm1(-np.outer(rates, t))
    assert np.abs(got[:, :, 0].T - want).max() < 1e-9 * np.abs(C).sum()
    # the slowest, 1e-16 of the fastest, is rounding of an integrator
    assert stability(A).verdict in ("stable", MARGINAL, "not decided")


def test_rates_far_apart():
    widely_spread_steps(-8.0, 8.0, 0)
    # naive: explicit steps of one length for all rates, here a thousand over the slowest second
    system = OdeSystem(
        states=["fast", "slow"], x0=[0.0, 0.0], forcing=lambda t, x: np.array([1e8, 1.0]) * (1 - x)
    )
    assert not np.isfinite(naive.fixed_step_end(system, 1.0, 1e-3)).all()


@pytest.mark.parametrize("copies", [2, 10, 60])
def test_copies_and_defective_poles(copies):
    """K copies of a Jordan block: one cluster, whose bound covers the exact pole."""
    Q = sla.qr(np.random.default_rng(0).standard_normal((3 * copies,) * 2))[0]
    A = Q @ np.kron(np.eye(copies), gallery.jordan(3)) @ Q.T
    found = poles(A)
    away = np.abs(np.asarray(found) + 1)
    # eps^(1/3) for a triple defective pole
    assert away.max() < 1e-4
    assert np.all(away <= found.error_bound)
    assert found.cluster_size.min() == 3 * copies
    # naive: "different" poles are counted after rounding to 8 digits
    assert naive.distinct_poles(A) > 3


@pytest.mark.parametrize(
    ("A", "verdicts"),
    [
        (np.zeros((1, 1)), (MARGINAL,)),  # an integrator, set apart
        (np.array([[0.0, 1.0], [-1.0, 0.0]]), ("not decided", "unstable")),
        (np.array([[0.0, 1.0], [0.0, 0.0]]), ("unstable",)),  # grows as t
        (-1e-15 * np.eye(2) + np.diag([0, -1.0]), ("not decided", MARGINAL)),
        (gallery.bidiagonal(60), ("not decided",)),
        (gallery.arnold_laub(1e-9)[0], ("unstable", "not decided")),
    ],
)
def test_marginal_systems_are_not_called_stable_by_luck(A, verdicts):
    assert stability(A).verdict in verdicts
    if len(A) == 60:
        assert naive.poles_say_stable(A)


def the_toolbox_agrees_with_itself(family, n, depth, K, seed):
    """One non-normal cell through couple, poles, response and truncation: the same spectrum."""
    A = matrix(family, n, depth)
    one = cell(m=n, seed=seed, A=A)
    cells = couple(one, K, Superposition())
    # I - P is regular here: K copies of A, found from A and not from a matrix of K n rows
    assert np.abs(np.asarray(cells.pole_set().values)[:, None] - poles(A)[None]).min(1).max() < 1e-9
    assert sum(cells.pole_set().multiplicity) == K * n
    verdict = stability(A).verdict
    if verdict != "stable":
        return
    # refused (a DataError with its reason) where the Gramians are beyond doubles
    reduced = balanced_truncation((A, np.ones((n, 1)), np.ones((1, n)), [[0.0]]), order=n - 1)
    for w in (0.0, 0.3, 3.0):
        full = frequency_response((A, np.ones((n, 1)), np.ones((1, n)), [[0.0]]), [w])
        small = frequency_response(reduced.system, [w]).response
        if full.accuracy.max() > 0.01:
            continue  # G(j w) itself is not known here, and says so
        size = np.abs(full.response).max()
        # the bound of Glover and Enns, and the accuracy both responses state
        room = reduced.error_bound * 1.01 + (1e-8 + 2 * full.accuracy.max()) * size
        assert np.abs(full.response - small).max() <= room


def test_ten_copies_of_a_non_normal_cell():
    the_toolbox_agrees_with_itself("bidiagonal", 9, 1.0, 10, 0)
    A = matrix("bidiagonal", 9, 1.0)
    # naive: the matrix of all cells, whose eigenvalues are off by eps^(1/9)
    found = naive.dense_coupled_poles(cell(m=9, seed=0, A=A), 10)
    assert np.abs(found[:, None] - np.diag(A)[None]).min(axis=1).max() > 1e-6


SMALL = {"family": Choice(*MATRICES), "n": Int(2, 9), "depth": Power(-6, 0)}
CASES = (
    Case("poles", poles_lie_within_their_bounds, {**SMALL, "scale": Power(-8, 8)}),
    Case("responses", responses_are_right, {**SMALL, "omega": Power(-3, 3)}),
    Case(
        "units",
        units_change_nothing,
        {"seed": SEED, "spread": Power(0.5, 8), "time": Power(-6, 6)},
    ),
    Case("lags", lags_keep_their_margins, {"n": Int(3, 100), "gain": Real(0.1, 0.9)}),
    Case(
        "rates far apart",
        widely_spread_steps,
        {"low": Real(-8, 0), "high": Real(0.1, 8), "seed": SEED},
    ),
    Case(
        "whole toolbox",
        the_toolbox_agrees_with_itself,
        {**SMALL, "depth": Power(-2, 0), "K": Choice(2, 10, 10**6), "seed": SEED},
    ),
)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_random_instances(case):
    hold(case, 5)
