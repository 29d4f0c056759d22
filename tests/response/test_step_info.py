"""Figures of step responses against closed forms; closing, sampling and splitting systems."""

import control
import numpy as np
import pytest
import scipy.signal as signal

import cellsys as cs
from cellsys.errors import DimensionError, ParameterError, RankError


@pytest.mark.parametrize("tau", [1e-3, 1.0, 1e4])
def test_a_lag(tau):
    found = cs.step_info(control.tf([3], [tau, 1]))
    assert found.rise_time == pytest.approx(np.log(9) * tau, rel=1e-9)
    assert found.settling_time == pytest.approx(np.log(50) * tau, rel=1e-9)
    assert (found.overshoot, found.undershoot) == (0.0, 0.0)
    assert (found.peak, found.peak_time) == (pytest.approx(3.0), np.inf)


@pytest.mark.parametrize("zeta", [0.02, 0.3, 0.7])
def test_an_oscillation(zeta):
    w = 2.0
    found = cs.step_info(control.tf([5 * w * w], [1, 2 * zeta * w, w * w]))
    root = np.sqrt(1 - zeta**2)
    assert found.overshoot == pytest.approx(100 * np.exp(-np.pi * zeta / root), rel=1e-9)
    assert found.peak_time == pytest.approx(np.pi / (w * root), rel=1e-7)
    assert found.peak == pytest.approx(5 * (1 + np.exp(-np.pi * zeta / root)), rel=1e-9)
    # outside the band until then, and inside from there on, on the closed form
    t = np.linspace(0, 2 * found.settling_time, 200_001)
    y = 1 - np.exp(-zeta * w * t) * (np.cos(w * root * t) + zeta / root * np.sin(w * root * t))
    last = t[np.flatnonzero(np.abs(y - 1) > 0.02)[-1]]
    assert found.settling_time == pytest.approx(last, abs=2 * (t[1] - t[0]))


def test_dead_time_undershoot_and_what_has_no_steady_state():
    first = cs.step_info(control.tf([-1, 1], [1, 3, 2]))
    later = cs.step_info(control.tf([-1, 1], [1, 3, 2]), delay=2.0)
    assert later.rise_time == first.rise_time
    assert later.settling_time == pytest.approx(first.settling_time + 2.0)
    # y = (1 - 4 e^-t + 3 e^-2t)/2 is lowest at e^-t = 2/3: -1/6, a third of 1/2
    assert first.undershoot == pytest.approx(100 / 3, rel=1e-9)
    for bad, said in (
        (control.tf([1], [1, 0]), "needs a stable system"),
        (control.tf([1], [1, -1]), "needs a stable system"),
        (control.tf([1, 0], [1, 1]), "returns to 0"),
    ):
        with pytest.raises(ParameterError, match=said):
            cs.step_info(bad)
    two = (-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)))
    with pytest.raises(DimensionError, match="name one: input="):
        cs.step_info(two)
    assert cs.step_info(two, input=0, output="y[0]").rise_time == pytest.approx(np.log(9))


def test_samples_of_a_discrete_system():
    found = cs.step_info(cs.c2d(control.tf([1], [1, 1]), 0.01))
    assert found.rise_time == pytest.approx(np.log(9), abs=0.011)
    assert found.settling_time == pytest.approx(np.log(50), abs=0.011)


def random_system(seed, n=5, channels=2):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A -= (0.2 + np.linalg.eigvals(A).real.max()) * np.eye(n)
    B, C = rng.normal(size=(n, channels)), rng.normal(size=(channels, n))
    return control.ss(A, B, C, rng.normal(size=(channels, channels)), 0)


def apart(a, b, points):
    return max(np.abs(a(s) - b(s)).max() / np.abs(b(s)).max() for s in points)


S = (0.1j, 1j, 0.3 + 5j)


def test_closing_a_loop_and_the_gain_at_rest():
    G, K = random_system(0), random_system(1, 3)
    assert apart(cs.feedback(G, K), control.feedback(G, K), S) < 1e-12
    assert apart(cs.feedback(G, 0.3, 1), control.feedback(G, 0.3 * np.eye(2), 1), S) < 1e-12
    np.testing.assert_allclose(cs.dcgain(G), G.dcgain(), rtol=1e-9)
    assert cs.dcgain(control.tf([-2], [1, 0, 0]))[0, 0] == -np.inf
    hidden = control.ss(np.diag([0.0, -2.0]), [[0.0], [1.0]], [[1.0, 1.0]], 0, 0)
    assert cs.dcgain(hidden)[0, 0] == pytest.approx(0.5, rel=1e-12)  # no input reaches the 0
    with pytest.raises(ParameterError, match="algebraic"):
        cs.feedback(control.ss([], [], [], 1.0, 0), -1.0)


