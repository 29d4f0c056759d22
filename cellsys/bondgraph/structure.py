"""From the junction structure to W_x, W_eta and the maps behind every bond variable.

All outputs y of the ports are split into linear storage (K x), auxiliaries eta, sources s, and
memoryless linear or dependent ones w, which are eliminated:

    y = P_x x + P_eta eta + P_s s + P_w w ,    w = G y  ->  y = Y_x x + Y_eta eta + Y_s s
    dx/dt = rate y                             W_x = rate Y_x, W_eta = rate Y_eta, ...

A dependent storage has u_d = S_d y with only linear storage behind it, so its output is
constant x d(u_d)/dt = constant x S_d P_x rate y: linear in y again.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from cellsys.bondgraph.causality import EFFORT, FLOW, Causality, variable
from cellsys.bondgraph.elements import TF, C, CField, I, Internal, One, Se, Sf, Start
from cellsys.bondgraph.junctions import JunctionGraph, is_matrix, matrix_of
from cellsys.bondgraph.outputs import (
    Output,
    auxiliaries_of,
    constants_of,
    input_sign,
    output_sign,
    outputs_of,
    size_of,
    unit_of,
)
from cellsys.bondgraph.quantities import state_units
from cellsys.errors import CausalityError, DimensionError, ParameterError
from cellsys.system import Block, Layout


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Everything about a graph that does not depend on the state."""

    graph: JunctionGraph
    causality: Causality
    outputs: tuple[Output, ...]
    states: Layout
    auxiliaries: Layout
    inputs: Layout
    x0: np.ndarray
    state_of: dict[str, str]  # storage port or junction -> state
    inner: dict[str, sp.csr_array]  # port -> its input as a combination of y
    rate: sp.csr_array  # dx/dt as a combination of y
    Y_x: sp.csr_array
    Y_eta: sp.csr_array
    Y_s: sp.csr_array
    effort: sp.csr_array  # all bond efforts as a combination of y
    flow: sp.csr_array
    bond_place: tuple[slice, ...]


def build(graph: JunctionGraph, causality: Causality, *, literal: bool) -> Structure:
    """Assemble all matrices; O(entries) apart from one sparse solve where R-R loops are linear."""
    outputs = outputs_of(graph, causality, literal)
    width = sum(size_of(o.shape) for o in outputs)
    bond_place = _places([size_of(s) for s in graph.shapes])
    effort, flow = _bond_maps(graph, causality, outputs, bond_place, width)
    inner = {}
    for output in outputs:
        if output.index >= 0:
            port = graph.ports[output.index]
            source = flow if output.quantity == EFFORT else effort
            inner[port.name] = source[bond_place[port.bond]] * input_sign(port, output.quantity)
    states, x0, rate, state_of = _states(graph, outputs, inner, flow, bond_place, width)
    eta_outputs = [o for o in outputs if o.kind in ("law", "rate")]
    auxiliaries = auxiliaries_of(graph, eta_outputs)
    sources = [o for o in outputs if o.kind == "source"]
    inputs = Layout([Block(o.name, o.shape, unit_of(graph, o), role="controller") for o in sources])

    eye = sp.eye_array(width, format="csc")
    P_eta = _select(eye, [o.place for o in eta_outputs])
    P_s = _select(eye, [o.place for o in sources])
    hidden = [o for o in outputs if o.kind in ("memoryless", "dependent")]
    P_w = _select(eye, [o.place for o in hidden])
    P_x = _storage(graph, outputs, states, state_of, width, ("linear",))
    # With `literal` the outputs of linear storage are auxiliaries, but still K x.
    K = _storage(graph, outputs, states, state_of, width, ("linear", "law"))
    Y: list[sp.csr_array | sp.csc_array] = [P_x, P_eta, P_s]
    if hidden:
        G = sp.csr_array(
            sp.vstack([_hidden_row(graph, o, outputs, inner, K, rate) for o in hidden])
        )
        w = _eliminate(sp.csc_array(G @ P_w), sp.hstack([G @ P for P in Y]), hidden)
        edges = np.cumsum([0] + [P.shape[1] for P in Y])
        Y = [P + P_w @ w[:, a:b] for P, a, b in zip(Y, edges[:-1], edges[1:], strict=True)]
    Y_x, Y_eta, Y_s = (_clean(P) for P in Y)
    return Structure(
        graph=graph,
        causality=causality,
        outputs=outputs,
        states=states,
        auxiliaries=auxiliaries,
        inputs=inputs,
        x0=x0,
        state_of=state_of,
        inner=inner,
        rate=rate,
        Y_x=Y_x,
        Y_eta=Y_eta,
        Y_s=Y_s,
        effort=effort,
        flow=flow,
        bond_place=bond_place,
    )


