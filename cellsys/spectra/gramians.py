"""Gramians by Hammarling's method, with residuals; Hankel singular values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.drawable import Drawable
from cellsys.errors import ParameterError
from cellsys.spectra.realization import Balanced, Realization, balance, realization


def factor(A: np.ndarray, B: np.ndarray, *, discrete: bool) -> np.ndarray:
    """F with X = F F^T, A X + X A^T + B B^T = 0 (A X A^T - X + B B^T = 0); F never squares B.

    Parameters
    ----------
    A : array (n, n), all eigenvalues inside the stability region
    B : array (n, m)

    Returns
    -------
    array (n, n)

    References
    ----------
    Hammarling, IMA J. Numer. Anal. 2 (1982) 303; Kressner, ACM TOMS 34 (2008) 1.
    """
    n = len(A)
    if n == 0 or B.shape[1] == 0:
        return np.zeros((n, n))
    T, Q = sla.rsf2csf(*sla.schur(A, output="real"))
    R = Q.conj().T @ B
    U = np.zeros((n, n), complex)
    diagonal = np.arange(n)
    for j in range(n - 1, -1, -1):
        b, pole = R[j], T[j, j]
        size = float(np.linalg.norm(b))
        depth = 1 - abs(pole) ** 2 if discrete else -2 * pole.real
        alpha = size / np.sqrt(depth)
        U[j, j] = alpha
        if alpha == 0 or j == 0:  # this row is not excited: nothing to pass on
            continue
        q, t, rest = b / alpha, T[:j, j], R[:j]
        shifted = np.array(T[:j, :j], order="F")
        if discrete:
            shifted *= np.conj(pole)
            shifted[diagonal[:j], diagonal[:j]] -= 1
            rhs = -(rest @ q.conj()) - np.conj(pole) * alpha * t
        else:
            shifted[diagonal[:j], diagonal[:j]] += np.conj(pole)
            rhs = -(rest @ q.conj()) - alpha * t
        u = sla.solve_triangular(shifted, rhs, check_finite=False)
        U[:j, j] = u
        if discrete:
            wide = np.hstack([(T[:j, :j] @ u + alpha * t)[:, None], rest])
            R[:j] = _without(wide, np.concatenate([[pole], q]))
        else:
            R[:j] = rest - np.outer(u, q)
    F = Q @ U
    wide = np.hstack([F.real, F.imag])
    return np.ascontiguousarray(sla.qr(wide.T, mode="r")[0][:n].T)


def _without(W: np.ndarray, q: np.ndarray) -> np.ndarray:
    """V with V V^H = W (I - q^H q) W^H and one column less; q has unit length."""
    v = np.conj(q)
    phase = v[0] / abs(v[0]) if v[0] != 0 else 1.0
    v = v.copy()
    v[0] += phase
    return (W - np.outer(W @ v, v.conj()) * (2 / np.vdot(v, v).real))[:, 1:]


@checked
@dataclass(frozen=True, eq=False)
class Gramian(Drawable):
    """X = F F^T of a Lyapunov equation, in given coordinates.

    Attributes
    ----------
    matrix : array (n, n)
    factor : array (n, n)
        F.
    residual : float
        |R|_F / (2 |A| |X| + |B B^T|) (discrete: (|A|^2 + 1) |X|), in balanced coordinates.
    kind : str
        ``"controllability"`` or ``"observability"``.
    """

    _figure: ClassVar[str] = "hankel"
    matrix: np.ndarray
    factor: np.ndarray
    residual: float
    kind: str

    def __str__(self) -> str:
        n = len(self.matrix)
        return f"{self.kind} Gramian, {n} x {n}, relative residual {self.residual:.1e}"


def require_stable(system: Realization, what: str) -> None:
    """ParameterError unless every computed pole lies inside the stability region."""
    values = sla.eigvals(balance(system).A) if system.n_states else np.zeros(0)
    excess = np.abs(values) - 1 if system.is_discrete else values.real
    if values.size and not excess.max() < 0:
        bad = complex(values[np.argmax(excess)])
        raise ParameterError(
            f"{what} needs a stable system, but {bad:.6g} is a pole; stabilise it, or split off "
            "its unstable part and integrators first"
        )


def factors(b: Balanced, *, discrete: bool) -> tuple[np.ndarray, np.ndarray]:
    """Factors of the controllability and observability Gramians, in balanced coordinates."""
    return factor(b.A, b.B, discrete=discrete), factor(b.A.T, b.C.T, discrete=discrete)


def unscaled(b: Balanced) -> Balanced:
    """Undo the scaling of inputs and outputs, which Gramians depend on."""
    ones = np.ones
    return Balanced(
        A=b.A,
        B=b.B / b.right[None, :],
        C=b.C / b.left[:, None],
        D=b.D / b.left[:, None] / b.right[None, :],
        states=b.states,
        left=ones(len(b.left)),
        right=ones(len(b.right)),
    )


def _residual(A: np.ndarray, F: np.ndarray, B: np.ndarray, *, discrete: bool) -> float:
    X, Q, a = F @ F.T, B @ B.T, float(sla.norm(A))
    R = A @ X @ A.T - X + Q if discrete else A @ X + X @ A.T + Q
    size = (a * a + 1 if discrete else 2 * a) * float(sla.norm(X)) + float(sla.norm(Q))
    return float(sla.norm(R)) / size if size > 0 else 0.0


@checked
def controllability_gramian(sys: LinearSystem) -> Gramian:
    """Controllability Gramian of a stable system.

        A X + X A^T + B B^T = 0          (A X A^T - X + B B^T = 0 in discrete time)

    Parameters
    ----------
    sys : control.StateSpace or tuple of arrays

    Returns
    -------
    Gramian

    Raises
    ------
    ParameterError
        A pole lies on or beyond the stability boundary.
    DataError, DimensionError, MemoryBudgetError
        As for `poles`.

    References
    ----------
    Hammarling, IMA J. Numer. Anal. 2 (1982) 303.
    """
    system = realization(sys).dense()
    require_stable(system, "a Gramian")
    b = unscaled(balance(system))
    F = factor(b.A, b.B, discrete=system.is_discrete)
    residual = _residual(b.A, F, b.B, discrete=system.is_discrete)
    F = b.states[:, None] * F
    return Gramian(F @ F.T, F, residual, "controllability")


@checked
def observability_gramian(sys: LinearSystem) -> Gramian:
    """Observability Gramian of a stable system.

        A^T X + X A + C^T C = 0          (A^T X A - X + C^T C = 0 in discrete time)

    Parameters
    ----------
    sys : control.StateSpace or tuple of arrays

    Returns
    -------
    Gramian

    Raises
    ------
    ParameterError
        A pole lies on or beyond the stability boundary.
    DataError, DimensionError, MemoryBudgetError
        As for `poles`.

    References
    ----------
    Hammarling, IMA J. Numer. Anal. 2 (1982) 303.
    """
    system = realization(sys).dense()
    require_stable(system, "a Gramian")
    b = unscaled(balance(system))
    F = factor(b.A.T, b.C.T, discrete=system.is_discrete)
    residual = _residual(b.A.T, F, b.C.T, discrete=system.is_discrete)
    F = F / b.states[:, None]
    return Gramian(F @ F.T, F, residual, "observability")


@checked
def hankel_singular_values(sys: LinearSystem) -> np.ndarray:
    """Hankel singular values of a stable system, falling.

        sigma_i = sqrt(eig_i(X_c X_o)), as singular values of F_o^T F_c

    Parameters
    ----------
    sys : control.StateSpace or tuple of arrays

    Returns
    -------
    array (n,)

    Raises
    ------
    ParameterError
        A pole lies on or beyond the stability boundary.
    DataError, DimensionError, MemoryBudgetError
        As for `poles`.

    References
    ----------
    Moore, IEEE Trans. Automatic Control 26 (1981) 17.
    """
    system = realization(sys).dense()
    require_stable(system, "a Hankel singular value")
    F_c, F_o = factors(unscaled(balance(system)), discrete=system.is_discrete)
    return sla.svdvals(F_o.T @ F_c) if system.n_states else np.zeros(0)
