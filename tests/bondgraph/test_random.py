"""Random linear graphs against a dense solve of all relations, without any causality."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.bondgraph import GY, TF, BondGraph, C, I, One, R, Se, Sf, Zero
from cellsys.errors import CausalityError


def random_graph(rng):
    """A random tree of junctions, some joined through TF or GY, with elements on them."""
    n = int(rng.integers(2, 9))
    elements = [(One if rng.random() < 0.5 else Zero)(f"j{i}") for i in range(n)]
    bonds = []
    for i in range(1, n):
        other = int(rng.integers(i))
        pair = [f"j{other}", f"j{i}"]
        if rng.random() < 0.5:
            pair.reverse()
        if rng.random() < 0.35:
            elements.append((TF if rng.random() < 0.5 else GY)(f"t{i}", rng.uniform(0.3, 3.0)))
            pair.insert(1, f"t{i}")
        bonds.append(" -> ".join(pair))
    for k in range(int(rng.integers(n, 2 * n + 2))):
        value = float(rng.uniform(0.3, 3.0))
        kind = rng.choice(["R", "C", "I", "Se", "Sf"], p=[0.4, 0.25, 0.25, 0.05, 0.05])
        element = {
            "R": lambda v, k=k: R(f"e{k}", v), "C": lambda v, k=k: C(f"e{k}", v),
            "I": lambda v, k=k: I(f"e{k}", v), "Se": lambda v, k=k: Se(f"e{k}", v),
            "Sf": lambda v, k=k: Sf(f"e{k}", v),
        }[kind](value)  # fmt: skip
        elements.append(element)
        ends = [f"j{int(rng.integers(n))}", f"e{k}"]
        if rng.random() < 0.3:
            ends.reverse()
        bonds.append(" -> ".join(ends))
    return BondGraph(elements, bonds)


def dense_bonds(graph, equations, x):
    """All (e, f) from junctions, two-ports, R laws and the storages' own outputs: least squares."""
    m = len(graph.joined)
    rows, right = [], []

    def relation(terms, value=0.0):
        row = np.zeros(2 * m)
        for (bond, quantity), c in terms.items():
            row[2 * bond + (quantity == "f")] += c
        rows.append(row)
        right.append(value)

    for name, bonds in graph.junction_bonds.items():
        same, summed = ("e", "f") if isinstance(graph.by_name[name], Zero) else ("f", "e")
        for b, _ in bonds[1:]:
            relation({(bonds[0][0], same): 1, (b, same): -1})
        relation({(b, summed): s for b, s in bonds})
    values = {b.name: x[equations.states.slice(b.name)][0] for b in equations.states}
    for element in graph.elements:
        if isinstance(element, (TF, GY)):
            a, b = (p.bond for p in graph.two_port_sides(element))
            near, far = ("e", "f") if isinstance(element, TF) else ("f", "e")
            relation({(a, "e"): 1, (b, near): -element.ratio})
            relation({(b, far): 1, (a, "f"): -element.ratio})
    for p in graph.ports:
        e = p.element
        if isinstance(e, R):
            relation({(p.bond, "e"): 1, (p.bond, "f"): -p.sign * e.resistance})
        elif isinstance(e, C):
            relation({(p.bond, "e"): 1}, values[f"{e.name}.q"] / e.compliance)
        elif isinstance(e, I):
            relation({(p.bond, "f"): 1}, values[f"{e.name}.p"] / e.inertance)
        elif isinstance(e, Se):
            relation({(p.bond, "e"): 1}, e.value)
        elif isinstance(e, Sf):
            relation({(p.bond, "f"): 1}, e.value)
    matrix, right = np.array(rows), np.array(right)
    solution, _, rank, _ = sla.lstsq(matrix, right)
    return solution, rank == 2 * m, np.abs(matrix @ solution - right).max()


def test_random_graphs():
    rng = np.random.default_rng(12)
    checked, dependent, refused = 0, 0, 0
    for _ in range(400):
        try:
            graph = random_graph(rng)
            equations = graph.equations()
        except CausalityError:
            refused += 1
            continue
        x = rng.standard_normal(equations.states.size)
        power = equations.power(0.0, x)
        left = power["sources"] - power["dissipation"] - power["storage"]
        # Junction sums of numbers up to a few thousand (ratios of 3 over eight levels).
        assert abs(left) <= 1e-10 * (1.0 + max(map(abs, power.values())))
        if equations.dependent:
            dependent += 1
            continue
        solution, unique, residual = dense_bonds(graph, equations, x)
        if not unique or residual > 1e-9:
            continue
        checked += 1
        got = np.array([v for pair in equations.bonds(0.0, x).values() for v in pair])
        np.testing.assert_allclose(got, solution, rtol=1e-8, atol=1e-8 * np.abs(solution).max())
        for port in graph.ports:
            e, f = solution[2 * port.bond : 2 * port.bond + 2]
            if isinstance(port.element, (C, I)):
                name = f"{port.name}.{'q' if isinstance(port.element, C) else 'p'}"
                rate = port.sign * (f if isinstance(port.element, C) else e)
                got = equations.system.rhs(0.0, x)[equations.states.slice(name)][0]
                assert got == pytest.approx(rate, rel=1e-8, abs=1e-8 * np.abs(solution).max())
    assert checked > 60
    assert dependent > 30
    assert refused > 10
