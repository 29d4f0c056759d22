"""Without what no input reaches and no output sees, and split into a stable and another part."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.errors import ParameterError, RankError
from cellsys.kinds import FILLED
from cellsys.shown import Shown
from cellsys.spectra.realization import EPS, Realization, balance, realization
from cellsys.units import real_number


@checked
@dataclass(frozen=True, eq=False)
class MinimalForm(Shown):
    """A system without its uncontrollable and unobservable states.

    Attributes
    ----------
    system : Realization
        ``.system.state_space()`` for python-control.
    uncontrollable, unobservable : int
        States removed, in this order.
    change : float
        Size of the smallest change of the (scaled) matrices for which the removed states are
        exactly unreachable or unseen, over the norm of these: at most `tol` sqrt(steps).
    """

    system: Realization
    uncontrollable: int
    unobservable: int
    change: float

    def __str__(self) -> str:
        return (
            f"{self.system.n_states} states are left: {self.uncontrollable} that no input reaches "
            f"and {self.unobservable} that no output sees removed, within a relative change of "
            f"the matrices of {self.change:.1e}"
        )


@checked
def minreal(sys: LinearSystem, tol: float | None = None) -> MinimalForm:
    """Remove states that are not controllable or not observable to a relative tolerance.

    An orthonormal basis of the controllable space grows from the columns of B by products with A;
    a direction enters when it is longer than tol |[A B]|. What is left out is out of reach for
    matrices that differ by no more than that, so that no mode is removed which is controllable and
    observable beyond it. The same with A', C' for what is seen.

    Parameters
    ----------
    sys : control.StateSpace, TransferFunction or tuple of arrays
    tol : float, optional
        Default 1e-9; in (0, 1). Rounding grows along the chain of products, so that a few eps would
        keep states that are not there.

    Returns
    -------
    MinimalForm

    Raises
    ------
    ParameterError
        tol outside (0, 1).

    References
    ----------
    Paige, IEEE Trans. Automatic Control 26 (1981) 130; Van Dooren, same volume, 111.
    """
    system = realization(sys).dense()
    n = system.n_states
    tol = 1e-9 if tol is None else real_number(tol, "tol")
    if not 0 < tol < 1:
        raise ParameterError(f"tol must lie in (0, 1), a share of the matrices, got {tol!r}")
    b = balance(system)
    A, B, C = b.A, b.B, b.C
    V, left = _reached(A, B, tol)
    A, B, C = V.T @ A @ V, V.T @ B, C @ V
    W, unseen = _reached(A.T, C.T, tol)
    A, B, C = W.T @ A @ W, W.T @ B, C @ W
    size = float(sla.norm(np.hstack([b.A, b.B]))) if n else 0.0
    kept = len(A)
    # Inputs and outputs in their own units again.
    minimal = replace(
        system, A=A, B=B / b.right[None, :], C=C / b.left[:, None], states=FILLED,
    )  # fmt: skip
    if kept == n:
        minimal = system
    return MinimalForm(
        minimal,
        n - V.shape[1],
        V.shape[1] - kept,
        float(np.hypot(left, unseen)) / size if size else 0.0,
    )


def _reached(A: np.ndarray, B: np.ndarray, tol: float) -> tuple[np.ndarray, float]:
    """Orthonormal basis (n, k) of what B reaches by A, and the size of what was left out."""
    n = len(A)
    limit = tol * float(sla.norm(np.hstack([A, B]))) if n else 0.0
    V, new, left = np.zeros((n, 0)), B, 0.0
    while new.shape[1] and V.shape[1] < n:
        for _ in range(2):
            new = new - V @ (V.T @ new)
        U, s, _ = sla.svd(new, full_matrices=False)
        rank = int(np.count_nonzero(s > limit))
        left = float(np.hypot(left, sla.norm(s[rank:])))
        if not rank:
            break
        V = np.hstack([V, U[:, :rank]])
        new = A @ U[:, :rank]
    return V, left


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class StabilitySplit(Shown):
    """G = stable + rest, the feedthrough with the stable part.

    Attributes
    ----------
    stable, rest : Realization
    stable_basis, rest_basis : pair of arrays (n, k), (n, n - k)
        W, V of each part: its states are W^T x, and x = V_s z_s + V_r z_r.
    sharing : float
        2-norm condition of the change of coordinates: what rounding is amplified by.
    """

    stable: Realization
    rest: Realization
    stable_basis: tuple[np.ndarray, np.ndarray]
    rest_basis: tuple[np.ndarray, np.ndarray]
    sharing: float

    def __str__(self) -> str:
        return (
            f"{self.stable.n_states} stable and {self.rest.n_states} other states (condition of "
            f"the split {self.sharing:.2g})"
        )


@checked
def stabsep(sys: LinearSystem, margin: float = 0.0) -> StabilitySplit:
    """Split a system into its stable part and the rest, G = G_s + G_r.

    An ordered real Schur form, then one Sylvester equation A_s X - X A_r = -A_sr.

    Parameters
    ----------
    sys : control.StateSpace, TransferFunction or tuple of arrays
    margin : float
        Poles with Re >= -margin, 1/s (of modulus >= 1 - margin in discrete time), go to the rest;
        integrators with it at 0.

    Returns
    -------
    StabilitySplit

    Raises
    ------
    ParameterError
        A margin that is not >= 0.
    RankError
        Poles of both parts that cannot be told apart.

    References
    ----------
    Safonov, Jonckheere, Verma and Limebeer, Int. J. Control 46 (1987) 817.
    """
    system = realization(sys).dense()
    margin = real_number(margin, "margin")
    if not margin >= 0:
        raise ParameterError(f"margin must be >= 0, got {margin!r}")
    n = system.n_states
    b = balance(system)
    floor = 100 * max(n, 1) * EPS * (float(sla.norm(b.A)) if n else 0.0)
    if system.is_discrete:

        def stays(re: float, im: float) -> bool:
            return bool(np.hypot(re, im) < 1 - max(margin, floor))
    else:

        def stays(re: float, im: float) -> bool:
            return bool(re < -max(margin, floor))

    if n:
        T, Q, count = sla.schur(b.A, output="real", sort=stays)
    else:
        T, Q, count = np.zeros((0, 0)), np.zeros((0, 0)), 0
    k = int(count)
    X = np.zeros((k, n - k))
    if 0 < k < n:
        X = sla.solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:])
        off = T[:k, :k] @ X - X @ T[k:, k:] + T[:k, k:]
        if not (np.isfinite(X).all() and sla.norm(off) <= 1e-6 * max(float(sla.norm(T)), 1e-300)):
            raise RankError(
                "the stable part and the rest share poles to rounding; choose a margin between "
                "them (cs.poles lists them)"
            )
    # x = Q [[I, X], [0, I]] (z_s, z_r)
    B, C = Q.T @ b.B, b.C @ Q
    B, C = B / b.right[None, :], C / b.left[:, None]
    B_s, C_r = B[:k] - X @ B[k:], C[:, :k] @ X + C[:, k:]
    condition = float(np.linalg.norm(X, 2) + 1) ** 2 if X.size else 1.0
    stable = replace(system, A=T[:k, :k], B=B_s, C=C[:, :k], states=FILLED)
    rest = replace(
        system, A=T[k:, k:], B=B[k:], C=C_r, D=np.zeros_like(system.D), states=FILLED
    )  # fmt: skip
    W, V = Q / b.states[:, None], Q * b.states[:, None]
    return StabilitySplit(
        stable=stable,
        rest=rest,
        stable_basis=(W[:, :k] - W[:, k:] @ X.T, V[:, :k]),
        rest_basis=(W[:, k:], V[:, :k] @ X + V[:, k:]),
        sharing=condition,
    )
