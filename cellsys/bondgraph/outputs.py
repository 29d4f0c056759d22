"""The outputs of all ports: what makes each of them, and its place in the vector y."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellsys.bondgraph.causality import EFFORT, FLOW, Causality
from cellsys.bondgraph.elements import BondElement, C, CField, I, Internal, NodalEffort, R, Se, Sf
from cellsys.bondgraph.junctions import BondPort, JunctionGraph, is_matrix
from cellsys.bondgraph.quantities import dimension_of, read, state_units
from cellsys.errors import CausalityError, DimensionError, ParameterError
from cellsys.system import Block, Layout


@dataclass(frozen=True, kw_only=True)
class Output:
    """One output of a port: its place in y, and what makes it.

    `kind` is ``source``, ``linear``, ``law``, ``memoryless``, ``dependent`` or ``rate``.
    `constant` (n,) are the factors of a linear element's output on its state or input; None where
    there are none.
    """

    index: int  # of the port, or -1 for the rate of an internal state
    name: str
    kind: str
    quantity: str
    place: slice
    shape: tuple[int, ...]
    constant: np.ndarray | None = None
    source: bool = False


def internal_of(graph: JunctionGraph, output: Output) -> Internal:
    """The element whose rate an output is."""
    element = graph.by_name[output.name]
    if not isinstance(element, Internal):
        raise CausalityError(f"{output.name!r} is no internal state")
    return element


def constants_of(output: Output) -> np.ndarray:
    """Factors (n,) of the output of a linear element."""
    if output.constant is None:
        raise CausalityError(f"{output.name!r} is not linear")
    return output.constant


def size_of(shape: tuple[int, ...]) -> int:
    """Number of entries of an array of this shape."""
    return int(np.prod(shape, dtype=int))


def constant_of(graph: JunctionGraph, port: BondPort, quantity: str) -> tuple[str, np.ndarray]:
    """(parameter name, values (n,)) of a linear R, C or I, in the graph's units; checked."""
    element, shape = port.element, graph.shapes[port.bond]
    names = {R: ("resistance", "conductance"), C: ("compliance", "stiffness"), I: ("inertance",)}
    name = next(n for n in names[type(element)] if getattr(element, n) is not None)
    label = f"{type(element).__name__} {element.name!r}: {name}"
    expected = dimension_of(name, graph.domains[port.bond])
    value = np.asarray(read(getattr(element, name), expected, graph.units, label))
    try:
        value = np.broadcast_to(value, shape).ravel() * 1.0
    except ValueError:
        raise DimensionError(f"{label} must fit shape {shape}, got {value.shape}") from None
    least = "" if isinstance(element, R) else " and not 0"
    if np.any(value < 0) or (least and np.any(value == 0)):
        raise ParameterError(f"{label} must be >= 0{least}, got {value.min()!r}")
    return name, value


def _factor(graph: JunctionGraph, port: BondPort, quantity: str, kind: str) -> np.ndarray:
    """Output of a linear element over its state (storage) or its input (others)."""
    name, value = constant_of(graph, port, quantity)
    if isinstance(port.element, R):
        direct = (name == "resistance") == (quantity == EFFORT)
    else:
        # integral: e = q/compliance or k q, f = p/inertance; derivative: the other way round
        direct = (name == "stiffness") == (kind == "linear")
    if direct:
        return value
    return np.divide(1.0, value)


def _kind(element: BondElement, kind: str, literal: bool) -> str:
    if kind == "source":
        return "source"
    if kind == "dependent":
        return "dependent"
    if kind == "two-port":
        return "memoryless" if is_matrix(element) else "law"
    linear = getattr(element, "law", None) is None and getattr(element, "inverse", None) is None
    if not linear or isinstance(element, (CField, NodalEffort)) or literal:
        return "law"
    return "memoryless" if isinstance(element, R) else "linear"


def input_sign(port: BondPort, quantity: str) -> int:
    """Sign of an element's input on its bond; see `elements`: f counts into C and R, e into I."""
    if isinstance(port.element, I):
        return port.sign if quantity == FLOW else 1
    if isinstance(port.element, (C, CField, R)):
        return port.sign if quantity == EFFORT else 1
    return 1


def output_sign(port: BondPort, quantity: str) -> int:
    """Sign of a resistor's or dependent storage's output on its bond."""
    if isinstance(port.element, (R, C)):
        return port.sign if quantity == FLOW else 1
    if isinstance(port.element, I):
        return port.sign if quantity == EFFORT else 1
    return 1


def outputs_of(graph: JunctionGraph, causality: Causality, literal: bool) -> tuple[Output, ...]:
    """Outputs of all ports in the order of the elements, then rates of internal states."""
    out: list[Output] = []
    start = 0
    for index, port in enumerate(graph.ports):
        if index not in causality.outputs:
            continue  # a side of a constant TF or GY: part of the junction structure
        quantity, chosen = causality.outputs[index]
        element, shape = port.element, graph.shapes[port.bond]
        kind = _kind(element, chosen, literal)
        constant = None
        if isinstance(element, (R, C, I)) and element.law is None:
            if getattr(element, "inverse", None) is None:
                constant = _factor(graph, port, quantity, "dependent" if chosen == "dependent"
                                   else "linear")  # fmt: skip
        stop = start + size_of(shape)
        name = port.name if kind == "source" else f"{port.name}.{quantity}"
        if isinstance(element, NodalEffort):
            name = port.name
        out.append(
            Output(
                index=index,
                name=name,
                kind=kind,
                quantity=quantity,
                place=slice(start, stop),
                shape=shape,
                constant=constant,
                source=isinstance(element, (Se, Sf)),
            )
        )
        start = stop
    for element in graph.elements:
        if isinstance(element, Internal):
            stop = start + element.block.size
            out.append(
                Output(
                    index=-1,
                    name=element.name,
                    kind="rate",
                    quantity=FLOW,
                    place=slice(start, stop),
                    shape=element.block.shape,
                )
            )
            start = stop
    return tuple(out)


def unit_of(graph: JunctionGraph, output: Output) -> str:
    """Unit of an output's effort or flow."""
    port = graph.ports[output.index]
    return state_units(graph.domains[port.bond], graph.units)[0 if output.quantity == EFFORT else 1]


def auxiliaries_of(graph: JunctionGraph, outputs: Sequence[Output]) -> Layout:
    """Blocks of outputs that are auxiliaries; the role of each is that of the array it acts on."""
    roles: dict[int, str] = {}
    for name, bonds in graph.junction_bonds.items():
        position = getattr(graph.by_name[name], "position", None)
        if isinstance(position, Block):
            roles |= {bond: position.role for bond, _ in bonds}
    return Layout([_auxiliary(graph, output, roles) for output in outputs])


def _auxiliary(graph: JunctionGraph, output: Output, roles: Mapping[int, str]) -> Block:
    if output.kind == "rate":
        block = internal_of(graph, output).block
        return Block(
            f"{block.name}.rate", block.shape, f"{block.unit}/s", role=block.role, kind="internal"
        )
    port = graph.ports[output.index]
    role = roles.get(port.bond, "component")
    return Block(output.name, output.shape, unit_of(graph, output), role=role, kind="rate")
