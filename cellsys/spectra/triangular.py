"""Resolvent columns of many shifts from one Schur form, for systems with many channels.

(s I - T) X = B with T upper triangular: back substitution by blocks of rows, all shifts and all
right-hand sides together [Golub and Van Loan 2013, 3.1.4].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

BLOCK = 32


@dataclass(frozen=True, eq=False)
class TriangularForm:
    """Complex Schur form Q^H A Q = T with Q^H B (n, m) and C Q (p, n)."""

    T: np.ndarray
    B: np.ndarray
    C: np.ndarray
    norm: float  # Frobenius norm of A


def triangular_form(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> TriangularForm:
    """Complex Schur form by way of the real one."""
    T, Q = sla.rsf2csf(*sla.schur(A, output="real"))
    return TriangularForm(T, Q.conj().T @ B, C @ Q, float(sla.norm(A)))


def solve(T: np.ndarray, s: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """X of (s I - T) X = rhs for every s.

    Parameters
    ----------
    T : complex array (n, n), upper triangular
    s : complex array (k,)
    rhs : array (n, m), or (n, k, m): one for each s

    Returns
    -------
    complex array (n, k, m)
    """
    n, k, m = T.shape[0], len(s), rhs.shape[-1]
    X = np.empty((n, k, m), complex)
    X[:] = rhs if rhs.ndim == 3 else rhs[:, None, :]
    flat = X.reshape(n, k * m)
    for hi in range(n, 0, -BLOCK):
        lo = max(hi - BLOCK, 0)
        if hi < n:
            flat[lo:hi] += T[lo:hi, hi:] @ flat[hi:]
        for i in range(hi - 1, lo - 1, -1):
            if i < hi - 1:
                flat[i] += T[i, i + 1 : hi] @ flat[i + 1 : hi]
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                X[i] /= (s - T[i, i])[:, None]
    return X


def response(form: TriangularForm, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """G = C (s I - A)^-1 B (p, m, k), norms of its state columns (m, k) and rows (p, k)."""
    X = solve(form.T, s, form.B)
    G = np.tensordot(form.C, X, 1).transpose(0, 2, 1)
    right = np.sqrt((X.real**2 + X.imag**2).sum(axis=0)).T
    # Rows of C (s I - T)^-1: a lower triangular system, made upper by reversing the order.
    Y = solve(form.T.T[::-1, ::-1], s, form.C.T[::-1])
    left = np.sqrt((Y.real**2 + Y.imag**2).sum(axis=0)).T
    return G, right, left
