"""One block of coupled cells per eigenvalue of the interaction, and what every printed form has.

A block is kept as z = T x, x' = M x + G f with f = B c + b, where no inverse of a small number
is formed: in the basis W of `FieldSplit` N is diagonal, T = diag(N) on the directions kept and 1
on those dropped, and M = T^-1 (I + omega R P) A there. For R = I that is A itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.population.printed.split import DOUBTFUL, EPS, FieldSplit


@dataclass(frozen=True, eq=False, kw_only=True)
class ModeBlock:
    """One block of the modal split: z = T x, x' = M x + G f, x(0) = D z_isolated(0).

    Attributes
    ----------
    omega : float
        Eigenvalue of the interaction.
    M, T, T_inverse, G, D : (m, m)
    kept : bool array (m,)
        False on the directions of x where N is zero at the tolerance: as many exact zero poles,
        and M is zero in their columns.
    doubtful : array
        |N| of the directions kept that lie below 1e-7: not determined by the data.
    shared : bool
        M is A itself.
    smallest : float
        Smallest |N| kept.
    """

    omega: float
    M: np.ndarray
    T: np.ndarray
    T_inverse: np.ndarray
    G: np.ndarray
    D: np.ndarray
    kept: np.ndarray
    doubtful: np.ndarray
    shared: bool
    smallest: float

    @property
    def dropped(self) -> int:
        """Number of directions dropped."""
        return int(np.count_nonzero(~self.kept))

    @property
    def emergent(self) -> np.ndarray:
        """The block as printed, z' = (T M T^-1) z: entries grow as 1/(1 - lambda)."""
        return self.T @ self.M @ self.T_inverse


def eigenvalues_of_N(
    split: FieldSplit, omega: float, *, drop: bool = False
) -> tuple[np.ndarray, float]:
    """1 + omega lambda_i without cancellation at omega = -1, and the level that counts as zero.

    With `drop` the level is that of the doubtful directions.
    """
    N = (1.0 + omega) - omega * split.gap
    zero = split.tol**2
    if omega != -1.0:
        zero = max(zero, 2 * split.order * EPS * (1.0 + abs(omega)))
    return N, max(zero, DOUBTFUL) if drop else zero


def kept_directions(split: FieldSplit, omega: np.ndarray, *, drop: bool = False) -> np.ndarray:
    """(n, m): which directions of N are kept for each eigenvalue of the interaction (n,)."""
    masks = []
    for value in omega:
        N, zero = eigenvalues_of_N(split, float(value), drop=drop)
        masks.append(np.abs(N) > zero)
    return np.array(masks)


@dataclass(frozen=True, kw_only=True)
class PrintedForm:
    """Shared by the forms that need rows of V.

    Parameters
    ----------
    rows : "field", "forces" or sequence of int
        Which rows of V are the matrix: all of them (default), its forces alone, or these.
    rank_tol : float, optional
        Absolute tolerance on the singular values of V_alpha; default max(n_alpha, m) eps.
    """

    rows: str | Sequence[int] = "field"
    rank_tol: float | None = None
    name: ClassVar[str]

    def extra(self, m: int) -> np.ndarray | None:
        """R - I (m, m), None when R = I."""
        return None

    def inverted(self) -> bool:
        """Whether N^# stands on the right."""
        return True

    def check_rows(self, rows: np.ndarray) -> None:
        """Refuse matrix rows that do not go with the form's own maps."""

    def block(
        self, split: FieldSplit, A: np.ndarray, omega: float, *, rotate: bool, drop: bool = False
    ) -> ModeBlock:
        """The block of one eigenvalue of the interaction.

        Parameters
        ----------
        split : FieldSplit
        A : (m, m)
        omega : float
        rotate : bool
            Use the basis W for x; needed where a direction is dropped or R is not I.
        drop : bool
            Drop the doubtful directions as well: the other answer the data allow.
        """
        m = split.order
        extra = self.extra(m)
        N, zero = eigenvalues_of_N(split, omega, drop=drop)
        keep = np.abs(N) > zero
        if not self.inverted():
            X = np.eye(m) + omega * split.P
            if extra is not None:
                X = X + omega * extra @ split.P
            eye = np.eye(m)
            return ModeBlock(
                omega=omega,
                M=X @ A,
                T=eye,
                T_inverse=eye,
                G=X,
                D=eye,
                kept=keep | True,
                doubtful=np.zeros(0),
                shared=False,
                smallest=1.0,
            )
        doubtful = np.abs(N[keep & (np.abs(N) < DOUBTFUL)])
        smallest = float(np.abs(N[keep]).min(initial=1.0))
        if not rotate and keep.all() and extra is None:
            eye = np.eye(m)
            T = (split.W * N) @ split.W.T
            inverse = (split.W / N) @ split.W.T
            return ModeBlock(
                omega=omega,
                M=A,
                T=T,
                T_inverse=inverse,
                G=eye,
                D=eye,
                kept=keep,
                doubtful=doubtful,
                shared=True,
                smallest=smallest,
            )
        W, A_w = split.W, split.W.T @ A @ split.W
        # T^-1 (I + omega R P) row by row: I + omega N^-1 (R - I) P where kept, omega (R - I) P
        # where dropped.
        scale = np.where(keep, N, 1.0)
        X = np.diag(keep.astype(float))
        if extra is not None:
            X = X + omega * ((W.T @ extra @ W) * (1.0 - split.gap)) / scale[:, None]
        M = (X @ A_w) * keep
        shared = bool(keep.all()) and extra is None
        return ModeBlock(
            omega=omega,
            M=M,
            T=W * scale,
            T_inverse=W.T / scale[:, None],
            G=X @ W.T,
            D=keep[:, None] * W.T,
            kept=keep,
            doubtful=doubtful,
            shared=shared,
            smallest=smallest,
        )
