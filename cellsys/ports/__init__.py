"""Where a cell meets a shared matrix: its port, its footprint on a field, what it senses there."""

from cellsys.ports.field_sensor import FieldSensor
from cellsys.ports.footprint import LinearField, PatchPort
from cellsys.ports.ports import CellPort, PortPassivity

__all__ = ["CellPort", "FieldSensor", "LinearField", "PatchPort", "PortPassivity"]
