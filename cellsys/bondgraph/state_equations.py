"""`StateEquations`: what the equations of a bond graph consist of; `Equations` evaluates them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from cellsys.arguments import checked
from cellsys.bondgraph.junctions import JunctionGraph
from cellsys.bondgraph.laws import Laws
from cellsys.bondgraph.structure import Structure
from cellsys.system import Layout


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class StateEquations:
    """Layouts, matrices and laws of the state equations of a bond graph [thesis eq. 5],

        dx/dt = W_x x + W_eta eta(t, x) + W_s s(t)

    Attributes are those of `Equations`.
    """

    graph: JunctionGraph
    structure: Structure
    laws: Laws
    W_x: sp.csr_array
    W_eta: sp.csr_array
    W_s: sp.csr_array
    literal: bool

    @property
    def states(self) -> Layout:
        """Names of x."""
        return self.structure.states

    @property
    def auxiliaries(self) -> Layout:
        """Names of eta."""
        return self.structure.auxiliaries

    @property
    def inputs(self) -> Layout:
        """Names of the sources."""
        return self.structure.inputs

    @property
    def x0(self) -> np.ndarray:
        """Initial state (n,)."""
        return self.structure.x0

    @cached_property
    def causality(self) -> dict[str, str]:
        """For every bond, the end that imposes the effort."""
        strokes = self.structure.causality.effort_from_tail(self.graph)
        return {name: "tail" if tail else "head" for name, tail in strokes.items()}

    @property
    def dependent(self) -> tuple[str, ...]:
        """Linear storages in derivative causality."""
        ports = self.graph.ports
        return tuple(ports[o.index].name for o in self.structure.outputs if o.kind == "dependent")

    @property
    def loops(self) -> tuple[tuple[str, ...], ...]:
        """Algebraic loops among nonlinear resistors."""
        return self.laws.loops
