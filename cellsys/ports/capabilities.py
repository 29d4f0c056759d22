"""What fields and sensors may have besides what their contracts ask for."""

from __future__ import annotations

from typing import Protocol, TypeGuard, runtime_checkable

import numpy as np
import scipy.sparse as sp

from cellsys.contracts import MatrixField, SteppedField
from cellsys.field.elasticity import MatrixEnergy
from cellsys.kinds import kind_of
from cellsys.model.stiffness_map import StiffnessMap


@runtime_checkable
class ModalField(Protocol):
    """A matrix field with modes as coordinates, such as cs.GalerkinField(system)."""

    @property
    def modes(self) -> np.ndarray | sp.csc_array:
        """U (3 n, order)."""


@runtime_checkable
class FibreField(Protocol):
    """A matrix field with fibres, such as cs.GalerkinField(system)."""

    @property
    def matrix(self) -> MatrixEnergy:
        """The fibres, and what they store."""


@runtime_checkable
class FieldReader(Protocol):
    """A sensor that reads the field all cells share, such as cs.FieldSensor()."""

    def directions(
        self, field: MatrixField, q: np.ndarray, places: np.ndarray, p: np.ndarray
    ) -> np.ndarray:
        """Directions (K, 3) sensed at places (K, 2), um, by cells of polarities p (K, 3)."""


@runtime_checkable
class StateReader(Protocol):
    """A sensor that reads a cell's own latent state, such as a StiffnessSensor."""

    def raw(self, z: np.ndarray) -> np.ndarray:
        """Sensed vectors (..., 3) of latent states (..., m)."""

    def direction(self, z: np.ndarray) -> np.ndarray:
        """The same, of unit length."""


@runtime_checkable
class NetworkReader(StateReader, Protocol):
    """A sensor that reads the stiffness of a network at rest, such as a LocalSensor."""

    @property
    def K_s(self) -> np.ndarray:
        """Gains on its moments."""

    @property
    def a(self) -> float:
        """Gain on its stiffness under the cell."""

    @property
    def map(self) -> StiffnessMap:
        """The network."""

    def on(self, nodes: np.ndarray, stiffness: np.ndarray) -> NetworkReader:
        """The same sensor on another network."""


CellSensor = StateReader | FieldReader


def steps_itself(field: MatrixField) -> TypeGuard[SteppedField]:
    """Whether a field is a `SteppedField`; asked by name, so that nothing is computed."""
    return kind_of(SteppedField).fault(field) is None
