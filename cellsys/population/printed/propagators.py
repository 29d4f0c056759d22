"""Exact steps of the linear part of coupled cells, kept for each step length.

    x' = M x + G (B c + b),  z = T x + offset          over h with c held

mode by mode of the cell index. The state is kept in modal coordinates: the mean and the
differences when all cells meet alike, the graph's modes else.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from cellsys.errors import RepresentationError
from cellsys.model.latent import with_basis
from cellsys.population.printed.printed_cells import PrintedCells


class Propagators:
    """Linear flow of `CoupledCells` for given commands."""

    def __init__(self, cells: PrintedCells) -> None:
        _, B, b = cells.matrices
        blocks, modes = cells.blocks(), cells.modes
        self.Q = None if modes is None else modes.Q  # (K, K) of a graph
        self.K, self.m = cells.n_cells, cells.order
        self.M = np.array([block.M for block in blocks])
        self.T = np.array([block.T for block in blocks])
        self.D = np.array([block.D for block in blocks])
        self.drive = np.array([block.G @ np.column_stack([B, b]) for block in blocks])
        self.n_inputs = B.shape[1]
        # Superposition of cells that share no purely matrix direction: one flow for all.
        self.same_flow = len(blocks) == 2 and all(
            np.array_equal(a[0], a[1]) for a in (self.M, self.drive)
        )
        self._kept: dict[float, np.ndarray] = {}

    def to_modes(self, values: np.ndarray) -> np.ndarray:
        """Cell index (K, .) to modal index; differences stay in cell coordinates."""
        return values if self.Q is None else self.Q.T @ values

    def to_cells(self, values: np.ndarray) -> np.ndarray:
        """Modal index back to the cells."""
        return values if self.Q is None else self.Q @ values

    def act(self, blocks: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Each block on its mode: (n, a, b) on (K, b) in modal coordinates."""
        if self.Q is not None:
            return (blocks @ values[:, :, None])[:, :, 0]
        out = values @ blocks[-1].T
        if len(blocks) == 2:
            out += (blocks[0] - blocks[1]) @ values.mean(axis=0)
        return out

    def step_matrices(self, h: float) -> np.ndarray:
        """[exp(M h), integral of exp(M s) ds G [B, b]] (n, m, m + n_c + 1), kept for reuse."""
        if h not in self._kept:
            n, m, k = self.drive.shape
            whole = np.zeros((n, m + k, m + k))
            whole[:, :m, :m], whole[:, :m, m:] = h * self.M, h * self.drive
            if self.same_flow:
                whole = whole[:1]
            with np.errstate(over="ignore", invalid="ignore"):
                step = sla.expm(whole)
            if len(self._kept) > 60:
                self._kept.clear()
            self._kept[h] = np.ascontiguousarray(step[:, :m])
        return self._kept[h]

    def flow(self, x: np.ndarray, c: np.ndarray, h: float) -> np.ndarray:
        """x after h with the commands c (K, n_c) held; x in modal coordinates."""
        drive = np.column_stack([c, np.ones(len(c))])
        return self.act(self.step_matrices(h), np.column_stack([x, self.to_modes(drive)]))


class EmergentFlow(Propagators):
    """Propagators with the read-outs of emergent states and of the sensor."""

    def __init__(self, cells: PrintedCells) -> None:
        super().__init__(cells)
        self.offset = rest_offset(cells)
        if cells.loop is not None:
            S = cells.loop.sensor.S_d
            self.reader = S @ self.T
            self.shift = self.offset @ S.T

    def start(self, z: np.ndarray) -> np.ndarray:
        """Modal x of isolated latent states (K, m)."""
        return self.act(self.D, self.to_modes(z))

    def emergent(self, x: np.ndarray) -> np.ndarray:
        """z (K, m)."""
        return self.to_cells(self.act(self.T, x)) + self.offset

    def sense(self, x: np.ndarray) -> np.ndarray:
        """S_d z (K, 3)."""
        return self.to_cells(self.act(self.reader, x)) + self.shift


def rest_offset(cells: PrintedCells) -> np.ndarray:
    """(K, m): what neighbours add to z besides P z_l when z = 0 is not rest.

    With a centred basis each neighbour adds its mean field, V_phi^T S^-1 mean(phi); zero for
    `Feedback`, which couples rates [notes: theory, superposition].
    """
    model, K = cells.model, cells.n_cells
    if not cells.coupling.inverted() or K == 1:
        return np.zeros((K, cells.order))
    rows = cells.field
    _, V = with_basis(model, cells.coupling.name)
    if model.scale is None or model.mean is None:
        raise RepresentationError(
            f"{cells.coupling.name} needs the centre and scale of V's rows, and this model has none"
        )
    scale = model.scale[rows]
    mean = np.divide(model.mean[rows], scale, out=np.zeros(len(rows)), where=scale > 0)
    step = V[rows].T @ mean
    if cells.graph is None:
        return np.tile((K - 1) * step, (K, 1))
    return np.outer(cells.graph.receive(np.ones(K)), step)
