"""Transient growth of exp(A t) or A^k: bounds from below."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from cellsys.spectra.realization import EPS
from cellsys.spectra.singular import boundary, smallest_singular


def sampled_growth(A: np.ndarray, *, discrete: bool, slowest: float) -> tuple[float, float]:
    """Largest |exp(A t)|_2 (|A^k|_2) over sampled times, and the time: a lower bound.

    Times are h 2^j and 1.5 h 2^j (powers 1, 2, 3, 4, 6, 8, ...).

    Parameters
    ----------
    A : array (n, n)
    discrete : bool
    slowest : float
        Decay rate of the slowest mode, 1/s or 1/step; samples end at 20 times its time
        constant, or at 1e6 of the shortest step.

    Returns
    -------
    growth, time : float
        time in s, or in steps.
    """
    n = len(A)
    if n == 0:
        return 1.0, 0.0
    norm = max(float(sla.norm(A, 1)), np.finfo(float).tiny)
    t = 1.0 if discrete else float(2.0 ** np.floor(np.log2(0.5 / norm)))
    M = np.array(A) if discrete else sla.expm(t * A)
    half = None
    # A mode that hardly decays is followed for 1e6 of the shortest times only.
    best, when, end = 1.0, 0.0, min(20.0 / slowest if slowest > 0 else np.inf, 1e6 * t)
    for _ in range(200):
        trials = [(t, M)]
        # |M half| <= |M|_F |half|_F: the product is only formed where it could be a record.
        if half is not None and float(sla.norm(M)) * float(sla.norm(half)) > best:
            with np.errstate(over="ignore", invalid="ignore", under="ignore"):
                trials.append((1.5 * t, M @ half))
        for time, matrix in trials:
            if np.all(np.isfinite(matrix)) and float(sla.norm(matrix)) > best:
                size = _norm2(matrix)
                if size > best:
                    best, when = size, time
        if t > end or not np.all(np.isfinite(M)):
            break
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):
            half, M, t = M, M @ M, 2 * t
    return best, when


def _norm2(M: np.ndarray) -> float:
    """2-norm from below by power iteration on M^T M, scaled against overflow."""
    scale = float(np.abs(M).max())
    if scale == 0:
        return 0.0
    N = M / scale
    v = np.random.default_rng(0).standard_normal((N.shape[1],))
    size = 0.0
    for _ in range(60):
        v /= np.linalg.norm(v)
        w = N @ v
        new = float(np.linalg.norm(w))
        v = N.T @ w
        if new <= size * (1 + 1e-6) or not np.any(v):
            break
        size = new
    return scale * max(new, size)


def kreiss_lower(T: np.ndarray, values: np.ndarray, *, discrete: bool) -> tuple[float, complex]:
    """Lower bound of the Kreiss constant, and the point it comes from.

        K = sup Re z |(z I - A)^-1|  over Re z > 0      (sup (|z| - 1) |...| over |z| > 1);
        K <= sup |exp(A t)| <= e n K                    (Trefethen and Embree 2005, section 14)

    The supremum over a grid of points above the eigenvalues next to the boundary: a lower bound
    (each |(z I - A)^-1| is itself one).
    """
    if not len(T):
        return 1.0, complex(np.nan)
    depth = np.abs(np.abs(values) - 1) if discrete else np.abs(values.real)
    near = np.argsort(depth)[:8]
    angle = np.unique(np.abs(np.angle(values[near]) if discrete else values.imag[near]))
    angle = np.unique(np.concatenate([[0.0], angle]))
    size = float(np.abs(values).max())
    low = max(float(depth[near].min()), 1e-12 * max(size, 1e-300))
    height = np.geomspace(0.1 * low, 10 * max(size, low), 20)
    z = boundary(angle, discrete)[:, None]
    z = (z * (1 + height) if discrete else z + height).ravel()
    sigma = smallest_singular(T, z)
    # Below n eps |A| the inverse is not known: a bound from there would be noise.
    known = sigma > 10 * len(T) * EPS * float(sla.norm(T))
    value = np.where(known, np.tile(height, len(angle)) / np.where(known, sigma, 1.0), 0.0)
    i = int(np.argmax(value))
    return max(1.0, float(value[i])), complex(z[i])