def _places(sizes: list[int]) -> tuple[slice, ...]:
    edges = np.cumsum([0, *sizes])
    return tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(edges))


def _bond_maps(
    graph: JunctionGraph,
    causality: Causality,
    outputs: tuple[Output, ...],
    bond_place: tuple[slice, ...],
    width: int,
) -> tuple[sp.csr_array, sp.csr_array]:
    """All efforts and all flows as combinations of y: each coefficient times an identity."""
    place = {
        variable(graph.ports[o.index].bond, o.quantity): o.place for o in outputs if o.index >= 0
    }
    height = bond_place[-1].stop if bond_place else 0
    maps = []
    for quantity in (EFFORT, FLOW):
        rows: list[np.ndarray] = []
        cols: list[np.ndarray] = []
        data: list[np.ndarray] = []
        for bond, where in enumerate(bond_place):
            n = where.stop - where.start
            for v, c in causality.solution.row(variable(bond, quantity)).items():
                rows.append(np.arange(where.start, where.stop))
                cols.append(np.arange(place[v].start, place[v].stop))
                data.append(np.full(n, float(c)))
        none = np.zeros(0, int)
        maps.append(
            sp.csr_array(
                (
                    np.concatenate([np.zeros(0), *data]),
                    (np.concatenate([none, *rows]), np.concatenate([none, *cols])),
                ),
                (height, width),
            )
        )
    return maps[0], maps[1]


def _states(
    graph: JunctionGraph,
    outputs: tuple[Output, ...],
    inner: dict[str, sp.csr_array],
    flow: sp.csr_array,
    bond_place: tuple[slice, ...],
    width: int,
) -> tuple[Layout, np.ndarray, sp.csr_array, dict[str, str]]:
    """States in the order of the elements: storage, positions of junctions, internal ones."""
    by_port = {graph.ports[o.index].name: o for o in outputs if o.index >= 0}
    by_rate = {o.name: o for o in outputs if o.kind == "rate"}
    blocks: list[Block] = []
    start: list[np.ndarray] = []
    rates: list[sp.csr_array] = []
    state_of: dict[str, str] = {}

    def add(owner: str, block: Block, value: Start, row: sp.csr_array) -> None:
        try:
            start.append(np.broadcast_to(np.asarray(value, float), block.shape).ravel())
        except ValueError:
            raise DimensionError(
                f"initial value of {block.name!r} must fit shape {block.shape}, "
                f"got {np.shape(value)}"
            ) from None
        blocks.append(block)
        rates.append(row)
        state_of[owner] = block.name

    for element in graph.elements:
        if isinstance(element, One) and element.position is not None:
            bond = graph.junction_bonds[element.name][0][0]
            unit = state_units(element.domain, graph.units)[2]
            block = element.position
            if isinstance(block, str):
                block = Block(block, tuple(element.shape), unit)
            if block.shape != tuple(element.shape):
                raise DimensionError(
                    f"position {block.name!r} of junction {element.name!r} must have shape "
                    f"{element.shape}, got {block.shape}"
                )
            add(element.name, block, element.x0, flow[bond_place[bond]])
        elif isinstance(element, Internal):
            rows = sp.eye_array(width, format="csr")[by_rate[element.name].place]
            add(element.name, element.block, element.x0, rows)
        elif isinstance(element, (C, I, CField)):
            for port in (p for p in graph.ports if p.element is element):
                output = by_port[port.name]
                if output.kind == "dependent":
                    continue
                units = state_units(graph.domains[port.bond], graph.units)
                momentum = isinstance(element, I)
                block = Block(
                    f"{port.name}.{'p' if momentum else 'q'}",
                    output.shape,
                    units[3 if momentum else 2],
                )
                if isinstance(element, CField):
                    value = element.q0.get(port.port, 0.0)
                else:
                    value = element.p0 if isinstance(element, I) else element.q0
                add(port.name, block, value, inner[port.name])
    rate = sp.csr_array(sp.vstack(rates)) if rates else sp.csr_array((0, width))
    x0 = np.concatenate(start) if start else np.zeros(0)
    return Layout(blocks), x0, rate, state_of


def _select(eye: sp.csc_array, places: list[slice]) -> sp.csc_array:
    columns = np.concatenate([np.zeros(0, int), *[np.arange(p.start, p.stop) for p in places]])
    return eye[:, columns]


