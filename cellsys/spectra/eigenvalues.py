"""Eigenvalues of many small matrices at once: with bounds of their errors, and as paths."""

from __future__ import annotations

from itertools import permutations

import numpy as np
from scipy.optimize import linear_sum_assignment

from cellsys.spectra.realization import EPS


def eigenvalues_with_bounds(L: np.ndarray, bound: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (q, k) of L (q, q, k) and bounds of their errors.

    |d lambda_i| <= (|V^-1| |dL| |V|)_ii + 4 eps |V^-1|_i |V|_i |L|, first order, the last term that
    of the QR algorithm [Golub and Van Loan 2013, 7.2.2, 7.5]; for nearly defective L at most
    (2 |L| + |dL|)^(1 - 1/q) |dL|^(1/q) [Elsner; Stewart and Sun 1990, theorem IV.1.3].
    """
    q = L.shape[0]
    if q == 1:
        return L[0], bound[0]
    if not L.shape[2]:
        return np.zeros((q, 0), complex), np.zeros((q, 0))
    matrices, error = np.moveaxis(L, -1, 0), np.moveaxis(bound, -1, 0)
    values, V = np.linalg.eig(np.where(np.isfinite(matrices), matrices, 1e300))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        norm, size = np.linalg.norm(matrices, axis=(1, 2)), np.linalg.norm(error, axis=(1, 2))
        # What no scaling of the channels changes, as QR works on the balanced matrix.
        within = np.sqrt(np.abs(matrices * np.swapaxes(matrices, 1, 2)).sum(axis=(1, 2)))
        W, V = np.abs(_inverses(V)), np.abs(V)
        noise = np.einsum("kij,kjl,kli->ki", W, error, V)
        noise += 4 * EPS * within[:, None] * np.linalg.norm(W, axis=2) * np.linalg.norm(V, axis=1)
        elsner = (2 * norm + size) ** (1 - 1 / q) * (size + EPS * within) ** (1 / q)
        noise = np.fmin(noise, elsner[:, None])
    return values.T, noise.T


def _inverses(V: np.ndarray) -> np.ndarray:
    """V^-1 (k, q, q) of matrices of eigenvectors; inf where V is singular."""
    if V.shape[1] == 2:
        det = V[:, 0, 0] * V[:, 1, 1] - V[:, 0, 1] * V[:, 1, 0]
        turned = np.array([[V[:, 1, 1], -V[:, 0, 1]], [-V[:, 1, 0], V[:, 0, 0]]])
        return np.moveaxis(turned / np.where(det == 0, 1e-300, det), -1, 0)
    s = np.linalg.svd(V, compute_uv=False)
    regular = s[:, -1] > EPS * s[:, 0]
    out = np.full(V.shape, np.inf, complex)
    out[regular] = np.linalg.solve(V[regular], np.eye(V.shape[1], dtype=complex)[None])
    return out


def track(values: np.ndarray) -> np.ndarray:
    """Reorder columns of (q, k) so that each row is a continuous path (nearest assignment)."""
    values = np.array(values)
    q, k = values.shape
    if q < 2 or k < 2:
        return values
    if q <= 4:
        every = np.array(list(permutations(range(q))))
        with np.errstate(over="ignore", invalid="ignore"):
            gaps = np.abs(values[:, None, :-1] - values[None, :, 1:])
            costs = sum(gaps[i, every[:, i]] for i in range(q))  # (q!, k - 1)
        best = every[np.argmin(np.where(np.isnan(costs), np.inf, costs), axis=0)]
        place = np.arange(q)
        places = np.empty((k, q), int)
        places[0] = place
        for i in range(k - 1):  # compose the steps
            place = best[i][place]
            places[i + 1] = place
        return np.take_along_axis(values, places.T, axis=0)
    for i in range(1, k):
        cost = np.abs(values[:, i - 1][:, None] - values[:, i][None])
        cost = np.where(np.isfinite(cost), cost, 1e300)
        values[:, i] = values[linear_sum_assignment(cost)[1], i]
    return values
