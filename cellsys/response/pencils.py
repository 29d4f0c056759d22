"""Frequencies at which a return ratio meets the unit circle, the real axis or a level: pencils.

With L~(s) = L(-s) (L(1/z) in discrete time), which is the conjugate of L on the boundary, an
eigenvalue of L(j w) has modulus one, or is real, only where

    det(I - L (x) L~) = 0,      det(L (x) I - I (x) L~) = 0      [(x): Kronecker product]

and a singular value of M(j w) equals g only where det(g^2 I - M~^T M) = 0. Each is the zero
polynomial of a state space of 2 n q (2 n) states, so that all frequencies are generalised
eigenvalues: none is missed between the points of a grid, below it or beyond it. They are
candidates (rounding moves them, two different eigenvalues may be each other's conjugates): loci
and their signs decide.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import numpy as np
import scipy.linalg as sla

from cellsys.spectra.gramians import unscaled
from cellsys.spectra.realization import Realization, balance

MOST_ROWS = 300  # of a pencil; above, it costs more than the grid
_NEAR = 0.02  # distance from the boundary, relative to the frequency, that rounding may explain


@dataclass(frozen=True, eq=False)
class PencilBlock:
    """A system in a pencil, x' = A x + B u, y = C x + D u, or its mirror image in -s or 1/z."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    _: KW_ONLY
    mirrored: bool = False


@dataclass(frozen=True, eq=False)
class Fitting:
    """A square system in units that fit: states by powers of two, time by `rate` (rad/s)."""

    block: PencilBlock
    dt: float
    rate: float


def rows(system: Realization) -> int:
    """Rows of the larger pencil of the loci of a square system."""
    return 2 * system.n_states * system.n_inputs + system.n_inputs**2


def fitting(system: Realization) -> Fitting:
    """The system for a pencil: balanced, and in continuous time with |A| about one."""
    b = unscaled(balance(system))
    rate = 1.0
    if not system.is_discrete and b.A.size and np.any(b.A):
        rate = float(np.exp2(np.rint(np.log2(np.abs(b.A).max()))))
    return Fitting(PencilBlock(b.A / rate, b.B / rate, b.C, b.D), system.dt, rate)


def _copies(L: PencilBlock, left: bool, mirrored: bool) -> PencilBlock:
    """L (x) I, or I (x) L."""
    parts = (L.A, L.B, L.C, L.D)
    if len(L.D) == 1:
        return PencilBlock(*parts, mirrored=mirrored)
    I = np.eye(len(L.D))  # noqa: E741
    A, B, C, D = (np.kron(M, I) if left else np.kron(I, M) for M in parts)
    return PencilBlock(A, B, C, D, mirrored=mirrored)


def _rows(block: PencilBlock, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """M_x, M_u, N_x, N_u of the state rows M_x x + M_u u = s (N_x x + N_u u)."""
    n, m = block.B.shape
    eye, none = np.eye(n), np.zeros((n, m))
    if not block.mirrored:
        return block.A, block.B, eye, none
    if dt > 0:  # x = z (A x + B u)
        return eye, none, block.A, block.B
    return -block.A, -block.B, eye, none


def _cascade(first: PencilBlock, second: PencilBlock, gain: float, dt: float) -> np.ndarray:
    """Values s where det(second first - gain I) = 0."""
    n1, n2, m = len(first.A), len(second.A), len(first.D.T)
    M1, U1, N1, V1 = _rows(first, dt)
    M2, U2, N2, V2 = _rows(second, dt)
    DD = second.D @ first.D - gain * np.eye(m)
    n = n1 + n2
    M = np.zeros((n + m, n + m))
    M[:n1, :n1], M[:n1, n:] = M1, U1
    M[n1:n, :n1], M[n1:n, n1:n], M[n1:n, n:] = U2 @ first.C, M2, U2 @ first.D
    M[n:, :n1], M[n:, n1:n], M[n:, n:] = second.D @ first.C, second.C, DD
    if dt == 0 and np.linalg.cond(DD) < 1e8:
        # One matrix instead of a pencil: the input is eliminated.
        return np.linalg.eigvals(M[:n, :n] - M[:n, n:] @ np.linalg.solve(DD, M[n:, :n]))
    N = np.zeros_like(M)
    N[:n1, :n1], N[:n1, n:] = N1, V1
    N[n1:n, :n1], N[n1:n, n1:n], N[n1:n, n:] = V2 @ first.C, N2, V2 @ first.D
    return _pencil(M, N)


def _pencil(M: np.ndarray, N: np.ndarray) -> np.ndarray:
    alpha, beta = sla.eigvals(M, N, homogeneous_eigvals=True)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        values = alpha / beta
    return values[np.isfinite(values)]


def _frequencies(values: np.ndarray, fit: Fitting) -> np.ndarray:
    """Frequencies > 0 (rad/s), rising, of the values next to the boundary."""
    if fit.dt > 0:
        values = np.log(values[values != 0])
        kept = np.abs(values.real) <= np.maximum(_NEAR * np.abs(values.imag), 1e-6)
        found = np.abs(values.imag[kept]) / fit.dt
        return np.unique(found[(found > 0) & (found < np.pi / fit.dt)])
    kept = np.abs(values.real) <= _NEAR * np.abs(values)
    found = np.abs(values.imag[kept]) * fit.rate
    return np.unique(found[found > 0])


def unit_modulus(fit: Fitting) -> np.ndarray:
    """Candidates (rad/s) for an eigenvalue of L of modulus one."""
    if not len(fit.block.A):
        return np.zeros(0)
    first = _copies(fit.block, left=False, mirrored=True)
    second = _copies(fit.block, left=True, mirrored=False)
    return _frequencies(_cascade(first, second, 1.0, fit.dt), fit)


def real_axis(fit: Fitting) -> np.ndarray:
    """Candidates (rad/s) for a real eigenvalue of L."""
    if not len(fit.block.A):
        return np.zeros(0)
    first = _copies(fit.block, left=False, mirrored=True)
    second = _copies(fit.block, left=True, mirrored=False)
    M1, U1, N1, V1 = _rows(first, fit.dt)
    M2, U2, N2, V2 = _rows(second, fit.dt)
    k, m = U1.shape
    n = 2 * k
    M = np.zeros((n + m, n + m))
    M[:k, :k], M[k:n, k:n], M[:k, n:], M[k:n, n:] = M1, M2, U1, U2
    M[n:, :k], M[n:, k:n], M[n:, n:] = -first.C, second.C, second.D - first.D
    N = np.zeros_like(M)
    N[:k, :k], N[k:n, k:n], N[:k, n:], N[k:n, n:] = N1, N2, V1, V2
    return _frequencies(_pencil(M, N), fit)


def level(fit: Fitting, value: float) -> np.ndarray:
    """Candidates (rad/s) for a singular value equal to `value`."""
    M = fit.block
    if not len(M.A):
        return np.zeros(0)
    back = PencilBlock(M.A.T, M.C.T, M.B.T, M.D.T, mirrored=True)
    return _frequencies(_cascade(M, back, value**2, fit.dt), fit)