def _storage(
    graph: JunctionGraph,
    outputs: tuple[Output, ...],
    states: Layout,
    state_of: dict[str, str],
    width: int,
    kinds: tuple[str, ...],
) -> sp.csr_array:
    """Outputs of linear storage, K x, for these kinds of output."""
    rows, cols, data = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)]
    for output in outputs:
        if output.kind in kinds and output.constant is not None and output.index >= 0:
            name = graph.ports[output.index].name
            if name not in state_of:
                continue
            piece = states.slice(state_of[name])
            rows.append(np.arange(output.place.start, output.place.stop))
            cols.append(np.arange(piece.start, piece.stop))
            data.append(output.constant)
    entries = np.concatenate(data), (np.concatenate(rows), np.concatenate(cols))
    return sp.csr_array(entries, (width, states.size))


def _hidden_row(
    graph: JunctionGraph,
    output: Output,
    outputs: tuple[Output, ...],
    inner: dict[str, sp.csr_array],
    K: sp.csr_array,
    rate: sp.csr_array,
) -> sp.csr_array:
    """G for one memoryless linear or dependent output: w = G y."""
    port = graph.ports[output.index]
    sign = output_sign(port, output.quantity)
    if output.kind == "memoryless" and is_matrix(port.element):
        return _matrix_row(graph, port.element, output, inner)
    if output.kind == "memoryless":
        return sp.csr_array(sp.diags_array(sign * constants_of(output)) @ inner[port.name])
    behind = inner[port.name]
    used = np.unique(behind.indices[behind.data != 0])
    for other in outputs:
        if other is output or not np.any((used >= other.place.start) & (used < other.place.stop)):
            continue
        if other.kind == "linear" or (other.kind == "law" and other.constant is not None):
            continue
        source = graph.ports[other.index].element
        if isinstance(source, (Se, Sf)) and not callable(source.value):
            continue
        kind = "time-varying source" if other.kind == "source" else "nonlinear element"
        raise CausalityError(
            f"storage {port.name!r} is dependent on the {kind} {other.name!r}: its rate would "
            "need a derivative of that; put a resistor between, or make it linear and constant"
        )
    return sp.csr_array(sp.diags_array(sign * constants_of(output)) @ behind @ K @ rate)


def _matrix_row(
    graph: JunctionGraph, element: TF, output: Output, inner: dict[str, sp.csr_array]
) -> sp.csr_array:
    """e_in = M^T e_out, f_out = M f_in; M acts on nodes, or on all entries."""
    port = graph.ports[output.index]
    a, b = graph.two_port_sides(element)
    shape_in, shape_out = graph.shapes[a.bond], graph.shapes[b.bond]
    M = matrix_of(element)
    if len(shape_in) == len(shape_out) == 2 and shape_in[1] == shape_out[1]:
        if M.shape == (shape_out[0], shape_in[0]):
            M = sp.csr_array(sp.kron(M, sp.eye_array(shape_in[1])))
    if M.shape != (size_of(shape_out), size_of(shape_in)):
        raise DimensionError(
            f"TF {element.name!r}: ratio must map shape {shape_in} to {shape_out}, "
            f"got a matrix {M.shape}"
        )
    if not np.all(np.isfinite(M.data)):
        raise ParameterError(f"TF {element.name!r}: ratio holds NaN or inf")
    # The input of the e_in output is f_in, but its law needs e_out: cross over.
    return sp.csr_array(M.T @ inner[b.name] if port == a else M @ inner[a.name])


def _eliminate(Gw: sp.csc_array, rhs: sp.csr_array, hidden: list[Output]) -> sp.csc_array:
    """w = (I - Gw)^-1 rhs: a finite sum where no loop closes, else one sparse factorisation."""
    total = sp.csc_array(rhs)
    term = total
    for _ in hidden:
        term = sp.csc_array(Gw @ term)
        term.eliminate_zeros()
        if term.nnz == 0:
            return total
        total = total + term
    names = ", ".join(repr(o.name) for o in hidden)
    matrix = sp.csc_array(sp.eye_array(Gw.shape[0]) - Gw)
    try:
        solve = spla.splu(matrix).solve
    except RuntimeError as error:
        raise CausalityError(
            f"the linear elements {names} form an algebraic loop without a solution ({error})"
        ) from error
    full = sp.csc_array(rhs).toarray()
    w = solve(full)
    w += solve(full - matrix @ w)
    if not np.all(np.isfinite(w)):
        raise CausalityError(f"the linear elements {names} form a singular algebraic loop")
    return sp.csc_array(w)


def _clean(matrix: sp.csr_array | sp.csc_array) -> sp.csr_array:
    out = sp.csr_array(matrix)
    out.sum_duplicates()
    out.eliminate_zeros()
    return out