def test_bandwidth():
    assert cs.bandwidth(control.tf([3], [2, 1])) == pytest.approx(0.5 * np.sqrt(10**0.3 - 1))
    lightly = control.tf([1], [1, 0.1, 1])  # falls after its resonance
    assert cs.bandwidth(lightly) == pytest.approx(control.bandwidth(lightly, -3), rel=1e-6)
    assert cs.bandwidth(control.tf([1, 2], [1, 1.9])) == np.inf
    with pytest.raises(ParameterError, match="gain at rest"):
        cs.bandwidth(control.tf([1], [1, 0]))


def sampled(rule, system, h):
    return cs.c2d(system, h, rule)


def test_sampling_rules():
    h, points = 0.3, [np.exp(1j * w * 0.3) for w in (0.1, 1.0, 7.0)]
    G = random_system(2)
    one = control.ss(G.A, G.B[:, :1], G.C[:1], 0, 0)
    for rule, system, name in (
        (cs.FirstOrderHold(), G, "foh"), (cs.ImpulseInvariance(), one, "impulse"),
    ):  # fmt: skip
        parts = signal.cont2discrete((system.A, system.B, system.C, system.D), h, name)
        assert apart(sampled(rule, system, h), control.ss(*parts[:4], h), points) < 1e-12
    found = sampled(cs.MatchedPoles(), one, h)
    zeros, poles = control.zeros(one), control.poles(one)
    more = -np.ones(len(poles) - len(zeros) - 1)
    Z, P = np.concatenate([np.exp(zeros * h), more]), np.exp(poles * h)
    gain = one.dcgain() * np.prod(1 - P) / np.prod(1 - Z)
    for z in points:
        assert found(z) == pytest.approx(gain * np.prod(z - Z) / np.prod(z - P), rel=1e-9)
    integrator = sampled(cs.MatchedPoles(), control.tf([1], [1, 0]), 0.5)
    assert integrator(2.0) == pytest.approx(0.5)  # 0.5/(z - 1)
    with pytest.raises(ParameterError, match="D = 0"):
        sampled(cs.ImpulseInvariance(), G, h)
    with pytest.raises(ParameterError, match="no inverse here"):
        cs.d2c(found, cs.MatchedPoles())


def test_what_no_input_reaches_or_no_output_sees_goes():
    rng = np.random.default_rng(4)
    for _ in range(40):
        n, u, o = int(rng.integers(1, 5)), int(rng.integers(0, 3)), int(rng.integers(0, 3))
        N = n + u + o
        A = rng.normal(size=(N, N))
        A[:n, n + u :] = A[n : n + u, :n] = A[n : n + u, n + u :] = 0
        B = np.vstack([rng.normal(size=(n, 1)), np.zeros((u, 1)), rng.normal(size=(o, 1))])
        C = np.hstack([rng.normal(size=(1, n + u)), np.zeros((1, o))])
        T = np.linalg.qr(rng.normal(size=(N, N)))[0]
        full = control.ss(T @ A @ T.T, T @ B, C @ T.T, 0, 0)
        found = cs.minreal(full)
        assert found.system.n_states == n
        assert apart(found.system.state_space(), full, S) < 1e-6
    # weakly coupled, yet beyond the tolerance: it stays
    weak = (np.diag([-1.0, -2.0]), [[1.0], [1e-6]], [[1.0, 1.0]], [[0.0]])
    assert cs.minreal(weak).system.n_states == 2
    assert cs.minreal(weak, tol=1e-4).system.n_states == 1


def test_the_stable_part_and_the_bound_beside_the_rest():
    rng = np.random.default_rng(5)
    for _ in range(20):
        n = int(rng.integers(2, 8))
        A = rng.normal(size=(n, n))
        G = control.ss(A, rng.normal(size=(n, 2)), rng.normal(size=(2, n)), np.eye(2), 0)
        parts = cs.stabsep(G)
        both = parts.stable.state_space() + parts.rest.state_space()
        assert apart(both, G, S) < 1e-9
        assert (np.linalg.eigvals(parts.stable.A).real < 0).all()
        assert (np.linalg.eigvals(parts.rest.A).real > 0).all()
        fixed = parts.rest.n_states
        if 0 < fixed < n - 1:
            cut = cs.balanced_truncation(G, order=fixed + 1, unstable="keep")
            # the unstable parts cancel in the difference, which is stable and within the bound
            w = np.geomspace(1e-3, 1e3, 400)
            gap = max(np.linalg.norm(G(1j * x) - cut.system.state_space()(1j * x), 2) for x in w)
            assert gap <= cut.error_bound * (1 + 1e-6)
            np.testing.assert_allclose(cut.left.T @ cut.right, np.eye(fixed + 1), atol=1e-8)
    assert cs.stabsep(control.tf([1], [1, 1, 0])).rest.n_states == 1
    with pytest.raises(ParameterError, match="below the 1 states"):
        cs.balanced_truncation(control.tf([1], [1, 1, 0]), order=0, unstable="keep")
    with pytest.raises((RankError, ParameterError)):
        cs.stabsep(G, margin=-1.0)
