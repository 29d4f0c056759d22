"""The equations as a person would write them: text and LaTeX."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from cellsys.bondgraph.elements import GY, TF, C, I, R, Se, Sf
from cellsys.bondgraph.junctions import is_matrix, is_modulated
from cellsys.bondgraph.outputs import Output
from cellsys.bondgraph.state_equations import StateEquations


def _terms(equations: StateEquations, row: sp.csr_array) -> list[tuple[float, str]]:
    """(coefficient, output name) of one row over y; a vector element counts once."""
    out = []
    coefficients = dict(zip(row.indices, row.data, strict=True))
    for o in equations.structure.outputs:
        for k in range(o.place.start, o.place.stop):
            c = coefficients.get(k, 0.0)
            if c:
                out.append((float(c), o.name))
                break
    return out


def _sum(terms: list[tuple[float, str]]) -> str:
    if not terms:
        return "0"
    text = ""
    for c, name in terms:
        sign = " - " if c < 0 else " + "
        size = "" if abs(c) == 1.0 else f"{abs(c):.6g} "
        text += f"{sign}{size}{name}"
    return text[3:] if text.startswith(" + ") else "-" + text[3:]


def _law(equations: StateEquations, o: Output, show: Callable[[str], str]) -> str:
    """Right-hand side of one constitutive law, with the names of what it depends on."""
    graph, S = equations.graph, equations.structure
    if o.kind == "rate":
        return f"{show('rate')}(x)"
    port = graph.ports[o.index]
    element = port.element
    if o.kind == "source":
        value = element.value if isinstance(element, (Se, Sf)) else None
        return f"{show(o.name)}(t)" if callable(value) else f"{value}"
    if is_modulated(element) or is_matrix(element):
        a, b = graph.two_port_sides(element)
        other = b if port == a else a
        seen = _sum([(c, show(n)) for c, n in _terms(equations, S.inner[other.name][[0]])])
        ratio = "ratio(x)" if is_modulated(element) else "ratio"
        divide = (
            o.quantity == "f"
            if isinstance(element, GY)
            else (isinstance(element, TF) and (port == a) == (o.quantity == "f"))
        )
        return f"({seen}) / {ratio}" if divide else f"{ratio} ({seen})"
    if isinstance(element, (C, I)) and o.kind != "dependent":
        seen = show(S.state_of[port.name])
    elif isinstance(element, R) or o.kind == "dependent":
        seen = _sum([(c, show(n)) for c, n in _terms(equations, S.inner[port.name][[0]])])
    else:
        return f"{show(element.name)}(x)"
    if o.constant is None:
        return f"{show(element.name)}({seen})"
    values = np.unique(o.constant)
    factor = f"{values[0]:.6g}" if values.size == 1 else f"{show(element.name)}_i"
    if o.kind == "dependent":
        return f"{factor} d/dt({seen})"
    if factor == "1":
        return seen
    return f"{factor} ({seen})" if " " in seen else f"{factor} {seen}"


def text(equations: StateEquations) -> str:
    """Rates of the states, constitutive laws and causality, one per line."""
    graph, S = equations.graph, equations.structure
    lines = [f"bond graph {graph.name or '(unnamed)'}: {len(graph.joined)} bonds, "
             f"{equations.states.size} states, {equations.auxiliaries.size} auxiliaries, "
             f"{equations.inputs.size} inputs"]  # fmt: skip
    width = max((len(b.name) for b in equations.states), default=0)
    for block in equations.states:
        row = S.rate[[S.states.slice(block.name).start]]
        lines.append(f"  d {block.name:<{width}} /dt = {_sum(_terms(equations, row))}")
    lines.append("with")
    width = max((len(o.name) for o in S.outputs), default=0)
    for o in S.outputs:
        mark = "  (dependent)" if o.kind == "dependent" else ""
        name = f"{o.name}.rate" if o.kind == "rate" else o.name
        lines.append(f"  {name:<{width}} = {_law(equations, o, str)}{mark}")
    for loop in equations.loops:
        lines.append(f"  solved together: {', '.join(loop)}")
    return "\n".join(lines)


def _symbol(name: str) -> str:
    """LaTeX for ``element.e``: the quantity with the element as its subscript."""
    head, _, tail = name.rpartition(".")
    if head and tail in ("e", "f", "p", "q"):
        return f"{tail}_{{\\mathrm{{{_plain(head)}}}}}"
    return f"\\mathrm{{{_plain(name)}}}"


def _plain(name: str) -> str:
    return re.sub(r"([_%&#])", r"\\\1", name).replace(" ", "\\ ")


def latex(equations: StateEquations) -> str:
    """An ``aligned`` block with rates and laws."""
    S = equations.structure
    rows = []
    for block in equations.states:
        row = S.rate[[S.states.slice(block.name).start]]
        terms = [(c, _symbol(n)) for c, n in _terms(equations, row)]
        rows.append(f"\\dot {{{_symbol(block.name)}}} &= {_sum(terms)}")
    for o in S.outputs:
        rows.append(f"{_symbol(o.name)} &= {_law(equations, o, _symbol)}")
    return "\\begin{aligned}\n" + " \\\\\n".join(rows) + "\n\\end{aligned}"
