"""`ChargedModel`: what forecasts, fields and populations ask of a cell made of charges."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

from cellsys.cell.dynamics import CellDynamics
from cellsys.cell.representation import CellRepresentation, ChargeModes
from cellsys.contracts import LinearModel


@runtime_checkable
class ChargedModel(LinearModel, Protocol):
    """A cell made of charges with a polar port, such as an EquivariantModel."""

    @property
    def dynamics(self) -> CellDynamics:
        """Blocks of the charges, clock and read-outs of the centroid."""

    @property
    def representation(self) -> CellRepresentation:
        """Shape and load as charges."""

    @property
    def modes(self) -> ChargeModes:
        """Latent states of the charges."""

    @property
    def horizon(self) -> float:
        """Length of the training runs, s."""

    @property
    def dt(self) -> float:
        """Step, s."""

    def nodes(self, z: np.ndarray) -> np.ndarray:
        """Node positions (n, 3) or (T, n, 3), um."""

    def reconstruct_load(self, z: np.ndarray) -> dict[int, np.ndarray]:
        """Charges of the load density, pN/um."""

    def encode_cell(
        self, nodes: np.ndarray, loads: list[dict[int, np.ndarray]] | None
    ) -> np.ndarray:
        """z (T, m + 2) from node positions (T, n, 3) and load charges."""
