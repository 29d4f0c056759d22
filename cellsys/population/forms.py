"""The printed ways to couple cells, split into blocks of the interaction's eigenvalues omega.

With N = I + omega P and R = I + P_map (or given), per eigenvalue omega of the interaction
(K - 1 once and -1 K-1 times when every cell meets every other):

    Superposition        N A N^#                 [36]
    MappedSuperposition  (I + omega R P) A N^#   [93]
    Feedback             (I + omega R P) A       [57]

A block is kept as z = T x, x' = M x + G f with f = B c + b, where no inverse of a small number
is formed: in the basis W of `FieldSplit` N is diagonal, T = diag(N) on the directions kept and 1
on those dropped, and M = T^-1 (I + omega R P) A there. For R = I that is A itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.population.maps import ForceMap
from cellsys.population.split import DOUBTFUL, EPS, FieldSplit
from cellsys.units import real_array


@dataclass(frozen=True, eq=False)
class Block:
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


def _map(value: Any, name: str, m: int) -> np.ndarray:
    array = real_array(getattr(value, "matrix", value), name)
    if array.shape != (m, m):
        raise DimensionError(f"{name} must be ({m}, {m}) like A, got {array.shape}")
    if not np.all(np.isfinite(array)):
        raise DataError(f"{name} holds NaN or inf")
    if np.abs(array).max(initial=0.0) > 1e100:
        raise DataError(f"{name} holds {np.abs(array).max():.3g}; it must stay below 1e100")
    return array


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
    ) -> Block:
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
            return Block(omega, X @ A, eye, eye, X, eye, keep | True, np.zeros(0), False, 1.0)
        doubtful = np.abs(N[keep & (np.abs(N) < DOUBTFUL)])
        smallest = float(np.abs(N[keep]).min(initial=1.0))
        if not rotate and keep.all() and extra is None:
            eye = np.eye(m)
            T = (split.W * N) @ split.W.T
            inverse = (split.W / N) @ split.W.T
            return Block(omega, A, T, inverse, eye, eye, keep, doubtful, True, smallest)
        W, A_w = split.W, split.W.T @ A @ split.W
        # T^-1 (I + omega R P) row by row: I + omega N^-1 (R - I) P where kept, omega (R - I) P
        # where dropped.
        scale = np.where(keep, N, 1.0)
        X = np.diag(keep.astype(float))
        if extra is not None:
            X = X + omega * ((W.T @ extra @ W) * (1.0 - split.gap)) / scale[:, None]
        M = (X @ A_w) * keep
        shared = bool(keep.all()) and extra is None
        return Block(
            omega,
            M,
            W * scale,
            W.T / scale[:, None],
            X @ W.T,
            keep[:, None] * W.T,
            keep,
            doubtful,
            shared,
            smallest,
        )


@checked
@dataclass(frozen=True, kw_only=True)
class Superposition(PrintedForm):
    """Superposed isolated fields: block N A N^# [thesis eq. 36].

    A similarity transform of isolated cells when I - P is nonsingular: K copies of the poles of
    A, for every K. It couples no dynamics: z_em(t) = N z(t) of isolated cells. With q purely
    matrix directions each difference block has q zero poles and those of a compression of A.
    """

    name = "Superposition"


@checked
@dataclass(frozen=True, kw_only=True)
class MappedSuperposition(PrintedForm):
    """Superposed isolated fields, answered by adhesion: block (I + omega R P) A N^# [eq. 93].

    Parameters
    ----------
    P_map : (m, m) or ForceMap
        R = I + P_map; see `fit_P_map`. Zero gives `Superposition`. A `ForceMap` goes with the
        rows it was fitted on, in [93] the matrix's forces: ``rows="forces"``.
    """

    P_map: np.ndarray | ForceMap
    name = "MappedSuperposition"

    def extra(self, m: int) -> np.ndarray | None:
        """P_map, or None when it is zero."""
        P_map = _map(self.P_map, "P_map", m)
        return P_map if np.any(P_map) else None

    def check_rows(self, rows: np.ndarray) -> None:
        """P and P_map are of the same rows.

        Raises
        ------
        ParameterError
        """
        if isinstance(self.P_map, ForceMap) and not np.array_equal(rows, self.P_map.rows):
            raise ParameterError(
                f"P_map was fitted on {len(self.P_map.rows)} rows of V and rows={self.rows!r} "
                f'couples on {len(rows)}; take the same, rows="forces" in [93]'
            )


@checked
@dataclass(frozen=True, kw_only=True)
class Feedback(PrintedForm):
    """Neighbours' matrix rates as inputs: z_k' = A z_k + sum of R P A z_l over l != k [eq. 57].

    Mean block (I + (K - 1) R P) A: its poles grow like K. Stable for every K when R = I and
    A + A^T < 0.

    Parameters
    ----------
    R : (m, m), optional
        Default I; [57] prints I + V^T W C (V^T W)^#, [91] I + P_map.
    """

    R: np.ndarray | ForceMap | None = None
    name = "Feedback"

    def extra(self, m: int) -> np.ndarray | None:
        """R - I, or None when R = I."""
        if self.R is None:
            return None
        extra = _map(self.R, "R", m) - np.eye(m)
        return extra if np.any(extra) else None

    def inverted(self) -> bool:
        """No inverse stands in [57]."""
        return False


Form = Annotated[PrintedForm, "Superposition(), MappedSuperposition(P_map=...) or Feedback()"]
