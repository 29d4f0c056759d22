"""`LoadPorts`: cells coupled by loads through one shared matrix field.

    field   C_e q' = -K q + sum_k E_k^T f_k          y_k = E_k q'
    cell k  z_k' = A z_k + b + B u_k + C y_k         f_k = F z_k

Superposing loads on one field is exact where it is linear; superposing isolated displacements is
not. Each cell has its own E_k, so distance, boundary and neighbours come in by themselves. If
every cell is passive at its port and the field is, no sum of them grows, for any K and any
placement: a certificate, not a simulation.
[notes: theory, load ports] [notes: theory, passivity]
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from cellsys.arguments import checked
from cellsys.errors import DimensionError, ParameterError, RepresentationError
from cellsys.loop import PolarityLaw
from cellsys.model import LatentModel, StiffnessSensor
from cellsys.population.ported.equivariant_cells import EquivariantCells
from cellsys.population.ported.field_sensor import FieldSensor, standing_on
from cellsys.population.ported.footprint import PatchPort
from cellsys.population.ported.linear_cells import PortedCells
from cellsys.population.ported.placement import Placement
from cellsys.population.ported.ports import CellPort


@checked
@dataclass(frozen=True, eq=False)
class LoadPorts(Placement):
    """Coupling of K cells by loads on one shared field.

    Parameters
    ----------
    field : GalerkinField, full field or LinearField
        Anything with order, drag, stiffness, nodes, surface, project.
    positions : (K, 2) or (K, 3)
        um.
    headings : (K,), optional
        rad; default 0.
    port : PatchPort or other, optional
        Gives E_k = gather(field, position, heading); default a patch of 8 um, in the plane. An
        equivariant model brings its own.
    allow_active : bool
        Compute with a port of passivity index below -1e-10 instead of refusing it.
    """

    def assemble_cells(
        self,
        model: LatentModel | CellPort,
        sizes: dict[str, int],
        *,
        controller: PolarityLaw | None = None,
        sensor: StiffnessSensor | FieldSensor | None = None,
        normalise: bool = True,
    ) -> Any:
        """Put cells at the ports; called by `couple`."""
        sizes = {**sizes, "LoadPorts.positions": len(self.positions)}
        if len(set(sizes.values())) > 1:
            raise DimensionError(f"numbers of cells differ: {sizes}")
        if hasattr(model, "dynamics"):
            return self._equivariant(model, controller, sensor, normalise)
        if not isinstance(model, CellPort):
            raise RepresentationError(
                f"LoadPorts needs a cell with a load port, and a {type(model).__name__} has none; "
                "use a CellPort or an Equivariant model"
            )
        here = replace(self, port=PatchPort()) if self.port is None else self
        if model.n_loads != here.port.n_loads:
            raise DimensionError(
                f"the cell has {model.n_loads} loads, its port on the matrix {here.port.n_loads}"
            )
        if sensor is not None:
            model = replace(model, sensor=sensor)
        cells = PortedCells(model, here, controller, normalise)
        here.check_port(cells.passivity)
        return cells

    def _equivariant(self, model: Any, controller: Any, sensor: Any, normalise: bool) -> Any:
        if self.port is not None:
            raise ParameterError("an equivariant model has its own port; leave port= out")
        sensor = standing_on(self.field, model.sensor if sensor is None else sensor)
        if controller is not None and sensor is None:
            raise ParameterError("a controller needs a sensor; the model has none, pass sensor=")
        cells = EquivariantCells(model, self, controller, sensor, normalise)
        self.check_port(cells.frozen().passivity)
        return cells
