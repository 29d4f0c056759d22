"""What is shown when nothing else is asked for: default time axes, phases of Bode diagrams."""

import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.response import frequency_response, step_response
from tests import naive
from tests.hard.stress import SEED, Case, Choice, Int, Power, hold


def modes(rng, kind, n, spread, damping):
    """A block-diagonal A with poles that are known, and its poles."""
    rates = np.exp(rng.uniform(-1, 1, n) * np.log(spread) / 2)
    if kind == "lags":  # a chain: a delay of its length
        return np.diag(-rates) + np.diag(rates[1:], -1), -rates + 0j
    if kind == "growing":
        rates[0] *= -1
    if kind != "oscillating":
        return np.diag(-rates), -rates + 0j
    blocks = [r * np.array([[0.0, 1.0], [-1.0, -2 * damping]]) for r in rates]
    pole = -damping + 1j * np.sqrt(1 - damping**2)
    return sla.block_diag(*blocks), np.concatenate([rates * pole, rates * np.conj(pole)])


def default_axes_show_the_response(kind, n, spread, damping, samples, seed):
    """Exact values on an axis that is long enough for the slowest mode and fine enough for the
    fastest; delays are on it, growth does not overflow."""
    rng = np.random.default_rng(seed)
    A, poles = modes(rng, kind, n, spread, damping)
    N = len(A)
    B, C = (np.eye(N, 1), np.eye(1, N, N - 1)) if kind == "lags" else np.split(
        rng.uniform(0.5, 2, (2, N)), 2)  # fmt: skip
    B = B.reshape(N, 1)
    dt = 0.0
    if samples:
        # From ten samples per time constant of the fastest mode to one per ten of them.
        turns = np.abs(poles.imag).max()
        dt = 10.0 ** rng.uniform(-1, 0.3 if turns else 1) / (turns or np.abs(poles).max())
        F = sla.expm(np.block([[A, B], [np.zeros((1, N + 1))]]) * dt)
        A, B = F[:N, :N], F[:N, N:]
        line = (np.eye(samples, k=-1), np.eye(samples, 1), np.eye(1, samples, samples - 1))
        A = np.block([[line[0], np.zeros((samples, N))], [B @ line[2], A]])
        B, C = np.vstack([line[1], np.zeros((N, 1))]), np.hstack([np.zeros((1, samples)), C])
    found = step_response((A, B, C, 0, dt))
    t, y, steps = found.t, found.y[:, 0, 0], np.diff(found.t)
    assert t[0] == 0
    assert np.all(steps > 0)
    assert len(t) <= 151_000
    assert np.isfinite(y).all()
    assert np.abs(y).max() > 0
    # against powers of the matrix that holds the input as a state, at a few of the times
    held = np.zeros((len(A) + 1,) * 2)
    held[:-1, :-1], held[:-1, -1:] = A, B
    held[-1, -1] = 1.0 if dt else 0.0
    for k in rng.integers(0, len(t), 4):
        power = np.linalg.matrix_power(held, round(t[k] / dt)) if dt else sla.expm(held * t[k])
        assert abs((C @ power[:-1, -1:]).item() - y[k]) <= 1e-7 * np.abs(y).max()
    if len(t) > 140_000:
        return  # as long as it may be
    if kind == "growing":
        assert np.exp(poles.real.max() * t[-1]) < 1e4 * (1e300 if dt else 1.0)
        return
    assert t[-1] >= 6.99 / np.abs(poles.real).min() * (1 - 1e-9)
    for pole in poles[poles.imag > 0]:
        alive = t[:-1] < 7 / abs(pole.real)
        assert steps[alive].max() <= max(2 * np.pi / (10 * pole.imag), dt * 1.001)
    final = (C @ np.linalg.solve((np.eye(len(A)) if dt else 0) - A, B)).item()
    assert abs(y[-1] - final) <= 0.01 * np.abs(y).max()


def test_naive_axis_misses_the_response():
    # naive: seven time constants of the slowest mode, 501 points
    t = naive.seven_time_constants(-np.eye(100) + np.eye(100, k=-1))
    A = np.diag([-1.0] * 100) + np.eye(100, k=-1)
    F = sla.expm(np.block([[A, np.eye(100, 1)], [np.zeros((1, 101))]]) * t[-1])
    assert abs(F[99, 100]) < 1e-60  # of 1: nothing of it is on the axis
    t = naive.seven_time_constants(np.array([[0.0, 1.0], [-1.0, -2e-4]]))
    assert np.diff(t).max() > 20 * 2 * np.pi
    default_axes_show_the_response("lags", 60, 1.0, 0.1, 0, 0)
    default_axes_show_the_response("oscillating", 1, 1.0, 1e-4, 0, 0)


