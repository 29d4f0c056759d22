"""Integrators: directions of the state nothing depends on, such as absolute position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.shown import Shown
from cellsys.spectra.realization import EPS

MARGINAL = "marginal: stable apart from its integrators"


def counted(number: int) -> str:
    """``"1 integrator"``, ``"2 integrators"``."""
    return f"{number} integrator" + ("" if number == 1 else "s")


def apart_from(verdict: str, integrators: int) -> str:
    """A verdict on what is left without the integrators, as one on the whole."""
    return MARGINAL if integrators and verdict == "stable" else verdict


def said_apart(integrators: int) -> str:
    """The end of a reason: how many were set apart; nothing of none."""
    return f"; set apart: {counted(integrators)}" if integrators else ""


@checked
@dataclass(frozen=True, eq=False)
class Integrators(Shown):
    """Null directions of A (of A - I in discrete time).

    Attributes
    ----------
    count : int
        Number of directions.
    states : tuple of str
        States that take part with more than a tenth of the largest share.
    basis : array (n, count)
        Orthonormal in balanced coordinates.
    tolerance : float
        Singular values up to this counted as 0.
    """

    count: int
    states: tuple[str, ...]
    basis: np.ndarray
    tolerance: float

    def __str__(self) -> str:
        if not self.count:
            return "none"
        names = ", ".join(self.states[:6]) + (", ..." if len(self.states) > 6 else "")
        return f"{self.count} (states {names})"


def set_apart(
    A: np.ndarray, scale: np.ndarray, names: tuple[str, ...], tol: float | None, *, discrete: bool
) -> tuple[Integrators, np.ndarray]:
    """Integrators of A and the orthonormal complement of their directions.

    A direction counts when its singular value is below `tol` and there is an eigenvalue below
    ``max(tol, 1e-6 |A|_F)`` for it. With [N, R] orthogonal and A N = 0 the
    other poles are those of R^T A R.

    Parameters
    ----------
    A : array (n, n), balanced
    scale : array (n,)
        Diagonal of the balancing transformation: x = scale * x_balanced.
    names : tuple of str
    tol : float, optional
        Absolute, 1/s; default 10 n eps |A|_F.
    discrete : bool

    Returns
    -------
    Integrators
    R : array (n, n - count)
    """
    n = len(A)
    M = A - np.eye(n) if discrete else A
    norm = float(sla.norm(A)) if n else 0.0
    limit = 10 * n * EPS * norm if tol is None else tol
    if n == 0:
        return Integrators(0, (), np.zeros((0, 0)), limit), np.zeros((0, 0))
    _, s, Vt = sla.svd(M)
    # A small singular value alone may only mean that M is far from normal.
    count = int(np.count_nonzero(s <= limit))
    if count:
        slow = np.abs(sla.eigvals(M)) <= max(limit, 1e-6 * norm)
        count = min(count, int(np.count_nonzero(slow)))
    basis = Vt[n - count :].T
    share = np.linalg.norm(basis * np.abs(scale)[:, None], axis=1) if count else np.zeros(n)
    states = tuple(names[i] for i in np.flatnonzero(share > 0.1 * share.max(initial=0.0)))
    rest = Vt[: n - count].T if count else np.eye(n)
    return Integrators(count, states if count else (), basis, limit), rest


def longest_chain(A: np.ndarray, tol: float | None, *, discrete: bool) -> int:
    """Number of integrators in the longest series: the size of the largest Jordan block at 0 (1).

    Null directions are taken away again and again; each round shortens every chain by one.
    """
    length = 0
    while len(A):
        apart, rest = set_apart(A, np.ones(len(A)), ("",) * len(A), tol, discrete=discrete)
        if not apart.count:
            break
        A = rest.T @ A @ rest
        length += 1
    return length
