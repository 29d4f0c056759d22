"""Default time axes: long enough for what the slow modes do, fine enough for the fast ones."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from cellsys.spectra.realization import EPS, Realization, balance

_CONSTANTS = 7.0  # time constants until a mode counts as gone: exp(-7) = 1e-3
_PERIODS = 10.0  # that an undamped oscillation is shown for
_PER_CONSTANT, _PER_PERIOD = 5.0, 12.0  # points
_LEAST = 500
_SMALL = np.array([0.1, 0.02, 1.1e-3])  # left two quarters before the end, one, and there
_FINITE = 600.0  # e-folds that are a double still
_LADDER = 11  # halvings of the axis at which the impulse response is looked at
_MOST, _MOST_ENTRIES = 150_000, 20_000_000  # points; points times states times inputs


def automatic_times(system: Realization) -> np.ndarray:
    """Times (k,) from 0, in s; on sampling instants of a discrete system.

    To seven time constants of the slowest decaying mode and on until the impulse response of the
    decaying part is below 1e-3 of its largest value (chains of lags, delays: at least 2 n samples
    in discrete time, which determine the response); to ten periods of undamped modes; but no
    further than exp(7) of the fastest growing one. Every mode has 5 points per time constant and
    12 per period for as long as it lasts, so that the steps widen where rates are far apart. Where
    that is more than 150 000 points, the axis ends earlier.
    """
    n = system.n_states
    b = balance(system)
    step = system.dt if system.is_discrete else 0.0
    values = np.linalg.eigvals(b.A).astype(complex) if n else np.zeros(0, complex)
    size = 10 * n * EPS * float(sla.norm(b.A)) if n else 0.0
    noise = np.full(len(values), size)
    if step:
        values = values[np.abs(values) > 1e-8]
        noise = np.maximum(size / np.abs(values), 10 * EPS) / step
        values = np.log(values) / step
    rate, turn = values.real, np.abs(values.imag)
    decays, grows = rate < -noise, rate > noise
    lives = np.where(decays, _CONSTANTS / np.maximum(np.abs(rate), 1e-300), np.inf)
    swings = ~decays & ~grows & (turn > noise)
    ends = [
        *lives[decays], *(2 * np.pi * _PERIODS / turn[swings]), *(_CONSTANTS / rate[grows]),
        2 * n * step,
    ]  # fmt: skip
    end = max(ends)
    if end == 0:
        end = 10 * step if step else (1.0 if not n else 100.0)
    if n and decays.any() and min(b.B.size, b.C.size):
        end = _settled(b.A, b.B, b.C, max(size, 10 * EPS if step else 0.0), step, end)
    if grows.any():
        end = min(end, _CONSTANTS / rate.max())
    fine = np.minimum(
        1 / (_PER_CONSTANT * np.maximum(np.abs(rate), 1e-300)),
        2 * np.pi / (_PER_PERIOD * np.maximum(turn, 1e-300)),
    )
    most = int(np.clip(_MOST_ENTRIES // max(n * system.n_inputs, 1), 2000, _MOST))
    if step:
        least = 10
        if grows.any():  # two samples of growth, after those that nothing is seen in
            representable = max(int(_FINITE / (rate.max() * step)), 2)
            least = min(2 + _dead_samples(b.A, b.B, b.C), representable)
        return step * _instants(fine / step, lives / step, end / step, most, least)
    return _moments(fine, lives, end, most)


def _dead_samples(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> int:
    """Samples after which the input first reaches the output through the states: C A^k B = 0 to
    rounding until then."""
    for k in range(len(A)):
        if np.abs(C @ B).max(initial=0.0) > 1e-12 * sla.norm(C) * sla.norm(B):
            return k
        B = A @ (B / max(sla.norm(B), 1e-300))
    return 0


def _moments(fine: np.ndarray, lives: np.ndarray, end: float, most: int) -> np.ndarray:
    """Continuous times: even where that takes no more than 4 times the least number of points,
    else in steps that double as modes die out."""
    widest = end / _LEAST
    least = min(float(fine[fine > 0].min(initial=np.inf)), widest)
    if end / least <= 4 * _LEAST:
        count = int(np.ceil(end / least - 1e-9))
        return _short(end / count) * np.arange(count + 1)
    parts, t, left = [np.zeros(1)], 0.0, most
    while t < end * (1 - 1e-12) and left > 0:
        alive = lives > t * (1 + 1e-12)
        need = min(float(fine[alive].min(initial=np.inf)), widest)
        h = _short(least) * 2.0 ** np.floor(np.log2(need / least) + 1e-9)
        until = min(float(lives[alive & (fine <= 2 * need)].min(initial=np.inf)), end)
        count = int(min(max(np.ceil((until - t) / h), 1), left))
        parts.append(t + h * np.arange(1, count + 1))
        t, left = float(parts[-1][-1]), left - count
    return np.concatenate(parts)


def _short(h: float) -> float:
    """h with 30 binary digits: its multiples are exact, and so all steps are the same double."""
    mantissa, exponent = np.frexp(h)
    return float(np.ldexp(np.ceil(mantissa * 2**30), int(exponent) - 30))


def _instants(fine: np.ndarray, lives: np.ndarray, end: float, most: int, least: int) -> np.ndarray:
    """Discrete times in samples: all of the first 2000, then by strides that double."""
    end = max(int(np.ceil(end - 1e-9)), least)
    k = min(end, 4 * _LEAST)
    parts, left = [np.arange(k + 1)], most - k
    while k < end and left > 0:
        alive = lives > k
        need = min(float(fine[alive].min(initial=np.inf)), end / _LEAST)
        stride = int(2 ** max(np.floor(np.log2(need)), 0)) if need > 1 else 1
        until = min(float(lives[alive & (fine <= 2 * need)].min(initial=np.inf)), end)
        count = int(min(max(np.ceil((until - k) / stride), 1), left))
        parts.append(k + stride * np.arange(1, count + 1))
        k, left = int(parts[-1][-1]), left - count
    return np.concatenate(parts)


def _settled(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, noise: float, step: float, end: float
) -> float:
    """The end, moved on until the impulse response of the decaying modes has died out."""
    inner = 1 - noise if step else -noise

    def decays(re: float, im: float) -> bool:
        return bool(np.hypot(re, im) < inner) if step else bool(re < inner)

    T, Q, k = sla.schur(A, output="real", sort=decays)
    A, C, B, rest = T[:k, :k], C @ Q[:, :k], (Q.T @ B)[:k], (Q.T @ B)[k:]
    if k < len(T):  # the part of the input that moves the decaying modes alone
        B = B + sla.solve_sylvester(A, -T[k:, k:], T[:k, k:]) @ rest
    # exp(A h), h = end/2^11, and its squares up to exp(A end/4).
    rungs = min(_LADDER, max(int(np.log2(end / step)), 2)) if step else _LADDER
    first = max(round(end / step / 2**rungs), 1) if step else end / 2**rungs
    power = np.linalg.matrix_power(A, first) if step else sla.expm(A * first)
    sizes = []
    for _ in range(rungs - 2):
        sizes.append(float(np.abs(C @ power @ B).max(initial=0.0)))
        power = power @ power
    quarter = (first * step if step else first) * 2.0 ** (rungs - 2)
    for quarters in range(1, 160):
        C = C @ power
        sizes.append(float(np.abs(C @ B).max(initial=0.0)))
        # A few samples in all have no ladder: three values are looked at in any case.
        small = len(sizes) >= 3 and np.all(np.array(sizes[-3:]) <= _SMALL * max(sizes))
        if quarters * quarter >= end * (1 - 1e-9) and small:
            return quarters * quarter
    return end
