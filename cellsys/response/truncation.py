"""Balanced truncation: the reference reduction of a plant that is a stable linear system."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.drawable import Drawable
from cellsys.errors import ParameterError, RankError
from cellsys.spectra.gramians import factors, require_stable, unscaled
from cellsys.spectra.minimal import stabsep
from cellsys.spectra.realization import EPS, Realization, balance, realization


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class BalancedTruncation(Drawable):
    """A reduced model with its a priori error bound.

    Attributes
    ----------
    system : Realization
        Order r, states named ``balanced[i]``; ``.system.state_space()`` for python-control.
    hankel : array (n,)
        Hankel singular values of the full system, falling.
    error_bound : float
        2 sum of the tail of `hankel`: bounds the H-infinity norm of full minus reduced.
    left, right : array (n, r)
        W, V with W^T V = I; A_r = W^T A V.
    """

    _figure: ClassVar[str] = "hankel"
    system: Realization
    hankel: np.ndarray
    error_bound: float
    left: np.ndarray
    right: np.ndarray

    @property
    def order(self) -> int:
        """Number of states kept."""
        return self.system.n_states

    def __str__(self) -> str:
        return (
            f"balanced truncation {len(self.hankel)} -> {self.order} states, "
            f"H-infinity error at most {self.error_bound:.4g}"
        )


@checked
def balanced_truncation(
    sys: LinearSystem,
    *,
    order: int | None = None,
    tol: float | None = None,
    unstable: Literal["refuse", "keep"] = "refuse",
) -> BalancedTruncation:
    """Square-root balanced truncation of a system, of its stable part where it has another.

        F_o^T F_c = U S Y^T,  V = F_c Y_1 S_1^-1/2,  W = F_o U_1 S_1^-1/2,  A_r = W^T A V
        |G - G_r|_inf <= 2 (sigma_{r+1} + ... + sigma_n)

    Parameters
    ----------
    sys : control.StateSpace or tuple of arrays
    order : int, optional
        States to keep.
    tol : float, optional
        Instead: the smallest order whose error bound is at most tol.
    unstable : "refuse" or "keep"
        Integrators and growing modes: refused, or kept whole beside the truncated stable part
        (`stabsep`), so that the bound holds for the difference. `order` counts them.

    Returns
    -------
    BalancedTruncation

    Raises
    ------
    ParameterError
        Not exactly one of order and tol; the system is not stable.
    RankError
        The order asked for is above the number of Hankel singular values that differ from zero
        by more than n eps of the first.

    References
    ----------
    Tombs and Postlethwaite, Int. J. Control 46 (1987) 1319; Antoulas (2005), section 7.
    """
    if (order is None) == (tol is None):
        raise ParameterError("give exactly one of order= and tol=")
    system = realization(sys).dense()
    if unstable == "keep" and system.n_states:
        return _beside_the_rest(system, order, tol)
    n = system.n_states
    require_stable(system, "balanced truncation")
    b = unscaled(balance(system))
    F_c, F_o = factors(b, discrete=system.is_discrete)
    U, s, Yt = sla.svd(F_o.T @ F_c) if n else (np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)))
    tails = 2 * np.concatenate([np.cumsum(s[::-1])[::-1], [0.0]])
    rank = int(np.count_nonzero(s > n * EPS * s.max(initial=0.0)))
    r = int(np.argmax(tails <= tol)) if order is None else int(order)
    r = min(r, rank) if order is None else r
    if not 0 <= r <= n:
        raise ParameterError(f"order must lie in 0..{n}, got {order!r}")
    if r > rank:
        raise RankError(f"order {r} is above the numerical rank {rank} of the Hankel operator")
    root = np.sqrt(s[:r])
    V = b.states[:, None] * (F_c @ Yt[:r].T) / root
    W = (F_o @ U[:, :r]) / root / b.states[:, None]
    reduced = Realization(
        W.T @ (system.A @ V),
        W.T @ system.B,
        system.C @ V,
        system.D,
        dt=system.dt,
        states=tuple(f"balanced[{i}]" for i in range(r)),
        inputs=system.inputs,
        outputs=system.outputs,
    )
    return BalancedTruncation(
        system=reduced, hankel=s, error_bound=float(tails[r]), left=W, right=V
    )


def _beside_the_rest(
    system: Realization, order: int | None, tol: float | None
) -> BalancedTruncation:
    """The stable part truncated, the rest kept: first the states of the rest."""
    parts = stabsep(system.state_space())
    fixed = parts.rest.n_states
    if not fixed:
        return balanced_truncation(system.state_space(), order=order, tol=tol)
    if order is not None and order < fixed:
        raise ParameterError(
            f"order {order} is below the {fixed} states that are not stable, which are kept; ask "
            "for more"
        )
    inner = balanced_truncation(
        parts.stable.state_space(), order=None if order is None else order - fixed, tol=tol
    )
    joined = Realization(
        sla.block_diag(parts.rest.A, inner.system.A),
        np.vstack([parts.rest.B, inner.system.B]),
        np.hstack([parts.rest.C, inner.system.C]),
        system.D,
        dt=system.dt,
        states=(*(f"kept[{i}]" for i in range(fixed)), *inner.system.states),
        inputs=system.inputs,
        outputs=system.outputs,
    )
    rest, stable = parts.rest_basis, parts.stable_basis
    return replace(
        inner,
        system=joined,
        left=np.hstack([rest[0], stable[0] @ inner.left]),
        right=np.hstack([rest[1], stable[1] @ inner.right]),
    )
