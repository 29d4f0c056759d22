"""`BondGraph`: a graph of elements and junctions that writes its own state equations."""

from __future__ import annotations

from collections.abc import Sequence as Sequence  # what the inherited __init__ is annotated with
from dataclasses import dataclass
from typing import ClassVar

from cellsys.arguments import checked
from cellsys.bondgraph.elements import (
    BondElement as BondElement,  # what the inherited __init__ is annotated with
)
from cellsys.bondgraph.equations import Equations, derive
from cellsys.bondgraph.junctions import JunctionGraph
from cellsys.drawable import Drawable


@checked
@dataclass(frozen=True, eq=False)
class BondGraph(JunctionGraph, Drawable):
    """A bond graph, and from it the state equations (thesis Table 1, eq. 2-5).

    Parameters
    ----------
    elements : sequence of BondElement
        R, C, I, Se, Sf, TF, GY, CField, ... and junctions Zero and One, each with its own name.
    bonds : sequence of str
        ``"supply -> circuit -> motor -> shaft"``: each arrow is a bond along which power is
        counted positive. An arrow into a TF or GY is its input side, one out of it its output
        side. ``"junction -> field.end"`` reaches one end of a multiport.
    units : {"cell", "si"}
        um, pN, s or coherent SI with electric units.
    separate : bool
        Allow parts that no bond connects; refused by default.
    name : str
        Title of prints and drawings.

    Raises
    ------
    ParameterError
        A name that is unknown or given twice, a bond between junctions of different shape.
    CausalityError
        A port left open, or a graph in several parts.
    """

    _figure: ClassVar[str] = "bond_graph"

    def equations(self, *, literal: bool = False) -> Equations:
        """State equations dx/dt = W_x x + W_eta eta(x) + u.

        Parameters
        ----------
        literal : bool
            Put linear laws into eta too, as thesis eq. 39 does; W_x is then zero.

        Raises
        ------
        CausalityError
            Conflicting sources, dependent nonlinear storage, an algebraic loop that cannot be
            solved, or a variable that nothing determines; the message names the elements.
        """
        return derive(self, literal=literal)

    def __str__(self) -> str:
        return str(self.equations())
