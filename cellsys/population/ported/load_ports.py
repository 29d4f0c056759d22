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

import numpy as np  # noqa: F401 (annotates the inherited __init__)

from cellsys.arguments import checked
from cellsys.cell.charged import ChargedModel
from cellsys.contracts import LoadPort as LoadPort  # what the inherited __init__ is annotated with
from cellsys.contracts import MatrixField as MatrixField
from cellsys.errors import DimensionError, ParameterError, RepresentationError
from cellsys.field.field import GradientField
from cellsys.kinds import Filled as Filled
from cellsys.population.ported.equivariant_cells import EquivariantCells
from cellsys.population.ported.linear_cells import PortedCells
from cellsys.population.ported.placement import Placement
from cellsys.population.request import CouplingRequest
from cellsys.ports.capabilities import CellSensor
from cellsys.ports.field_sensor import standing_on
from cellsys.ports.footprint import PatchPort
from cellsys.ports.ports import CellPort


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
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

    def join(self, request: CouplingRequest) -> PortedCells | EquivariantCells:
        """K cells with their ports at the positions.

        Raises
        ------
        RepresentationError
            When the cell has no load port.
        ParameterError, DimensionError
            When the port is active, has other loads than the cell, or a graph, positions or
            headings are given besides.
        """
        more = sorted(set(request.sizes) - {"n_cells"})
        if more:
            raise ParameterError(
                f"LoadPorts has its own positions and headings and knows no graph; leave "
                f"{', '.join(more)} out"
            )
        if isinstance(self.field, GradientField) and not self.field.matrix.disc.flat:
            raise RepresentationError(
                "LoadPorts hands loads to a field, and those of close cells in a gel whose "
                "fibres buckle run away: a gel that yields takes nothing off them "
                "(analysis/gel_compaction.py, two cells 20 um apart); a cs.RadialCell follows it"
            )
        request.count({"LoadPorts.positions": len(self.positions)})
        model = request.model
        if isinstance(model, ChargedModel):
            return self._equivariant(request, model)
        if not isinstance(model, CellPort):
            raise RepresentationError(
                f"LoadPorts needs a cell with a load port, and a {type(model).__name__} has none; "
                "use a CellPort or an Equivariant model"
            )
        port = PatchPort() if self.port is None else self.port
        if model.n_loads != port.n_loads:
            raise DimensionError(
                f"the cell has {model.n_loads} loads, its port on the matrix {port.n_loads}"
            )
        here = replace(self, port=port) if self.port is None else self
        sensor = request.own_sensor()
        if sensor is not None:
            model = replace(model, sensor=sensor)
        cells = PortedCells(model, here, request.controller, request.normalise)
        here.check_port(cells.passivity)
        return cells

    def _equivariant(self, request: CouplingRequest, model: ChargedModel) -> EquivariantCells:
        controller = request.controller
        if self.port is not None:
            raise ParameterError("an equivariant model has its own port; leave port= out")
        own: CellSensor | None = model.sensor
        sensor = standing_on(self.field, own if request.sensor is None else request.sensor)
        if controller is not None and sensor is None:
            raise ParameterError("a controller needs a sensor; the model has none, pass sensor=")
        cells = EquivariantCells(
            model=model,
            coupling=self,
            controller=controller,
            sensor=sensor,
            normalise=request.normalise,
        )
        self.check_port(cells.frozen().passivity)
        return cells
