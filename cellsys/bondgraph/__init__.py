"""Bond graphs: elements and junctions by name -> (W_x, W_eta, eta(x), u) and an `OdeSystem`."""

from cellsys.bondgraph.elements import (
    GY,
    TF,
    BondElement,
    C,
    CField,
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
from cellsys.renamed import old_names

__getattr__ = old_names(__name__)

__all__ = [
    "GY",
    "TF",
    "Bond",
    "BondElement",
    "BondGraph",
    "C",
    "CField",
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
