"""Slow modes of a plant set apart from the rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg as sla

from cellsys.errors import ParameterError
from cellsys.spectra.certainty import PoleCertainty, side, widened
from cellsys.spectra.realization import balancing
from cellsys.spectra.spectrum import spectrum


def split_slow(
    A: np.ndarray,
    B: np.ndarray,
    C: np.ndarray,
    slower_than: float,
    certainty: PoleCertainty | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Part of (A, B, C) whose poles are at least `slower_than` away from zero, and the others.

    Ordered real Schur form, then one Sylvester equation decouples the blocks:
    G = G_fast + G_slow exactly. A pole that grows beyond its error bound stays, however slow: it
    is no integrator.

    Parameters
    ----------
    A : (m, m), B : (m, p), C : (q, m)
    slower_than : float
        1/s. Over a run of length T a pole with |pole| < 1/T cannot be told from an integrator
        (the drift of absolute position of a crawling cell).
    certainty : PoleCertainty, optional
        Of the poles of A: bounds are then the larger of rounding and data.

    Returns
    -------
    A_fast (k, k), B_fast (k, p), C_fast (q, k), slow poles (m - k,)
    """
    if not (np.isfinite(slower_than) and slower_than >= 0):
        raise ParameterError(f"slower_than must be >= 0 1/s, got {slower_than!r}")
    keep = _kept(A, slower_than, certainty)
    T, Q, k = sla.schur(A, output="real", sort=lambda re, im: keep(complex(re, im)))
    if k == len(A):
        return A, B, C, np.zeros(0, complex)
    slow = sla.eigvals(T[k:, k:])
    if k == 0:
        return np.zeros((0, 0)), np.zeros((0, B.shape[1])), np.zeros((len(C), 0)), slow
    # T11 X - X T22 = -T12 makes [[I, X], [0, I]] decouple the two blocks.
    X = sla.solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:])
    B_s, C_s = Q.T @ B, C @ Q
    return T[:k, :k], B_s[:k] - X @ B_s[k:], C_s[:, :k], slow


def _kept(
    A: np.ndarray, slower_than: float, certainty: PoleCertainty | None
) -> Callable[[complex], bool]:
    """Whether a pole stays: fast, or growing beyond its error bound."""
    if slower_than == 0 or not len(A):
        return lambda pole: True
    known = widened(spectrum(balancing(A)[0]), certainty, 0.0)
    # A pair stays or goes as one: both have the same real part, and the larger bound counts.
    growing = known.values[side(known.values.real, known.bound) > 0]
    growing = growing[np.abs(growing) < slower_than]

    def keep(pole: complex) -> bool:
        if abs(pole) >= slower_than:
            return True
        near = np.abs(known.values - pole)
        return bool(len(growing)) and float(np.abs(growing - pole).min()) <= float(near.min())

    return keep


def set_apart_text(slow: np.ndarray) -> str:
    """What to say of the poles set apart, 1/s."""
    if not len(slow):
        return ""
    open_ = int(np.count_nonzero(slow.real > 0))
    growing = f"; {open_} may grow, which the data leave open" if open_ else ""
    return (
        f"; {len(slow)} slow poles set apart as integrators of absolute position "
        f"(|pole| <= {np.abs(slow).max():.2g} 1/s{growing})"
    )
