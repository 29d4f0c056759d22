"""Slow modes of a plant set apart from the rest."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from cellsys.errors import ParameterError


def split_slow(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, slower_than: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Part of (A, B, C) whose poles are at least `slower_than` away from zero, and the others.

    Ordered real Schur form, then one Sylvester equation decouples the blocks:
    G = G_fast + G_slow exactly.

    Parameters
    ----------
    A : (m, m), B : (m, p), C : (q, m)
    slower_than : float
        1/s. Over a run of length T a pole with |pole| < 1/T cannot be told from an integrator
        (the drift of absolute position of a crawling cell).

    Returns
    -------
    A_fast (k, k), B_fast (k, p), C_fast (q, k), slow poles (m - k,)
    """
    if not (np.isfinite(slower_than) and slower_than >= 0):
        raise ParameterError(f"slower_than must be >= 0 1/s, got {slower_than!r}")
    T, Q, k = sla.schur(
        A, output="real", sort=lambda re, im: float(np.hypot(re, im)) >= slower_than
    )
    if k == len(A):
        return A, B, C, np.zeros(0, complex)
    slow = sla.eigvals(T[k:, k:])
    if k == 0:
        return np.zeros((0, 0)), np.zeros((0, B.shape[1])), np.zeros((len(C), 0)), slow
    # T11 X - X T22 = -T12 makes [[I, X], [0, I]] decouple the two blocks.
    X = sla.solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:])
    B_s, C_s = Q.T @ B, C @ Q
    return T[:k, :k], B_s[:k] - X @ B_s[k:], C_s[:, :k], slow
