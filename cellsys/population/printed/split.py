"""The rank decision: how much of each latent direction is cell, and how much matrix.

    I - P = V_alpha^T V_alpha,   V_alpha = U S W^T   ->   1 - lambda_i = sigma_i^2

The singular values of V_alpha resolve 1 - lambda down to about 1e-26, where eigenvalues of I - P
are noise below 1e-15. Everything is done in the basis W.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import ReducedModel
from cellsys.errors import ParameterError
from cellsys.population.printed.maps import other_rows
from cellsys.shown import Shown

EPS = float(np.finfo(float).eps)
DOUBTFUL = 1e-7  # below, data do not decide [notes: theory, rank decision]


@checked
@dataclass(frozen=True, eq=False)
class FieldSplit(Shown):
    """Latent directions ordered from all cell to all matrix.

    Attributes
    ----------
    W : (m, m)
        Orthonormal directions.
    gap : (m,)
        1 - lambda = sigma^2 of each, falling; 1 is all cell, 0 all matrix.
    tol : float
        Absolute tolerance on sigma: at or below it a direction is purely matrix.
    n_other : int
        Rows of V_alpha.
    """

    W: np.ndarray
    gap: np.ndarray
    tol: float
    n_other: int

    @property
    def order(self) -> int:
        """m."""
        return len(self.gap)

    @cached_property
    def P(self) -> np.ndarray:
        """P (m, m) in given coordinates."""
        return (self.W * (1.0 - self.gap)) @ self.W.T

    @property
    def purely_field(self) -> int:
        """q: directions with sigma at or below the tolerance."""
        return int(np.count_nonzero(np.sqrt(self.gap) <= self.tol))

    @property
    def doubtful(self) -> np.ndarray:
        """1 - lambda of the directions kept, but not determined by the data (below 1e-7)."""
        kept = np.sqrt(self.gap) > self.tol
        return self.gap[kept & (self.gap < DOUBTFUL)]

    @property
    def jump(self) -> float:
        """Ratio of the smallest kept 1 - lambda to the largest dropped one; inf without any."""
        q = self.purely_field
        if q == 0 or q == self.order:
            return float("inf")
        low = self.gap[self.order - q]
        return float(self.gap[self.order - q - 1] / low) if low > 0 else float("inf")

    def __str__(self) -> str:
        q = self.purely_field
        text = f"{self.order} directions, {q} purely matrix (sigma <= {self.tol:.1e}"
        if 0 < q < self.order:
            text += f", the next 1 - lambda is {self.jump:.1e} times larger"
        text += ")"
        doubtful = self.doubtful
        if doubtful.size:
            values = ", ".join(f"{v:.1e}" for v in doubtful[:6]) + (
                ", ..." if doubtful.size > 6 else ""
            )
            text += f"; {doubtful.size} not determined by the data (1 - lambda = {values})"
        return text


def field_split(model: ReducedModel, rows: np.ndarray, tol: float | None, what: str) -> FieldSplit:
    """Singular value decomposition of V_alpha with the rank decision.

    Parameters
    ----------
    model : LatentModel
    rows : int array
        Matrix rows of V.
    tol : float, optional
        Absolute, on sigma in [0, 1]; default max(n_alpha, m) eps.
    what : str
        Named when the model has no V.
    """
    V_alpha = other_rows(model, rows, what)
    n, m = V_alpha.shape
    if tol is None:
        tol = max(n, m) * EPS
    if not (np.isfinite(tol) and 0 <= tol < 1):
        raise ParameterError(f"rank_tol is an absolute tolerance in [0, 1), got {tol!r}")
    small = sla.qr(V_alpha, mode="r", check_finite=False)[0][:m] if n > m else V_alpha
    _, s, Wt = sla.svd(small, full_matrices=True)
    sigma = np.zeros(m)
    sigma[: len(s)] = np.minimum(s, 1.0)  # V is orthonormal: more than 1 is rounding
    return FieldSplit(Wt.T, sigma**2, float(tol), n)
