"""Equivariant cells at their ports: the frozen linear cell, and where its loads touch the matrix.

In the coordinates in which a cell contracts, one block per real coordinate of a charge:

    x_q+ = A_q x_q + B_q u_q - gamma_q (I + A_q)/2 C_q^T y_q        f_q = C_q (x_q + x_q+)/2

so the metric is I/gamma_q where gamma_q > 0. Centroids integrate and are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as sla

from cellsys.cell.charged import ChargedModel
from cellsys.cell.port import PolarPort, PortSites
from cellsys.contracts import MatrixField
from cellsys.ports.capabilities import ModalField
from cellsys.ports.ports import CellPort
from cellsys.system import is_sparse


def frozen_port(model: ChargedModel, t: float | None = None) -> CellPort:
    """The cell frozen at time t (s since contact; default the end of training) as a `CellPort`.

    Parameters
    ----------
    model : EquivariantModel
    t : float, optional
    """
    dynamics = model.dynamics
    w = dynamics.clock.weights(model.horizon if t is None else float(t))
    A, F, C, P = [], [], [], []
    for q, block in enumerate(dynamics.blocks):
        Aq, _ = block.at(w)
        Cq = -0.5 * block.gamma * (np.eye(block.size) + Aq) @ block.C.T
        metric = np.eye(block.size) / (block.gamma if block.gamma > 0 else 1.0)
        for _ in range(1 if q == 0 else 2):
            A.append(Aq)
            F.append(block.C)
            C.append(Cq)
            P.append(metric)
    return CellPort(
        A=sla.block_diag(*A),
        F=sla.block_diag(*F),
        C=sla.block_diag(*C),
        metric=sla.block_diag(*P),
        dt=model.dt,
    )


@dataclass(frozen=True, eq=False)
class PolarGather:
    """E of a polar port on a field: real coordinates of every charge's load, charge by charge.

    Parameters
    ----------
    port : PolarPort
    sizes : tuple of int
        Load coefficients of each charge.
    field : GalerkinField or full field
        Whose nodes the port finds.
    """

    port: PolarPort
    sizes: tuple[int, ...]
    field: MatrixField

    @cached_property
    def sites(self) -> PortSites:
        """Nodes of the field that cells can load, with their areas."""
        return PortSites.of(self.field.nodes, self.field.surface)

    @property
    def n_loads(self) -> int:
        """Real load coordinates."""
        return sum(n * (1 if q == 0 else 2) for q, n in enumerate(self.sizes))

    def gather(self, field: MatrixField, position: np.ndarray, heading: float) -> np.ndarray:
        """E (n_loads, order) at a place; loads are charges about fixed axes, headings turn u."""
        footprint = self.sites.under(np.asarray(position)[:2], self.port)
        rows = (3 * footprint.nodes[:, None] + np.arange(3)).ravel()
        scattered = []
        for q, n in enumerate(self.sizes):
            for unit in (1.0,) if q == 0 else (1.0, 1j):
                for i in range(n):
                    load = {
                        k: np.zeros(size, complex if k else float)
                        for k, size in enumerate(self.sizes)
                    }
                    load[q][i] = unit
                    scattered.append(footprint.scatter(load).ravel())
        if not isinstance(field, ModalField):
            nodal = np.zeros((len(scattered), np.size(field.nodes)))
            nodal[:, rows] = scattered
            return np.asarray(field.project(nodal.reshape(len(scattered), -1, 3)))
        modes = field.modes[rows]
        return np.array(scattered) @ (modes.toarray() if is_sparse(modes) else modes)


def polar_gather(model: ChargedModel, field: MatrixField) -> PolarGather:
    """The port of an equivariant model on a field."""
    sizes = tuple(len(b.C) for b in model.dynamics.blocks)
    return PolarGather(model.representation.port, sizes, field)
