"""Lyapunov equations with their residuals, and Lyapunov certificates of stability."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.shown import Shown
from cellsys.spectra.realization import EPS


def lyapunov(A: np.ndarray, Q: np.ndarray, *, discrete: bool) -> tuple[np.ndarray, float]:
    """X of A X + X A^T + Q = 0, or of A X A^T - X + Q = 0, and its relative residual.

    The residual is |R|_F / (2 |A| |X| + |Q|), or / ((|A|^2 + 1) |X| + |Q|): LAPACK's normalised
    sense without the factor n eps. One step of iterative refinement is taken.

    Parameters
    ----------
    A, Q : array (n, n), Q symmetric

    Returns
    -------
    X : array (n, n), symmetric
    residual : float
    """
    n = len(A)
    if n == 0:
        return np.zeros((0, 0)), 0.0
    a = float(sla.norm(A))
    if discrete:
        X = _stein(A, Q)
        X = X + _stein(A, A @ X @ A.T - X + Q)
        R, size = A @ X @ A.T - X + Q, (a * a + 1) * float(sla.norm(X))
    else:
        T, Z = sla.schur(A, output="real")
        X = _schur_solve(T, Z, Q)
        X = X + _schur_solve(T, Z, A @ X + X @ A.T + Q)
        R, size = A @ X + X @ A.T + Q, 2 * a * float(sla.norm(X))
    X = 0.5 * (X + X.T)
    size += float(sla.norm(Q))
    return X, float(sla.norm(R)) / size if size > 0 else 0.0


def _schur_solve(T: np.ndarray, Z: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """A X + X A^T = -Q with A = Z T Z^T [Bartels and Stewart 1972; LAPACK trsyl]."""
    Y, scale, _ = sla.lapack.dtrsyl(T, T, -(Z.T @ Q @ Z), tranb="T")
    return Z @ (Y / scale) @ Z.T


def _stein(A: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """A X A^T - X = -Q by doubling (Smith 1968): X = sum of A^k Q A^kT."""
    X, M = np.array(Q), np.array(A)
    for _ in range(60):
        step = M @ X @ M.T
        X = X + step
        if sla.norm(step) <= EPS * sla.norm(X):
            break
        M = M @ M
    return X


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class LyapunovCertificate(Shown):
    """P with A^T P + P A = -I (A^T P A - P = -I in discrete time), or why there is none.

    Attributes
    ----------
    valid : bool
        P and -(A^T P + P A) are positive definite by more than rounding.
    P : array (n, n) or None
    residual : float
        Relative residual; nan without P.
    condition : float
        Condition number of P; sqrt of it bounds max |exp(A t)|. inf without a valid P.
    reason : str
        In words.
    """

    valid: bool
    P: np.ndarray | None
    residual: float
    condition: float
    reason: str

    def __str__(self) -> str:
        return self.reason


def certificate(A: np.ndarray, excess: float, *, discrete: bool) -> LyapunovCertificate:
    """Lyapunov certificate of x' = A x (x+ = A x).

    Parameters
    ----------
    A : array (n, n)
    excess : float
        Largest Re of the eigenvalues, or largest modulus - 1: a certificate needs it < 0.
    discrete : bool

    Returns
    -------
    LyapunovCertificate
    """
    n = len(A)
    if n == 0:
        return LyapunovCertificate(
            valid=True,
            P=np.zeros((0, 0)),
            residual=0.0,
            condition=1.0,
            reason="no states: nothing to show",
        )
    if not excess < 0:
        return LyapunovCertificate(
            valid=False,
            P=None,
            residual=np.nan,
            condition=np.inf,
            reason="none: a pole lies on or beyond the stability boundary",
        )
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", sla.LinAlgWarning)
        P, residual = lyapunov(A.T, np.eye(n), discrete=discrete)
        if not np.all(np.isfinite(P)):
            return LyapunovCertificate(
                valid=False, P=None, residual=np.nan, condition=np.inf, reason="none: P overflows"
            )
        S = A.T @ P @ A - P if discrete else A.T @ P + P @ A
    S = 0.5 * (S + S.T)
    p, a = sla.eigvalsh(P), float(sla.norm(A))
    rounding = n * EPS * p[-1]
    error = n * EPS * (a * a + 1 if discrete else 2 * a) * float(sla.norm(P))
    top = float(sla.eigvalsh(S)[-1])
    if p[0] <= rounding:
        reason = f"none: P is not positive definite beyond rounding ({p[0]:.1e} of {p[-1]:.1e})"
        return LyapunovCertificate(
            valid=False, P=P, residual=residual, condition=np.inf, reason=reason
        )
    if top + error >= 0:
        reason = f"none: rounding {error:.1e} swallows the decrease (largest {top:.1e})"
        return LyapunovCertificate(
            valid=False, P=P, residual=residual, condition=np.inf, reason=reason
        )
    condition = float(p[-1] / p[0])
    return LyapunovCertificate(
        valid=True,
        P=P,
        residual=residual,
        condition=condition,
        reason=f"P > 0, A^T P {'A - P' if discrete else '+ P A'} <= {top + error:.2g} I, "
        f"residual {residual:.1e}, cond(P) = {condition:.2g}",
    )
