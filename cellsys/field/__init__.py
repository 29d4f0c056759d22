"""The matrix as its own system: Galerkin field on load-response modes, and the full one."""

from cellsys.field.galerkin import GalerkinField
from cellsys.field.implicit import FullField, full_field
from cellsys.field.ports import FieldPassivity

__all__ = ["FieldPassivity", "FullField", "GalerkinField", "full_field"]
