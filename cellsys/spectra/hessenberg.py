"""Frequency response of one input through the controller-Hessenberg form.

With B = beta e_1 and A upper Hessenberg, rows n..2 of (s I - A) x = beta t e_1 give x upwards
from x_n = 1 by a recurrence, and row 1 gives the factor t [Hyman's method, Wilkinson 1965 p. 426;
Laub 1981 for the form]. Every row is solved with a small relative backward error, so the result is
as good as that of a pivoted solve; nothing is factored. All frequencies share the real matrix A,
so that the work is real matrix-matrix products.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.linalg as sla
from scipy.linalg import lapack

from cellsys.spectra.realization import EPS

BLOCK = 32
_LOG_RANGE = 400.0  # natural log of the growth allowed between two rescalings
_BIG = 1e60


@dataclass(frozen=True, eq=False)
class ControllerHessenberg:
    """A = H upper Hessenberg (r, r), b = beta e_1, rows of C in the same coordinates (p, r).

    r < n when the input does not reach the rest: the subdiagonal entry below r was at most
    `EPS`/100 of the norm of A.
    """

    H: np.ndarray
    beta: float
    C: np.ndarray
    norm: float  # Frobenius norm of A


def controller_hessenberg(A: np.ndarray, b: np.ndarray, C: np.ndarray) -> ControllerHessenberg:
    """Reduce (A, b, C) by orthogonal transformations, b to the first axis first.

    Parameters
    ----------
    A : array (n, n)
    b : array (n,)
    C : array (p, n)

    Returns
    -------
    ControllerHessenberg
    """
    n = len(b)
    norm = float(sla.norm(A))
    length = float(sla.norm(b))
    if n == 0 or length == 0:
        return ControllerHessenberg(np.zeros((0, 0)), 0.0, np.zeros((C.shape[0], 0)), norm)
    v = np.array(b, dtype=float) / length
    sign = 1.0 if v[0] >= 0 else -1.0
    v[0] += sign
    v *= np.sqrt(1.0 / abs(v[0]))  # P = I - v v^T maps b / length to -sign e_1
    H = np.array(A, order="F")
    H -= np.outer(v, v @ H)
    H -= np.outer(H @ v, v)
    C = C - np.outer(C @ v, v)
    if n > 2:
        lwork = int(lapack.dgehrd_lwork(n, lo=0, hi=n - 1)[0])
        H, tau, _ = lapack.dgehrd(H, lo=0, hi=n - 1, lwork=lwork, overwrite_a=True)
        # The reflectors stand below the first subdiagonal, as those of a QR lie below the diagonal.
        Q = np.asfortranarray(H[1:, :-1])
        C[:, 1:] = lapack.dormqr("R", "N", Q, tau, C[:, 1:], max(64, 64 * len(C)))[0]
        H = np.triu(H, -1)
    small = np.flatnonzero(np.abs(np.diagonal(H, -1)) <= 0.01 * EPS * norm)
    r = int(small[0]) + 1 if small.size else n
    return ControllerHessenberg(
        np.ascontiguousarray(H[:r, :r]), -sign * length, np.ascontiguousarray(C[:, :r]), norm
    )


def _blocks(H: np.ndarray, s_max: float) -> list[int]:
    """Row edges, from n down to 1, so that no block grows by more than exp(_LOG_RANGE)."""
    n = H.shape[0]
    rows = np.abs(H[1:]).sum(axis=1) + s_max
    growth = np.log(np.maximum(rows / np.abs(np.diagonal(H, -1)), 1.0)) + 1.0
    edges, total = [n], 0.0
    for i in range(n - 1, 0, -1):
        total += growth[i - 1]
        if edges[-1] - i > BLOCK or (total > _LOG_RANGE and edges[-1] - i > 1):
            edges.append(i + 1)
            total = growth[i - 1]
    edges.append(1)
    return edges


def response(form: ControllerHessenberg, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """C (s I - A)^-1 b and the norm of (s I - A)^-1 b for many s at once.

    Parameters
    ----------
    form : ControllerHessenberg
    s : complex array (k,)

    Returns
    -------
    g : complex array (p, k)
        Infinite where s is a pole to working precision.
    size : array (k,)
        Euclidean norm of the state per unit input.
    """
    H, n, k = form.H, form.H.shape[0], len(s)
    if n == 0:
        return np.zeros((form.C.shape[0], k), complex), np.zeros(k)
    X = np.empty((n, k), complex)
    flat = X.view(float)  # the same memory as (n, 2k) reals: H is real
    X[n - 1] = 1.0
    edges = _blocks(H, float(np.abs(s).max(initial=0.0))) if n > 1 else [1]
    for hi, lo in pairwise(edges):
        known = (H[lo:hi, hi - 1 :] @ flat[hi - 1 :]).view(complex)
        for i in range(hi - 1, lo - 1, -1):  # row i gives x[i-1]
            acc = s * X[i] - known[i - lo]
            if i < hi - 1:
                acc -= (H[i, i : hi - 1] @ flat[i : hi - 1]).view(complex)
            np.divide(acc, H[i, i - 1], out=X[i - 1])
        top = np.abs(flat[lo - 1 : hi - 1]).max(axis=0).reshape(k, 2).max(axis=1)
        if np.any(top > _BIG):
            X[lo - 1 :] *= np.where(top > _BIG, np.exp2(-np.rint(np.log2(np.maximum(top, 1)))), 1)
    total = s * X[0] - (H[0] @ flat).view(complex)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        factor = form.beta / total
        g = (form.C @ flat).view(complex) * factor
        size = np.sqrt((flat * flat).sum(axis=0).reshape(k, 2).sum(axis=1)) * np.abs(factor)
    pole = total == 0
    g[:, pole], size[pole] = np.inf, np.inf
    return g, size
