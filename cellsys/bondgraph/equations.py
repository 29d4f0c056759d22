"""`Equations`: what a bond graph becomes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from cellsys.arguments import checked, unchecked
from cellsys.bondgraph.causality import assign
from cellsys.bondgraph.elements import C, CField, I, R, Se, Sf, Start
from cellsys.bondgraph.energy import dissipation, stored_energy
from cellsys.bondgraph.expressions import Numbers, Symbol, Vector, apply, shaped
from cellsys.bondgraph.junctions import JunctionGraph
from cellsys.bondgraph.laws import Laws
from cellsys.bondgraph.linearization import linearize
from cellsys.bondgraph.state_equations import StateEquations
from cellsys.bondgraph.structure import (
    Structure as Structure,  # what the inherited __init__ is annotated with
)
from cellsys.bondgraph.structure import build
from cellsys.bondgraph.writing import latex, text
from cellsys.shown import Shown
from cellsys.system import OdeSystem

if TYPE_CHECKING:
    import control


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Equations(StateEquations, Shown):
    """State equations of a bond graph [thesis eq. 5],

        dx/dt = W_x x + W_eta eta(t, x) + W_s s(t)

    Attributes
    ----------
    graph : JunctionGraph
    states, auxiliaries, inputs : Layout
        x: displacement ``name.q`` of each C, momentum ``name.p`` of each I, positions of
        junctions, internal states, in the order of the elements. eta: effort ``name.e`` or flow
        ``name.f`` of each nonlinear law. s: the sources.
    W_x, W_eta, W_s : sparse arrays (n, n), (n, n_eta), (n, n_inputs)
        Constant; from the junction structure and the linear constants.
    x0 : array (n,)
    causality : dict
        Bond name -> ``"tail"`` or ``"head"``: the end that imposes the effort. The causal stroke
        is drawn at the other end.
    dependent : tuple of str
        Linear storages in derivative causality, eliminated.
    loops : tuple of tuples of str
        Algebraic loops among nonlinear resistors, solved at each evaluation.
    """

    @unchecked
    def eta(self, t: float | Symbol, x: Vector) -> Vector:
        """Auxiliaries (n_eta,) at (t, x); accepts CasADi symbols where the laws do."""
        return self.laws.eta(t, x, self.laws.sources(t))

    @unchecked
    def u(self, t: float | Symbol, x: Vector) -> Vector:
        """Exogenous rate W_s s(t), (n,)."""
        return apply(self.W_s, self.laws.sources(t))

    @cached_property
    def system(self) -> OdeSystem:
        """The equations as an `OdeSystem`."""
        return OdeSystem(
            states=self.states,
            x0=self.x0,
            auxiliaries=self.auxiliaries,
            inputs=self.inputs,
            W_x=self.W_x,
            W_eta=self.W_eta,
            law=self.eta if self.auxiliaries.size else None,
            forcing=self.u if self.inputs.size else None,
        )

    def bonds(self, t: float, x: np.ndarray) -> dict[str, tuple[Numbers, Numbers]]:
        """(effort, flow) of every bond at (t, x), in the bond's shape."""
        s = self.laws.sources(t)
        S = self.structure
        y = S.Y_x @ x + S.Y_eta @ self.laws.eta(t, x, s) + S.Y_s @ s
        e, f = S.effort @ y, S.flow @ y
        return {
            bond.name: (shaped(e[place], shape), shaped(f[place], shape))
            for bond, place, shape in zip(
                self.graph.joined, S.bond_place, self.graph.shapes, strict=True
            )
        }

    def port_power(self, t: float, x: np.ndarray) -> dict[str, float]:
        """Power sum(e f) into every element port, in the graph's units."""
        values = list(self.bonds(t, x).values())
        return {
            p.name: p.sign * float(np.sum(values[p.bond][0] * values[p.bond][1]))
            for p in self.graph.ports
        }

    def power(self, t: float, x: np.ndarray) -> dict[str, float]:
        """``storage`` (dH/dt), ``dissipation`` and ``sources`` (into the graph): they balance."""
        total = {"storage": 0.0, "dissipation": 0.0, "sources": 0.0}
        into = self.port_power(t, x)
        for port in self.graph.ports:
            if isinstance(port.element, (C, I, CField)):
                total["storage"] += into[port.name]
            elif isinstance(port.element, R):
                total["dissipation"] += into[port.name]
            elif isinstance(port.element, (Se, Sf)):
                total["sources"] -= into[port.name]
        return total

    def energy(self, t: float, x: np.ndarray) -> dict[str, float]:
        """Stored energy of every C, I and CField; see `stored_energy`."""
        return stored_energy(self.structure, self.bonds(t, x), x)

    def dissipation(self, t: float, x: np.ndarray) -> dict[str, float]:
        """Power lost in every resistor, >= 0 where its law is passive."""
        return dissipation(self.graph, self.port_power(t, x))

    def linearize(
        self,
        x0: np.ndarray | Mapping[str, Start] | None = None,
        *,
        t: float = 0.0,
        outputs: Sequence[str] | None = None,
    ) -> control.StateSpace:
        """Linear `control.StateSpace` (dt = 0) about (t, x0); see `linearize` in this room."""
        return linearize(self, x0, t=t, outputs=outputs)

    def latex(self) -> str:
        """The equations in LaTeX, one ``aligned`` block."""
        return latex(self)

    def __str__(self) -> str:
        return text(self)


def derive(graph: JunctionGraph, *, literal: bool = False) -> Equations:
    """Causality, elimination and assembly; see `BondGraph.equations`."""
    structure = build(graph, assign(graph), literal=literal)
    W_x, W_eta, W_s = (
        sp.csr_array(structure.rate @ Y) for Y in (structure.Y_x, structure.Y_eta, structure.Y_s)
    )
    for W in (W_x, W_eta, W_s):
        W.sum_duplicates()
        W.eliminate_zeros()
    return Equations(
        graph=graph,
        structure=structure,
        laws=Laws(structure),
        W_x=W_x,
        W_eta=W_eta,
        W_s=W_s,
        literal=literal,
    )
