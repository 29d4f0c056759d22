"""`CellsAtPorts`: what runs ask of linear cells on one field."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from cellsys.contracts import Cells
from cellsys.loop import PolarityLaw
from cellsys.population.poleset import PoleSet
from cellsys.population.ported.placement import Placement
from cellsys.ports.ports import CellPort


class CellsAtPorts(Cells, Protocol):
    """Linear cells such as `PortedCells`, whose attributes these are."""

    @property
    def model(self) -> CellPort:
        """One cell."""

    @property
    def coupling(self) -> Placement:
        """Field, positions and headings."""

    @property
    def controller(self) -> PolarityLaw | None:
        """Of every cell."""

    @property
    def normalise(self) -> bool:
        """Whether the sensed direction is scaled to unit length."""

    @property
    def whole(self) -> tuple[np.ndarray, np.ndarray]:
        """(M, G) of x' (or x+) = M x + G g."""

    @property
    def gathers(self) -> np.ndarray:
        """E_k of every cell, (K, n_f, order)."""

    @property
    def given_loads(self) -> np.ndarray:
        """L (n, order): loads on the field's coordinates in x' (or x+)."""

    def pole_set(self) -> PoleSet:
        """Poles of cells and field with multiplicities, 1/s."""
