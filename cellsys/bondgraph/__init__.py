"""Bond graphs: elements and junctions by name -> (W_x, W_eta, eta(x), u) and an `OdeSystem`."""

from cellsys.bondgraph.elements import (
    GY,
    TF,
    C,
    CField,
    Element,
    I,
    Internal,
    NodalEffort,
    One,
    R,
    Se,
    Sf,
    Zero,
)
from cellsys.bondgraph.equations import Equations
from cellsys.bondgraph.graph import BondGraph
from cellsys.bondgraph.junctions import Bond, JunctionGraph

__all__ = [
    "GY",
    "TF",
    "Bond",
    "BondGraph",
    "C",
    "CField",
    "Element",
    "Equations",
    "I",
    "Internal",
    "JunctionGraph",
    "NodalEffort",
    "One",
    "R",
    "Se",
    "Sf",
    "Zero",
]
