"""Disk margin: the largest singular value of (I + L)^-1 (I - L) on the boundary."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg as sla

from cellsys.errors import DataError
from cellsys.response import pencils
from cellsys.response.eigenvalue_loci import Loci
from cellsys.spectra.realization import Realization
from cellsys.spectra.resolvent import Resolvent, s_plane

_PEAKS = 8  # local maxima of the grid that are climbed
_RTOL = 1e-9
_ROWS = 120  # of a pencil that is solved several times; above, climbing costs less
Size = Callable[[np.ndarray], np.ndarray]  # omega (k,) -> largest singular value (k,)


def disk_margin(loci: Loci) -> tuple[float, float]:
    """2 over the largest |(I + L)^-1 (I - L)|, and its frequency (rad/s).

    (I + L)^-1 (I - L) = 2 (I + L)^-1 - I is evaluated as a system of its own: it is finite at
    poles of L, where L says nothing. The frequencies where a singular value equals the largest
    found so far are eigenvalues of a Hamiltonian matrix or a symplectic pencil, and the search
    goes on between them until there are none [Bruinsma and Steinbuch, Systems and Control Letters
    14 (1990) 287]. Where that is too large, the peaks of the grid are climbed.
    """
    discrete = loci.system.is_discrete
    top = np.pi / loci.system.dt if discrete else np.inf
    M = _closed(loci.system)
    if M is None and not discrete:
        return 0.0, top  # I + L is singular at infinity
    size = _of_matrices(loci) if M is None else _of_system(M)
    by_levels = (
        M if M is not None and loci.fitting is not None and 2 * M.n_states <= _ROWS else None
    )
    if by_levels is None:
        omega, peak = climbed(size, loci.omega, size(loci.omega))
    else:  # the L at hand says where to begin, and M how large it is there
        omega = float(loci.omega[np.argmax(size_of_values(loci.L))])
        peak = float(size(np.array([omega]))[0])
    for end in (0.0, top):
        if M is not None and np.isinf(end):
            value = _largest(M.D[:, :, None])[0]
        else:
            value = size(np.array([end]))[0]
        if value > peak * (1 + 1e-12):
            omega, peak = end, float(value)
    if by_levels is not None and 0 < peak < np.inf:
        omega, peak = _level_sets(pencils.fitting(by_levels), size, omega, peak)
    return (2.0 / peak if peak > 0 else np.inf), omega


def _closed(L: Realization) -> Realization | None:
    """2 (I + L)^-1 - I: A - B F^-1 C, B F^-1, -2 F^-1 C, 2 F^-1 - I, F = I + D; None without."""
    I = np.eye(L.n_inputs)  # noqa: E741
    F = I + L.D
    if np.linalg.svd(F, compute_uv=False)[-1] < 1e-14 * max(1.0, float(sla.norm(L.D))):
        return None
    K = np.linalg.solve(F, np.hstack([L.C, I]))
    C, E = K[:, : L.n_states], K[:, L.n_states :]
    try:
        return Realization(L.A - L.B @ C, L.B @ E, -2 * C, 2 * E - I, dt=L.dt)
    except DataError:  # rates beyond what a Realization holds: L itself was at the edge
        return None


def _largest(M: np.ndarray) -> np.ndarray:
    """Largest singular value of M (q, q, k); inf where it is not finite."""
    if len(M) == 1:
        values = np.abs(M[0, 0])
    else:
        finite = np.isfinite(M).all(axis=(0, 1))
        values = np.full(M.shape[2], np.inf)
        values[finite] = np.linalg.norm(np.moveaxis(M[:, :, finite], -1, 0), 2, axis=(1, 2))
    return np.where(np.isfinite(values), values, np.inf)


def _of_system(M: Realization) -> Size:
    evaluate = Resolvent(M)
    return lambda omega: _largest(evaluate(s_plane(omega, M.dt)))


def _of_matrices(loci: Loci) -> Size:
    return lambda omega: size_of_values(loci.evaluate(s_plane(omega, loci.system.dt)))


def size_of_values(L: np.ndarray) -> np.ndarray:
    """Largest singular value of (I + L)^-1 (I - L), from L (q, q, k); inf if I + L is singular."""
    if len(L) == 1:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            values = np.abs(1 - L[0, 0]) / np.abs(1 + L[0, 0])
        return np.where(np.isfinite(values), values, np.inf)
    L = np.moveaxis(L, -1, 0)
    I = np.eye(L.shape[1])  # noqa: E741
    finite = np.isfinite(L).all(axis=(1, 2))
    L = np.where(finite[:, None, None], L, 0.0)
    # By its singular values: a solve may call singular what these do not.
    U, s, Vh = np.linalg.svd(I + L)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        inverse = np.swapaxes(Vh.conj(), 1, 2) / s[:, None, :]
        M = inverse @ (np.swapaxes(U.conj(), 1, 2) @ (I - L))
    return np.where(finite, _largest(np.moveaxis(M, 0, -1)), np.inf)


def climbed(size: Size, omega: np.ndarray, values: np.ndarray) -> tuple[float, float]:
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
    rows = np.arange(len(top))
    for _ in range(8):
        points = lo[:, None] + (hi - lo)[:, None] * np.linspace(0, 1, 9)
        found = size(points.ravel()).reshape(points.shape)
        j = np.argmax(found, axis=1)
        k = int(np.argmax(found[rows, j]))
        if found[k, j[k]] > peak:
            best, peak = float(points[k, j[k]]), float(found[k, j[k]])
        lo, hi = points[rows, np.maximum(j - 1, 0)], points[rows, np.minimum(j + 1, 8)]
    return best, peak


def _level_sets(fit: pencils.Fitting, size: Size, omega: float, peak: float) -> tuple[float, float]:
    for _ in range(10):
        found = pencils.level(fit, peak * (1 + _RTOL))
        if not found.size:
            break
        trial = np.concatenate([found, np.sqrt(found[1:] * found[:-1])])
        values = size(trial)
        i = int(np.argmax(values))
        if not values[i] > peak * (1 + _RTOL):
            break
        omega, peak = float(trial[i]), float(values[i])
        if not np.isfinite(peak):
            break
    return omega, peak
