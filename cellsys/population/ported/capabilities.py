"""What fields, sensors and cells on a field may have besides what their contracts ask for."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np

from cellsys.contracts import MatrixField


@runtime_checkable
class ModalField(Protocol):
    """A matrix field with modes as coordinates, such as cs.GalerkinField(system)."""

    modes: Any


@runtime_checkable
class FibreField(Protocol):
    """A matrix field with fibres, such as cs.GalerkinField(system)."""

    matrix: Any


@runtime_checkable
class FieldReader(Protocol):
    """A sensor that reads the field all cells share, such as cs.FieldSensor()."""

    def directions(
        self, field: MatrixField, q: np.ndarray, places: np.ndarray, p: np.ndarray
    ) -> np.ndarray:
        """Directions (K, 3) sensed at places (K, 2), um, by cells of polarities p (K, 3)."""


@runtime_checkable
class NetworkReader(Protocol):
    """A sensor that reads the stiffness of a network at rest, such as a LocalSensor."""

    K_s: np.ndarray
    a: float
    map: Any

    def on(self, nodes: np.ndarray, stiffness: np.ndarray) -> NetworkReader:
        """The same sensor on another network."""


@runtime_checkable
class ChargedModel(Protocol):
    """A cell made of charges with a polar port, such as an EquivariantModel."""

    dynamics: Any
    representation: Any


@runtime_checkable
class PortedCell(Protocol):
    """A linear cell with a load port, such as cs.CellPort(A, F)."""

    A: np.ndarray
    F: np.ndarray
    C: np.ndarray
    n_loads: int

    def passivity(self) -> Any:
        """Passivity of the port."""
