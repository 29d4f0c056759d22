"""Disk margin: the largest singular value of (I + L)^-1 (I - L) on the boundary."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cellsys.response import pencils
from cellsys.response.loci import Loci
from cellsys.response.resolvent import s_plane

_PEAKS = 8  # local maxima of the grid that are climbed
_RTOL = 1e-9
_ROWS = 120  # of a pencil that is solved several times; above, climbing costs less
Size = Callable[[np.ndarray], np.ndarray]  # omega (k,) -> largest singular value (k,)


def largest(L: np.ndarray) -> np.ndarray:
    """Largest singular value of (I + L)^-1 (I - L) for L (q, q, k); inf where I + L is singular."""
    q = L.shape[0]
    if q == 1:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            size = np.abs((1 - L[0, 0]) / (1 + L[0, 0]))
        return np.where(np.isnan(size), np.inf, size)
    matrices, I = np.moveaxis(L, -1, 0), np.eye(q)  # noqa: E741
    try:
        M = np.linalg.solve(I + matrices, I - matrices)
    except np.linalg.LinAlgError:
        # One singular matrix stops all: (1 - s)/(1 + s) of nearly I + L, bounded by its inverse.
        s = np.linalg.svd(I + matrices, compute_uv=False)[:, -1]
        regular = s > 0
        out = np.full(len(s), np.inf)
        if regular.any():
            M = np.linalg.solve(I + matrices[regular], I - matrices[regular])
            out[regular] = np.linalg.svd(M, compute_uv=False)[:, 0]
        return out
    return np.linalg.svd(M, compute_uv=False)[:, 0]


def disk_margin(loci: Loci) -> tuple[float, float]:
    """2 over the largest |(I + L)^-1 (I - L)|, and its frequency (rad/s).

    The frequencies where a singular value equals the largest found so far are eigenvalues of a
    Hamiltonian matrix or a symplectic pencil, and the search goes on between them until there
    are none [Bruinsma and Steinbuch, Systems and Control Letters 14 (1990) 287]. Where that is too
    large, the peaks of the grid are climbed.
    """
    dt = loci.system.dt

    def size(omega: np.ndarray) -> np.ndarray:
        return largest(loci.evaluate(s_plane(omega, dt)))

    values = largest(loci.L)
    values = np.where(np.isnan(values), np.inf, values)
    by_levels = loci.fitting is not None and 2 * loci.system.n_states <= _ROWS
    if not by_levels:
        omega, peak = _climbed(size, loci.omega, values)
    else:
        i = int(np.argmax(values))
        omega, peak = float(loci.omega[i]), float(values[i])
    for end, L in _ends(loci):
        if np.all(np.isfinite(L)) and (top := float(largest(L[:, :, None])[0])) > peak * (
            1 + 1e-12
        ):
            omega, peak = end, top
    if np.isfinite(peak) and by_levels:
        omega, peak = _level_sets(loci.fitting, size, omega, peak)
    return (2.0 / peak if peak > 0 else np.inf), omega


def _ends(loci: Loci) -> list[tuple[float, np.ndarray]]:
    if loci.system.is_discrete:
        return [(0.0, loci.evaluate.at(1.0)), (np.pi / loci.system.dt, loci.evaluate.at(-1.0))]
    return [(0.0, loci.evaluate.at(0.0)), (np.inf, loci.system.D.astype(complex))]


def _climbed(size: Size, omega: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """The largest value, after the highest local maxima have been climbed by smaller steps."""
    i = int(np.argmax(values))
    best, peak = float(omega[i]), float(values[i])
    if not np.isfinite(peak) or len(omega) < 3:
        return best, peak
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    top = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:]))
    top = top[np.argsort(values[top])[-_PEAKS:]]
    top = top[values[top] > 0.5 * peak]
    lo, hi = omega[np.maximum(top - 1, 0)], omega[np.minimum(top + 1, len(omega) - 1)]
    share = np.linspace(0, 1, 9)
    for _ in range(8):
        points = lo[:, None] + (hi - lo)[:, None] * share
        found = size(points.ravel()).reshape(points.shape)
        j = np.argmax(np.where(np.isnan(found), -np.inf, found), axis=1)
        rows = np.arange(len(top))
        k = int(np.argmax(found[rows, j]))
        if found[k, j[k]] > peak:
            best, peak = float(points[k, j[k]]), float(found[k, j[k]])
        lo, hi = points[rows, np.maximum(j - 1, 0)], points[rows, np.minimum(j + 1, 8)]
    return best, peak


def _level_sets(fit: pencils.Fitting, size: Size, omega: float, peak: float) -> tuple[float, float]:
    for _ in range(10):
        found = pencils.spread_level(fit, peak * (1 + _RTOL))
        if not found.size:
            break
        trial = np.concatenate([found, np.sqrt(found[1:] * found[:-1])])
        values = size(trial)
        i = int(np.argmax(np.where(np.isnan(values), -np.inf, values)))
        if not values[i] > peak * (1 + _RTOL):
            break
        omega, peak = float(trial[i]), float(values[i])
        if not np.isfinite(peak):
            break
    return omega, peak
