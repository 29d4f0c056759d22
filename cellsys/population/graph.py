"""Who meets whom: weights between cells, and which route they allow."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, MemoryBudgetError, ParameterError
from cellsys.kinds import Takes
from cellsys.store.memory import size_text
from cellsys.system import Matrix, is_sparse
from cellsys.units import real_array

_DENSE_BYTES = 4e9


@checked
@dataclass(frozen=True, eq=False)
class InteractionGraph:
    """Weights w_kl >= 0 or < 0 with which cell k receives the field of cell l; w_kk = 0.

    Parameters
    ----------
    weights : (K, K) array or sparse
        The same weights in every factor of the coupled equations.

    Raises
    ------
    DimensionError, DataError
        Not square, NaN, or a diagonal that is not zero.
    """

    weights: Annotated[np.ndarray | sp.csr_array, Takes(Matrix)]

    def __post_init__(self) -> None:
        given = self.weights
        w: np.ndarray | sp.csr_array = (
            sp.csr_array(given).astype(float)
            if is_sparse(given)
            else real_array(given, "graph").copy()
        )
        if w.ndim != 2 or w.shape[0] != w.shape[1] or w.shape[0] == 0:
            raise DimensionError(f"weights must be (K, K), got {w.shape}")
        if not np.all(np.isfinite(w if isinstance(w, np.ndarray) else w.data)):
            raise DataError("weights hold NaN or inf")
        if np.any(w.diagonal() != 0):
            raise DataError("weights must be 0 on the diagonal: a cell is not its own neighbour")
        object.__setattr__(self, "weights", w)

    @classmethod
    def attenuated(
        cls, positions: np.ndarray, length: float, *, cutoff: float | None = None
    ) -> InteractionGraph:
        """Weights exp(-r/length) of the distances r between cells, um.

        Parameters
        ----------
        positions : (K, 2) or (K, 3)
            um.
        length : float
            Attenuation length of the matrix, um; `attenuation_length` measures it.
        cutoff : float, optional
            Pairs farther apart than this get weight 0, um, and the weights are sparse.
        """
        x = check_positions(positions)
        if not (np.isfinite(length) and length > 0):
            raise ParameterError(f"length must be > 0 um, got {length!r}")
        if cutoff is None:
            _afford(len(x))
            r = np.sqrt(((x[:, None] - x[None]) ** 2).sum(axis=2))
            w = np.exp(-r / length)
            np.fill_diagonal(w, 0.0)
            return cls(w)
        if not cutoff > 0:
            raise ParameterError(f"cutoff must be > 0 um, got {cutoff!r}")
        from scipy.spatial import cKDTree

        pairs = cKDTree(x).query_pairs(cutoff, output_type="ndarray")
        i, j = pairs.reshape(-1, 2).T
        value = np.exp(-np.linalg.norm(x[i] - x[j], axis=1) / length)
        w = sp.coo_array((value, (i, j)), shape=(len(x), len(x)))
        return cls(sp.csr_array(w + w.T))

    @property
    def n_cells(self) -> int:
        """K."""
        return self.weights.shape[0]

    @cached_property
    def uniform(self) -> float | None:
        """The one weight when every cell meets every other alike, exactly; else None."""
        K = self.n_cells
        w = self.weights
        if K == 1:
            return 0.0
        if is_sparse(w):
            if w.count_nonzero() != K * (K - 1):
                return None
            values = w.data[w.data != 0]
        else:
            values = w[~np.eye(K, dtype=bool)]
        return float(values[0]) if np.all(values == values[0]) else None

    @cached_property
    def symmetric(self) -> bool:
        """Symmetric to rounding (4 eps of the greatest weight); the lower half then counts."""
        w = self.weights
        if isinstance(w, np.ndarray):
            off, size = np.abs(w - w.T).max(), np.abs(w).max()
        else:
            off, size = abs(w - w.T).max(), abs(w).max()
        return bool(off <= 4 * np.finfo(float).eps * size)

    @property
    def splits(self) -> bool:
        """Symmetric, and small enough for its eigenvalue problem."""
        return self.symmetric and 8.0 * self.n_cells**2 <= _DENSE_BYTES

    def dense(self) -> np.ndarray:
        """The weights as an array (K, K), where memory holds it."""
        _afford(self.n_cells)
        w = self.weights
        return w if isinstance(w, np.ndarray) else w.toarray()

    @cached_property
    def modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Eigenvalues omega (K,) and orthonormal modes Q (K, K) of symmetric weights."""
        return sla.eigh(self.dense())

    @cached_property
    def omega(self) -> np.ndarray:
        """Eigenvalues (K,) of symmetric weights, without the modes."""
        return self.modes[0] if "modes" in self.__dict__ else sla.eigvalsh(self.dense())

    def receive(self, values: np.ndarray) -> np.ndarray:
        """Sum over neighbours: w @ values, (K, .)."""
        return self.weights @ values


def check_positions(positions: object) -> np.ndarray:
    """Positions as finite floats (K, 2) or (K, 3), um."""
    x = np.atleast_2d(real_array(positions, "positions"))
    if x.ndim != 2 or x.shape[1] not in (2, 3):
        raise DimensionError(f"positions must be (K, 2) or (K, 3) in um, got {x.shape}")
    if not np.all(np.isfinite(x)):
        raise DataError("positions hold NaN or inf")
    return x


def _afford(K: int) -> None:
    if 8.0 * K * K > _DENSE_BYTES:
        raise MemoryBudgetError(
            f"dense weights of {K} cells need {size_text(8.0 * K * K)}; use all-to-all coupling "
            "(any number of cells), or weights with a cutoff, which are sparse (matrix-free route)"
        )
