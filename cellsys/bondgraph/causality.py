"""Causality: which of effort and flow each element gives to its bond.

Every junction, TF and GY is a set of linear relations between all bond variables. A port's
output is chosen by exact elimination, in the order sources, integral storage, resistors. The
junction relations conserve power, so the choice never gets stuck (independent sets of a
delta-matroid extend). A source that is rejected is a conflict; a rejected storage is dependent.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from cellsys.bondgraph.elements import (
    GY,
    TF,
    BondElement,
    C,
    CField,
    I,
    NodalEffort,
    One,
    R,
    Se,
    Sf,
    Value,
    Zero,
)
from cellsys.bondgraph.elimination import Number, SolutionSet, rational
from cellsys.bondgraph.junctions import BondPort, JunctionGraph, is_matrix, is_modulated
from cellsys.bondgraph.quantities import dimension_of, read
from cellsys.errors import CausalityError, ParameterError

EFFORT, FLOW = "e", "f"
_OTHER = {EFFORT: FLOW, FLOW: EFFORT}


@dataclass(frozen=True)
class Causality:
    """Outputs of all ports and the junction structure behind them.

    Attributes
    ----------
    outputs : dict
        (port index, "e" or "f") in the order in which they were chosen -> kind: ``source``,
        ``storage``, ``dependent``, ``resistor`` or ``two-port``.
    solution : SolutionSet
        Every bond variable as a combination of these outputs; variable 2 b is the effort of
        bond b, 2 b + 1 its flow.
    """

    outputs: dict[int, tuple[str, str]]
    solution: SolutionSet

    def effort_from_tail(self, graph: JunctionGraph) -> dict[str, bool]:
        """For each bond, whether its tail imposes the effort (the causal stroke is at the head)."""
        return _strokes(graph, self)


def variable(bond: int, quantity: str) -> int:
    """Index of a bond's effort or flow."""
    return 2 * bond + (quantity == FLOW)


def ratio_of(graph: JunctionGraph, element: TF | GY) -> float:
    """A constant scalar ratio of a TF or GY, as a float in the graph's units."""
    inner, outer = graph.two_port_sides(element)
    kind = type(element).__name__
    near, far = graph.domains[inner.bond], graph.domains[outer.bond]
    expected = dimension_of(kind, near, far) if far is not None else None
    value = read(element.ratio, expected, graph.units, f"{kind} {element.name!r} ratio")
    if isinstance(value, np.ndarray) or value == 0.0:
        raise ParameterError(f"{kind} {element.name!r}: ratio must be a number other than 0")
    return value


def relations(graph: JunctionGraph, *, generic: bool) -> Iterable[dict[int, Number]]:
    """Rows of the junction structure: coefficients of bond variables that sum to zero.

    `generic` includes modulated and matrix two-ports with arbitrary distinct ratios; without it
    they are left out, and count as elements.
    """
    for element in graph.elements:
        if isinstance(element, (Zero, One)):
            bonds = graph.junction_bonds[element.name]
            common, summed = (EFFORT, FLOW) if isinstance(element, Zero) else (FLOW, EFFORT)
            first = variable(bonds[0][0], common)
            for bond, _ in bonds[1:]:
                yield {first: 1, variable(bond, common): -1}
            yield {variable(bond, summed): sign for bond, sign in bonds}
    primes = _primes()
    for element in graph.elements:
        if not isinstance(element, (TF, GY)):
            continue
        if is_modulated(element) or is_matrix(element):
            ratio: Number = Fraction(next(primes), next(primes))
            if not generic:
                continue
        else:
            ratio = rational(ratio_of(graph, element))
        inner, outer = graph.two_port_sides(element)
        # TF: e_in = n e_out, f_out = n f_in.  GY: e_in = r f_out, e_out = r f_in.
        near, far = (EFFORT, FLOW) if isinstance(element, TF) else (FLOW, EFFORT)
        yield {variable(inner.bond, EFFORT): 1, variable(outer.bond, near): -ratio}
        yield {variable(outer.bond, far): 1, variable(inner.bond, FLOW): -ratio}


