"""What `couple` asks of a coupling, and what a coupling is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cellsys.contracts import Cells, LinearModel
from cellsys.errors import DimensionError, ParameterError
from cellsys.loop import PolarityLaw
from cellsys.model import StiffnessSensor
from cellsys.population.graph import InteractionGraph
from cellsys.ports.capabilities import CellSensor
from cellsys.ports.ports import CellPort


@dataclass(frozen=True, kw_only=True, eq=False)
class CouplingRequest:
    """K cells to be coupled; see `couple`.

    Attributes
    ----------
    model : reduced model or cell with a port
    sizes : mapping of str to int
        Every argument that says K, and the K it says; empty where none was given.
    graph, positions, headings, controller, sensor, normalise
        As given; None where left out.
    """

    model: LinearModel | CellPort
    sizes: Mapping[str, int]
    graph: InteractionGraph | None = None
    positions: np.ndarray | None = None
    headings: np.ndarray | None = None
    controller: PolarityLaw | None = None
    sensor: CellSensor | None = None
    normalise: bool = True

    def count(self, own: Mapping[str, int] | None = None) -> int:
        """K, once all that say it agree; `own` is what the coupling itself says.

        Raises
        ------
        ParameterError, DimensionError
            When nothing says it, or two numbers differ.
        """
        sizes = {**self.sizes, **(own or {})}
        if not sizes:
            raise ParameterError(
                "couple needs n_cells=, or a graph, positions or headings of K cells"
            )
        if len(set(sizes.values())) > 1:
            raise DimensionError(f"numbers of cells differ: {sizes}")
        return next(iter(sizes.values()))

    def own_sensor(self) -> StiffnessSensor | None:
        """The sensor of cells that share no field.

        Raises
        ------
        ParameterError
            For one that reads a field.
        """
        if self.sensor is None or isinstance(self.sensor, StiffnessSensor):
            return self.sensor
        raise ParameterError(
            f"a {type(self.sensor).__name__} reads a field that the cells share, and these share "
            "none; give a StiffnessSensor, or an equivariant model on LoadPorts"
        )


class Coupling(Protocol):
    """A coupling such as cs.Superposition(), cs.Feedback() or cs.LoadPorts(field, positions)."""

    @property
    def name(self) -> str:
        """What messages call it."""

    def join(self, request: CouplingRequest) -> Cells:
        """The coupled cells, or a refusal of what this coupling cannot take."""
