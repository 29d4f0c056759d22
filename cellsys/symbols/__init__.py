"""CasADi forms of loops, of K cells and of cells on a reduced field, by name."""

from cellsys.symbols.build import symbolic

__all__ = ["symbolic"]
