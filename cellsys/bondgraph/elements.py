"""Elements and junctions of a bond graph.

Power on a bond is effort x flow. Relations (thesis Table 1; f is the flow *into* the element):

    Zero   one effort, flows sum to 0         One    one flow, efforts sum to 0
    R      e = law(f)                         Se, Sf  effort or flow given as a function of time
    C      dq/dt = f,  e = law(q)             I      dp/dt = e,  f = law(p)
    TF     e_in = n e_out,  f_out = n f_in    GY     e_in = r f_out,  e_out = r f_in

A law takes and returns an array of the junction's shape (a number on a scalar bond), and must
accept CasADi symbols where the system is to be symbolic. Parameters are numbers in the graph's
units, quantities such as ``"2 N/m"``, or arrays of the junction's shape.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np
import scipy.sparse as sp

from cellsys.arguments import checked, needs
from cellsys.bondgraph.expressions import Expression, States
from cellsys.errors import ParameterError
from cellsys.kinds import FILLED, Filled
from cellsys.system import Block

Law = Callable[[Expression], Expression]
StateLaw = Callable[[Expression, States], Expression]  # of time and states
Ratio = Callable[[States], Expression]
Value = Annotated[
    float | str | np.ndarray, "a number, a quantity such as '2 N/m' or an array of numbers"
]
Start = Annotated[float | np.ndarray, "a number or an array of numbers"]


@checked
@dataclass(frozen=True, eq=False)
class BondElement:
    """Anything with a name that bonds can end on."""

    name: str
    ports: ClassVar[tuple[str, ...]] = ("",)

    def __post_init__(self) -> None:
        if not self.name or "->" in self.name or self.name != self.name.strip():
            raise ParameterError(f"an element's name must be a plain word, got {self.name!r}")


def _one_of(name: str, **given: object) -> None:
    present = [k for k, v in given.items() if v is not None]
    if len(present) != 1:
        raise ParameterError(
            f"{name} needs exactly one of {', '.join(given)}, got {', '.join(present) or 'none'}"
        )


@checked
@dataclass(frozen=True, eq=False)
class Zero(BondElement):
    """0-junction: common effort, flows sum to zero (Kirchhoff's current law).

    Parameters
    ----------
    shape : tuple of int
        ``()`` for scalar bonds, (n, 3) for an array of n nodes.
    domain : {"translation", "rotation", "electric", "hydraulic"}, optional
        Checks the units of the elements on it and names those of their states.
    """

    shape: tuple[int, ...] = ()
    domain: str | None = None


@checked
@dataclass(frozen=True, eq=False)
class One(BondElement):
    """1-junction: common flow, efforts sum to zero (Kirchhoff's voltage law).

    Parameters
    ----------
    shape, domain
        As for `Zero`.
    position : str or Block, optional
        Name of a state dx/dt = f that integrates the junction's flow: a sensor without power.
    x0 : float or array
        Its initial value.
    """

    shape: tuple[int, ...] = ()
    domain: str | None = None
    position: str | Block | None = None
    x0: Start = 0.0


@checked
@dataclass(frozen=True, eq=False)
class Se(BondElement):
    """Source of effort: a number, a quantity or a function of time; its name is an input.

    The value is the effort of its bond, whatever the bond's direction.
    """

    value: Value | Law = 0.0


@checked
@dataclass(frozen=True, eq=False)
class Sf(BondElement):
    """Source of flow: a number, a quantity or a function of time; its name is an input."""

    value: Value | Law = 0.0


@checked
@dataclass(frozen=True, eq=False)
class R(BondElement):
    """Resistor e = resistance x f (damper, drag), or e = law(f).

    Parameters
    ----------
    resistance, conductance : float, str or array, >= 0
        Linear law, either way round; conductance 0 is a clamp.
    law, inverse : callable
        e = law(f), f = inverse(e); one suffices when the causality asks for that one.
    monotone : bool
        Promise that the law increases: needed to solve algebraic loops through it.
    """

    resistance: Value | None = None
    conductance: Value | None = field(default=None, kw_only=True)
    law: Law | None = field(default=None, kw_only=True)
    inverse: Law | None = field(default=None, kw_only=True)
    monotone: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        _one_of(
            f"R {self.name!r}",
            resistance=self.resistance,
            conductance=self.conductance,
            law=self.law or self.inverse,
        )


@checked
@dataclass(frozen=True, eq=False)
class C(BondElement):
    """Storage of displacement dq/dt = f (spring, capacitor, tank): e = q/compliance or law(q).

    Parameters
    ----------
    compliance, stiffness : float, str or array, > 0
        Linear law, either way round.
    law : callable
        e = law(q).
    energy : callable, optional
        H(q) >= 0 with dH/dq = law; without it H is integrated numerically.
    q0 : float or array
        Initial displacement.
    """

    compliance: Value | None = None
    stiffness: Value | None = field(default=None, kw_only=True)
    law: Law | None = field(default=None, kw_only=True)
    energy: Law | None = field(default=None, kw_only=True)
    q0: Start = field(default=0.0, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        _one_of(
            f"C {self.name!r}",
            compliance=self.compliance,
            stiffness=self.stiffness,
            law=self.law,
        )


@checked
@dataclass(frozen=True, eq=False)
class I(BondElement):  # noqa: E742 - the field's own name for an inertia
    """Storage of momentum dp/dt = e (mass, inductor): f = p/inertance or law(p).

    Parameters
    ----------
    inertance : float, str or array, > 0
        Linear law.
    law, energy : callable
        f = law(p) and H(p), as for `C`.
    p0 : float or array
        Initial momentum.
    """

    inertance: Value | None = None
    law: Law | None = field(default=None, kw_only=True)
    energy: Law | None = field(default=None, kw_only=True)
    p0: Start = field(default=0.0, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        _one_of(f"I {self.name!r}", inertance=self.inertance, law=self.law)


@checked
@dataclass(frozen=True, eq=False)
class CField(BondElement):
    """Storage with several ports: dq_i/dt = f_i, (e_1, e_2, ...) = law(q_1, q_2, ...).

    Parameters
    ----------
    ends : tuple of str
        Port names; a bond ends on ``"name.end"``.
    law : callable
        Takes one argument per port, returns as many efforts; dH/dq_i when it conserves energy.
    energy : callable
        H(q_1, q_2, ...).
    q0 : mapping, optional
        Initial displacement of each port, default 0.
    """

    ends: tuple[str, ...] = ()
    law: Filled[Callable[..., Sequence[Expression]]] = FILLED
    energy: Callable[..., Expression] | None = None
    q0: Mapping[str, Start] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.ends or len(set(self.ends)) != len(self.ends) or self.law is None:
            raise ParameterError(f"CField {self.name!r} needs named ends and a law")
        unknown = set(self.q0) - set(self.ends)
        if unknown:
            raise ParameterError(f"CField {self.name!r} has no end {sorted(unknown)[0]!r}")


@checked
@dataclass(frozen=True, eq=False)
class NodalEffort(BondElement):
    """Port of a vector element on a junction array: an effort that is a block of eta.

    Thousands of springs may stand behind it; their geometry lives in the element, and what it
    takes from one array it gives to the other through a second `NodalEffort`. The block of
    W_eta behind it is constant.

    Parameters
    ----------
    law : callable, optional
        ``law(t, s)`` -> effort, with s a mapping from state names to arrays. Left out, the graph
        gives W_eta only, and whoever owns the law evaluates eta.
    """

    law: StateLaw | None = None


@checked
@dataclass(frozen=True, eq=False)
class Internal(BondElement):
    """State inside an element (bond strength, stretch) whose rate is a block of eta.

    Parameters
    ----------
    block : Block
        Name, shape and unit of the state; the auxiliary is called ``name + ".rate"``.
    rate : callable, optional
        ``rate(t, s)``, as in `NodalEffort`.
    x0 : array
        Initial value.
    """

    block: Filled[Block] = FILLED  # to be given: the name before it has no default
    rate: StateLaw | None = None
    x0: Start = 0.0
    ports: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        needs(self.block, Block, f"block of Internal {self.name!r}")


@checked
@dataclass(frozen=True, eq=False)
class TF(BondElement):
    """Transformer (lever, gear, piston): e_in = ratio e_out, f_out = ratio f_in.

    Parameters
    ----------
    ratio : float, str, (n_out, n_in) array or sparse, or callable
        A number; a constant matrix M between junctions of different shape (f_out = M f_in,
        e_in = M^T e_out); or ``ratio(s)`` of the states: modulated, then both outputs are
        auxiliaries and W_eta stays constant.
    """

    ratio: Value | sp.sparray | sp.spmatrix | Ratio | None = None


@checked
@dataclass(frozen=True, eq=False)
class GY(BondElement):
    """Gyrator (motor, pump): e_in = ratio f_out, e_out = ratio f_in.

    Parameters
    ----------
    ratio : float, str or callable
        As for `TF`, without the matrix.
    """

    ratio: Value | Ratio | None = None


JUNCTIONS = (Zero, One)
TWO_PORTS = (TF, GY)