def _primes() -> Iterator[int]:
    known: list[int] = []
    k = 101
    while True:
        if all(k % p for p in known if p * p <= k) and all(k % p for p in (2, 3, 5, 7)):
            known.append(k)
            yield k
        k += 2


def assign(graph: JunctionGraph) -> Causality:
    """Choose the output of every port; see the module's text.

    Raises
    ------
    CausalityError
        Conflicting sources, dependent storage that cannot be dependent, an impossible resistor,
        or a bond variable that nothing determines.
    """
    solution = _structure(graph, generic=True)
    outputs: dict[int, tuple[str, str]] = {}
    owner: dict[int, BondPort] = {}

    def names(variables: Iterable[int]) -> str:
        return ", ".join(repr(owner[v].name) for v in variables if v in owner)

    def take(index: int, quantity: str, kind: str) -> bool:
        port = graph.ports[index]
        v = variable(port.bond, quantity)
        if not solution.fix(v):
            return False
        outputs[index] = (quantity, kind)
        owner[v] = port
        return True

    for index, port in enumerate(graph.ports):
        if isinstance(port.element, (Se, Sf)):
            quantity = EFFORT if isinstance(port.element, Se) else FLOW
            if not take(index, quantity, "source"):
                others = names(solution.reason(variable(port.bond, quantity)))
                raise CausalityError(
                    f"source {port.name!r} conflicts with {others or 'the junctions'}: they impose "
                    f"the same {_word(quantity)}; put a resistor or a storage between them"
                )
    for index, port in sorted(enumerate(graph.ports), key=lambda p: _rank(p[1].element)):
        element = port.element
        if not isinstance(element, (C, I, CField, NodalEffort)):
            continue
        quantity = FLOW if isinstance(element, I) else EFFORT
        if take(index, quantity, "storage"):
            continue
        others = names(solution.reason(variable(port.bond, quantity)))
        if not _linear(element):
            raise CausalityError(
                f"storage {port.name!r} is nonlinear and dependent: its {_word(quantity)} is "
                f"already imposed by {others}. Its equations would be M(x) dx/dt = ..., not "
                "dx/dt = W_eta eta; make its law linear, or put a resistor between"
            )
        if not take(index, _OTHER[quantity], "dependent"):
            raise CausalityError(f"storage {port.name!r} fits no causality beside {others}")
    for index, port in sorted(enumerate(graph.ports), key=lambda p: _choices(p[1].element)):
        if not isinstance(port.element, R):
            continue
        wanted = _resistor_outputs(port.element)
        if not any(take(index, quantity, "resistor") for quantity in wanted):
            v = variable(port.bond, wanted[0])
            raise CausalityError(
                f"resistor {port.name!r} must give its {_word(_OTHER[wanted[0]])}, because "
                f"{names(solution.reason(v))} impose its {_word(wanted[0])}: give the law the "
                f"other way round ({'law=' if wanted[0] == FLOW else 'inverse='})"
            )
    _refuse_loose(graph, solution)
    special = [e for e in graph.elements if is_modulated(e) or is_matrix(e)]
    if special:
        solution = _open_two_ports(graph, special, outputs)
    return Causality(outputs, solution)


def _structure(graph: JunctionGraph, *, generic: bool) -> SolutionSet:
    solution = SolutionSet(2 * len(graph.joined))
    for row in relations(graph, generic=generic):
        solution.relate(row)
    return solution


def _refuse_loose(graph: JunctionGraph, solution: SolutionSet) -> None:
    loose = solution.free()
    if loose:
        listed = ", ".join(
            f"{_word('ef'[v % 2])} of {graph.joined[v // 2].name!r}" for v in loose[:4]
        )
        raise CausalityError(
            f"nothing determines the {listed}: junctions form a loop without an element; "
            "merge the junctions or put an element on one of the bonds"
        )


