from cellsys.cell.forecast import ErrorBands, Forecast, ValidityMonitor
from cellsys.cell.model import EquivariantModel
from cellsys.cell.on_field import CellsOnField
from cellsys.cell.on_matrix import with_matrix
from cellsys.cell.port import PolarPort
from cellsys.cell.radial import RadialCell
from cellsys.cell.reductor import Equivariant
from cellsys.cell.schedule import Clock
from cellsys.cell.worth import realisation_floor

__all__ = [
    "CellsOnField",
    "Clock",
    "Equivariant",
    "EquivariantModel",
    "ErrorBands",
    "Forecast",
    "PolarPort",
    "RadialCell",
    "ValidityMonitor",
    "realisation_floor",
    "with_matrix",
]
