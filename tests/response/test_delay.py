"""Margins of loops with a pure delay: closed forms, and closed-loop poles counted another way."""

import control
import numpy as np
import pytest
import scipy.optimize as so

import cellsys as cs
from cellsys.errors import DimensionError, ParameterError


@pytest.mark.parametrize(("k", "tau"), [(0.3, 1.0), (1.2, 1.0), (1.6, 1.0), (0.01, 100.0)])
def test_an_integrator_with_delay(k, tau):
    """k e^-s tau / s: pi/(2 k tau), 90 deg - k tau, pi/(2 k) - tau; stable below k tau = pi/2."""
    m = cs.margins(control.tf([k], [1, 0]), delay=tau)
    assert m.gain_margin == pytest.approx(np.pi / 2 / (k * tau), rel=1e-12)
    assert m.phase_margin == pytest.approx(90 - np.degrees(k * tau), rel=1e-9)
    left = np.pi / 2 / k - tau
    assert m.delay_margin == pytest.approx(left if left > 0 else left + 2 * np.pi / k, rel=1e-9)
    assert m.closed_loop_stable == (k * tau < np.pi / 2)
    assert m.closed_loop_unstable == (0 if k * tau < np.pi / 2 else 2)


@pytest.mark.parametrize(("k", "tau"), [(2.0, 0.4), (5.0, 0.1), (3.0, 2.0)])
def test_a_lag_with_delay(k, tau):
    """k e^-s tau / (s + 1): |L| = 1 at sqrt(k^2 - 1); first phase crossing atan w + w tau = pi."""
    m = cs.margins(control.tf([k], [1, 1]), delay=tau)
    w = np.sqrt(k * k - 1)
    turned = 180 - np.degrees(np.arctan(w) + w * tau)
    assert m.phase_margin == pytest.approx((turned + 180) % 360 - 180, abs=1e-9)
    crossing = so.brentq(lambda w: np.arctan(w) + w * tau - np.pi, 1e-6, np.pi / tau, xtol=1e-14)
    rows = m.phase_crossings
    assert rows[0] == pytest.approx([crossing, np.sqrt(1 + crossing**2) / k], rel=1e-9)
    assert m.closed_loop_stable == (turned > 0)


def test_a_double_integrator_with_lead_and_delay():
    """(1 + T s) e^-s tau / s^2: |L| = 1 where w^4 = 1 + T^2 w^2."""
    T, tau = 2.0, 0.3
    w = np.sqrt((T**2 + np.sqrt(T**4 + 4)) / 2)
    m = cs.margins(control.tf([T, 1], [1, 0, 0]), delay=tau)
    assert m.phase_margin_frequency == pytest.approx(w, rel=1e-12)
    assert m.phase_margin == pytest.approx(np.degrees(np.arctan(T * w) - w * tau), rel=1e-9)


def poles_on_the_right(A, B, C, tau, points=50):
    """Of x'(t) = A x(t) - B C x(t - tau): its generator on Chebyshev points [Breda 2005]."""
    n, k = len(A), np.arange(points + 1)
    x = np.cos(np.pi * k / points)
    c = np.r_[2, np.ones(points - 1), 2] * (-1.0) ** k
    D = np.outer(c, 1 / c) / (x[:, None] - x[None, :] + np.eye(points + 1))
    D -= np.diag(D.sum(axis=1))
    M = np.kron(2 / tau * D, np.eye(n))
    M[:n] = 0
    M[:n, :n], M[:n, -n:] = A, -B @ C
    return int((np.linalg.eigvals(M).real > 1e-9).sum())


def test_poles_of_random_delayed_loops_are_counted():
    rng, seen = np.random.default_rng(3), set()
    for _ in range(25):
        n = int(rng.integers(1, 5))
        A = rng.normal(size=(n, n))
        A -= (0.3 + np.linalg.eigvals(A).real.max()) * np.eye(n) * (rng.random() < 0.8)
        B, C = rng.normal(size=(n, 1)), rng.normal(size=(1, n)) * 10 ** rng.uniform(-1, 1)
        tau = 10 ** rng.uniform(-2, 0.7)
        m = cs.margins((A, B, C, [[0.0]]), delay=tau)
        assert m.closed_loop_unstable == poles_on_the_right(A, B, C, tau)
        seen.add(m.closed_loop_unstable)
    assert len(seen) > 2


def test_a_pade_form_is_another_loop():
    """Naive: first order; right at low frequency only."""
    L, tau = control.tf([2], [1, 1]), 2.0
    true = cs.margins(L, delay=tau)
    pade = control.tf([-tau / 2, 1], [tau / 2, 1])
    naive = cs.margins(L * pade)
    assert abs(naive.gain_margin - true.gain_margin) > 0.1 * true.gain_margin


def test_whole_samples_of_delay():
    """z^-2 by hand against delay= of a sampled loop, and what is no whole number."""
    G = cs.c2d(control.tf([5], [100, 1]), 1.0)
    by_hand = cs.margins(control.ss(control.ss2tf(G) * control.tf([1], [1, 0, 0], 1.0)))
    m = cs.margins(G, delay=2.0)
    assert m.gain_margin == pytest.approx(by_hand.gain_margin, rel=1e-9)
    assert m.gain_margin == pytest.approx(12.478043, rel=1e-6)
    with pytest.raises(ParameterError, match="whole number"):
        cs.margins(G, delay=1.5)


def test_refusals():
    two = (-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)))
    with pytest.raises(DimensionError, match="scalar loop, got 2 channels"):
        cs.margins(two, delay=1.0)
    with pytest.raises(ParameterError, match="roll off below 1"):
        cs.margins(control.tf([2, 1], [1, 1]), delay=1.0)
    for wrong in (-1.0, np.inf, np.nan):
        with pytest.raises(ParameterError, match="delay must be >= 0 s"):
            cs.margins(control.tf([1], [1, 1]), delay=wrong)