def _open_two_ports(
    graph: JunctionGraph, special: list[TF | GY], outputs: dict[int, tuple[str, str]]
) -> SolutionSet:
    """The junction structure with modulated and matrix two-ports taken out as elements."""
    solution = _structure(graph, generic=False)
    for index, (quantity, _) in outputs.items():
        solution.fix(variable(graph.ports[index].bond, quantity))
    place = {p.name: i for i, p in enumerate(graph.ports)}
    for element in special:
        inner, outer = graph.two_port_sides(element)
        if isinstance(element, TF):
            # f_out = M f_in, e_in = M^T e_out first: it never divides.
            options = [(EFFORT, FLOW), (FLOW, EFFORT)]
        else:
            options = [(EFFORT, EFFORT), (FLOW, FLOW)]
        if is_matrix(element):
            options = options[:1]
        for first, second in options:
            a, b = variable(inner.bond, first), variable(outer.bond, second)
            if not _both(solution, a, b):
                continue
            outputs[place[inner.name]] = (first, "two-port")
            outputs[place[outer.name]] = (second, "two-port")
            break
        else:
            raise CausalityError(
                f"{type(element).__name__} {element.name!r} with a "
                f"{'matrix' if is_matrix(element) else 'modulated'} ratio fits no causality; "
                "swap its sides or put a storage or resistor on the other side"
            )
    _refuse_loose(graph, solution)
    return solution


def _both(solution: SolutionSet, a: int, b: int) -> bool:
    """Fix a and b, or neither."""
    if not solution.fix(a):
        return False
    if solution.fix(b):
        return True
    solution.release(a)
    return False


def _rank(element: BondElement) -> int:
    """Nonlinear storage first, so that a linear one becomes the dependent one."""
    return 0 if not _linear(element) else 1


def _choices(element: BondElement) -> int:
    return len(_resistor_outputs(element)) if isinstance(element, R) else 0


def _linear(element: BondElement) -> bool:
    return isinstance(element, (C, I)) and element.law is None


def _resistor_outputs(element: R) -> tuple[str, ...]:
    if element.law is not None and element.inverse is None:
        return (EFFORT,)
    if element.inverse is not None and element.law is None:
        return (FLOW,)
    if element.resistance is not None and _has_zero(element.resistance):
        return (EFFORT,)
    if element.conductance is not None and _has_zero(element.conductance):
        return (FLOW,)
    return (FLOW, EFFORT) if element.conductance is not None else (EFFORT, FLOW)


def _has_zero(value: Value) -> bool:
    """Whether a parameter is 0 somewhere; a quantity in words is not looked at."""
    return not isinstance(value, str) and bool(np.any(np.asarray(value) == 0))


def _word(quantity: str) -> str:
    return "effort" if quantity == EFFORT else "flow"


def _strokes(graph: JunctionGraph, causality: Causality) -> dict[str, bool]:
    """Propagate the outputs of the ports over the bonds and through the junctions."""
    tail: dict[int, bool] = {}
    for index, (quantity, _) in causality.outputs.items():
        port = graph.ports[index]
        gives_effort = quantity == EFFORT
        tail[port.bond] = gives_effort == (port.sign < 0)
    changed = True
    while changed and len(tail) < len(graph.joined):
        changed = False
        for name, bonds in graph.junction_bonds.items():
            strong = EFFORT if isinstance(graph.by_name[name], Zero) else FLOW
            open_bonds = [(b, s) for b, s in bonds if b not in tail]
            if not open_bonds:
                continue
            # The one bond that imposes the common variable on the junction.
            setters = [
                b for b, s in bonds if b in tail and ((tail[b] == (s > 0)) == (strong == EFFORT))
            ]
            if setters:
                for b, s in open_bonds:
                    tail[b] = (s < 0) == (strong == EFFORT)
                    changed = True
            elif len(open_bonds) == 1:
                b, s = open_bonds[0]
                tail[b] = (s > 0) == (strong == EFFORT)
                changed = True
        for element in graph.elements:
            if isinstance(element, (TF, GY)):
                inner, outer = graph.two_port_sides(element)
                for a, b in ((inner.bond, outer.bond), (outer.bond, inner.bond)):
                    if a in tail and b not in tail:
                        # TF passes the stroke on, GY turns it round.
                        tail[b] = tail[a] if isinstance(element, TF) else not tail[a]
                        changed = True
    return {bond.name: tail.get(i, True) for i, bond in enumerate(graph.joined)}
