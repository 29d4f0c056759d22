"""The interaction split into its eigenvalues: one transform of the cell index serves all forms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellsys.population.graph import InteractionGraph


@dataclass(frozen=True, eq=False)
class Modes:
    """Eigenvalues of the interaction with multiplicities, and the transform of the cell index.

    Attributes
    ----------
    omega : (n,)
        Distinct blocks: (K - 1) w and -w when all cells meet alike, else every eigenvalue.
    multiplicity : int (n,)
    Q : (K, K) or None
        Orthonormal modes of a graph; None when all cells meet alike (mean and differences).
    """

    n_cells: int
    omega: np.ndarray
    multiplicity: np.ndarray
    graph: InteractionGraph | None = None

    @property
    def Q(self) -> np.ndarray | None:
        """Modes of the graph; None for mean and differences."""
        return None if self.graph is None else self.graph.modes[1]

    def assemble(self, blocks: np.ndarray) -> np.ndarray:
        """Dense (K a, K b) from the blocks (n, a, b): sum of q_j q_j^T (x) block_j."""
        K = self.n_cells
        n, a, b = blocks.shape
        if self.graph is None:
            rest = blocks[-1]
            mean = (blocks[0] - rest) / K if n > 1 else np.zeros((a, b))
            whole = np.broadcast_to(mean[None, :, None, :], (K, a, K, b)).copy()
            cells = np.arange(K)
            whole[cells, :, cells, :] += rest
            return whole.reshape(K * a, K * b)
        Q = self.graph.modes[1]
        right = np.einsum("lj,jab->jalb", Q, blocks).reshape(n, -1)
        return (Q @ right).reshape(K * a, K * b)

    def apply(self, blocks: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Each block (n, a, b) on its part of `values` (K, b), in cell coordinates: (K, a)."""
        if self.graph is None:
            if len(blocks) == 1:
                return values @ blocks[0].T
            mean = values.mean(axis=0)
            return (values - mean) @ blocks[1].T + blocks[0] @ mean
        Q = self.graph.modes[1]
        return Q @ np.einsum("jab,jb->ja", blocks, Q.T @ values)


def modes_of(n_cells: int, graph: InteractionGraph | None) -> Modes | InteractionGraph:
    """The split of a graph; the graph itself where it has none (not symmetric, or too large)."""
    if graph is None:
        return _alike(n_cells, 1.0)
    if graph.uniform is not None:
        return _alike(n_cells, graph.uniform)
    if not graph.splits:
        return graph
    return Modes(n_cells, graph.omega, np.ones(n_cells, dtype=np.int64), graph)


def _alike(n_cells: int, weight: float) -> Modes:
    """Mean and differences of cells that all meet with one weight."""
    if n_cells == 1:
        return Modes(1, np.zeros(1), np.ones(1, dtype=np.int64))
    return Modes(
        n_cells,
        np.array([(n_cells - 1) * weight, -weight]),
        np.array([1, n_cells - 1], dtype=np.int64),
    )
