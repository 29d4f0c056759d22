"""Stored and dissipated energy of a bond graph."""

from __future__ import annotations

import numpy as np

from cellsys.bondgraph.elements import C, CField, I, R
from cellsys.bondgraph.expressions import Numbers, numbers, shaped
from cellsys.bondgraph.junctions import JunctionGraph
from cellsys.bondgraph.outputs import constants_of
from cellsys.bondgraph.structure import Structure

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(48)


def stored_energy(
    structure: Structure, bonds: dict[str, tuple[Numbers, Numbers]], x: np.ndarray
) -> dict[str, float]:
    """Energy of every storage, H(q) = integral of law(q) dq from 0.

    Linear: q^2/(2 C) or p^2/(2 m), dependent ones included (from their effort or flow).
    Nonlinear: the element's own `energy`, else 48-point Gauss-Legendre along the ray from 0,
    exact for polynomials below degree 96.
    """
    graph, out = structure.graph, {}
    names = list(bonds)
    for output in structure.outputs:
        port = graph.ports[output.index] if output.index >= 0 else None
        if port is None or not isinstance(port.element, (C, I, CField)):
            continue
        element = port.element
        if output.kind == "dependent":
            e, f = bonds[names[port.bond]]
            v = np.ravel(f if isinstance(element, I) else e)
            out[port.name] = float(0.5 * np.sum(constants_of(output) * v**2))
            continue
        piece = structure.states.slice(structure.state_of[port.name])
        if isinstance(element, CField):
            if port.port == element.ends[0]:
                out[element.name] = _field(structure, element, x)
        elif element.law is None:
            out[port.name] = float(0.5 * np.sum(constants_of(output) * x[piece] ** 2))
        elif element.energy is not None:
            out[port.name] = float(np.sum(numbers(element.energy(shaped(x[piece], output.shape)))))
        else:
            q = shaped(x[piece], output.shape)
            out[port.name] = float(
                sum(
                    0.5 * w * np.sum(numbers(element.law(0.5 * (1 + s) * q)) * q)
                    for s, w in zip(_NODES, _WEIGHTS, strict=True)
                )
            )
    return out


def _field(structure: Structure, element: CField, x: np.ndarray) -> float:
    q = []
    for end in element.ends:
        name = structure.state_of[f"{element.name}.{end}"]
        q.append(shaped(x[structure.states.slice(name)], structure.states[name].shape))
    if element.energy is not None:
        return float(np.sum(numbers(element.energy(*q))))
    total = 0.0
    for s, w in zip(_NODES, _WEIGHTS, strict=True):
        efforts = element.law(*(0.5 * (1 + s) * v for v in q))
        total += (
            0.5 * w * sum(float(np.sum(numbers(e) * v)) for e, v in zip(efforts, q, strict=True))
        )
    return total


def dissipation(graph: JunctionGraph, into: dict[str, float]) -> dict[str, float]:
    """Power into every resistor."""
    return {p.name: into[p.name] for p in graph.ports if isinstance(p.element, R)}