def phases_are_sums_over_roots(poles, zeros, integrators, seed):
    """Phase = -90 m - sum of the turns of (j w - pole) + those of zeros, less 180 deg for K < 0."""
    rng = np.random.default_rng(seed)

    def some(count):
        # either half plane, single and in pairs; none nearer to the axis than 1e-6 of its size
        size = 10.0 ** rng.uniform(-1, 1, count)
        damping = rng.choice([-1, 1, 1], count) * 10.0 ** rng.uniform(-6, 0, count)
        pair = rng.random(count) < 0.5
        return [(w, c if p else np.sign(c), p) for w, c, p in zip(size, damping, pair, strict=True)]

    zeros = min(zeros, poles)
    above, below = some(zeros), some(poles)
    above = [(w, np.sign(c), False) if not below[k][2] else (w, c, p)
             for k, (w, c, p) in enumerate(above)]  # fmt: skip
    A, B, C, D = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.eye(1) * rng.normal()
    sign = 1.0 if D[0, 0] > 0 else -1.0
    omega = np.sort(10.0 ** rng.uniform(-2, 2, 12))
    turn = np.zeros(len(omega))
    for k in range(poles + integrators):
        if k < poles:
            w, c, pair = below[k]
            over = above[k] if k < zeros else None
            den = [1.0, 2 * c * w, w * w] if pair else [1.0, c * w]
            num = (
                [1.0]
                if over is None
                else (
                    [1.0, 2 * over[1] * over[0], over[0] ** 2]
                    if over[2]
                    else [1.0, over[1] * over[0]]
                )
            )
        else:
            den, num = [1.0, 0.0], [1.0]
        for poly, way in ((num, 1.0), (den, -1.0)):
            for root in np.roots(poly):
                # arg(j w - r), continuous from w = 0 on: the left plane turns by +, the right by -
                at = np.angle((1j * omega - root) / (0 - root)) if root != 0 else np.pi / 2
                side = -1.0 if root.real > 0 else 1.0
                if root != 0 and root.imag != 0:  # one of a pair may turn by more than 180 deg
                    at = side * (np.arctan((omega - root.imag) / abs(root.real))
                                 - np.arctan(-root.imag / abs(root.real)))  # fmt: skip
                turn += way * at
            if len(poly) == 2 and poly[1] < 0:
                sign = -sign
        step = np.roots(den).size
        num = np.concatenate([np.zeros(step + 1 - len(num)), num])
        a = np.eye(step, k=-1)
        a[:1] = -np.asarray(den[1:])
        b, c_, d = np.eye(step, 1), (num[1:] - num[0] * np.asarray(den[1:]))[None], num[:1, None]
        A = np.block([[A, np.zeros((len(A), step))], [b @ C, a]])
        B, C, D = np.vstack([B, b @ D]), np.hstack([d @ C, c_]), d @ D
    want = np.rad2deg(turn) - (0.0 if sign > 0 else 180.0)
    found = frequency_response((A, B, C, D), omega)
    good = found.accuracy[0, 0] < 1e-3
    got = np.rad2deg(found.phase[0, 0])
    # a degree: what an accuracy of 1e-3 leaves, and roots 1e-6 from the axis
    assert np.all(np.abs(got - want)[good] < 1.0), (got - want)[good]


def test_naive_phase_starts_anywhere():
    # naive: unwrapped and moved into (-270, 90]: 1/s^3 at +90
    assert naive.phase_by_unwrapping([1.0], [1.0, 0.0, 0.0, 0.0], 1.0) == pytest.approx(90.0)
    phases_are_sums_over_roots(0, 0, 3, 0)


CASES = (
    Case(
        "default time axis",
        default_axes_show_the_response,
        {
            "kind": Choice("real", "oscillating", "lags", "growing"),
            "n": Int(1, 8),
            "spread": Power(0, 6),
            "damping": Power(-4, -0.1),
            "samples": Choice(0, 0, 1, 2, 20),
            "seed": SEED,
        },
        oracle=True,
    ),
    Case(
        "phase",
        phases_are_sums_over_roots,
        {"poles": Int(0, 5), "zeros": Int(0, 5), "integrators": Int(0, 4), "seed": SEED},
        oracle=True,
    ),
)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_random_instances(case):
    hold(case, 12)
