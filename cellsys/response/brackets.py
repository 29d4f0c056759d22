"""Roots of many brackets at once: one call of the function for all of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cellsys.spectra.realization import EPS


def find_roots(
    f: Callable[[np.ndarray, np.ndarray], np.ndarray],
    a: np.ndarray,
    b: np.ndarray,
    fa: np.ndarray,
    fb: np.ndarray,
    first: np.ndarray,
    width: np.ndarray,
    rounds: int = 200,
) -> np.ndarray:
    """Where functions change sign, to four ulp of the larger end, or where they are one ulp of 1.

    Inverse quadratic interpolation where it is safe, else halving [Chandrupatla, Adv. Eng.
    Software 28 (1997) 145], all brackets side by side.

    Parameters
    ----------
    f : callable
        (x (k,), number of the bracket of each (k,)) -> values (k,).
    a, b, fa, fb : array (c,)
        Ends and the values there, of opposite sign.
    first : array (c,)
        First points tried; the middle where they are not inside.
    width : array (c,)
        Brackets this narrow (relative) are done; 0: four ulp.
    rounds : int
        Most calls of f; halving alone needs no more than 64 for ends of one size.

    Returns
    -------
    array (c,)
    """
    a, b, fa, fb = (np.array(v, dtype=float) for v in (a, b, fa, fb))
    c, fc, t = a.copy(), fa.copy(), (first - a) / (b - a)
    least = np.maximum(2 * EPS, width / 2)
    t = np.where((t > 0) & (t < 1), t, 0.5)
    best = np.where(np.abs(fa) < np.abs(fb), a, b)
    active = np.arange(len(a))
    for _ in range(rounds):
        if not active.size:
            break
        i = active
        x = a[i] + t[i] * (b[i] - a[i])
        fx = f(x, i)
        same = np.sign(fx) == np.sign(fa[i])
        c[i], fc[i] = np.where(same, a[i], b[i]), np.where(same, fa[i], fb[i])
        b[i], fb[i] = np.where(same, b[i], a[i]), np.where(same, fb[i], fa[i])
        a[i], fa[i] = x, fx
        best[i] = np.where(np.abs(fa[i]) < np.abs(fb[i]), a[i], b[i])
        wide = np.abs(b[i] - a[i])
        with np.errstate(divide="ignore", invalid="ignore"):
            limit = least[i] * np.abs(best[i]) / wide
            xi = (a[i] - b[i]) / (c[i] - b[i])
            phi = (fa[i] - fb[i]) / (fc[i] - fb[i])
            step = fa[i] / (fb[i] - fa[i]) * fc[i] / (fb[i] - fc[i]) + (c[i] - a[i]) / (
                b[i] - a[i]
            ) * fa[i] / (fc[i] - fa[i]) * fb[i] / (fc[i] - fb[i])
            safe = (phi**2 < xi) & ((1 - phi) ** 2 < 1 - xi) & np.isfinite(step)
        done = (np.abs(fx) <= EPS) | ~(limit < 0.5)
        limit = np.minimum(limit, 0.5)
        t[i] = np.clip(np.where(safe, step, 0.5), limit, 1 - limit)
        active = i[~done]
    return best
