"""Linear graphs against hand derivations, and against BondGraphTools where it is installed."""

from __future__ import annotations

import time

import numpy as np
import pytest

from cellsys.bondgraph import BondGraph, C, I, One, R, Se
from tests.bondgraph import graphs

# Products and one linear solve of numbers of order 1..1000: a few units in the last place.
ROUNDING = 1e-13


@pytest.mark.parametrize("case", graphs.ALL, ids=lambda f: f.__name__)
def test_matrices_equal_the_hand_derivation(case):
    graph, A, B = case()
    equations = graph.equations()
    scale = 1.0 + np.abs(A).max()
    np.testing.assert_allclose(equations.W_x.toarray(), A, rtol=0, atol=ROUNDING * scale)
    np.testing.assert_allclose(equations.W_s.toarray(), B, rtol=0, atol=ROUNDING)
    assert equations.auxiliaries.size == 0


@pytest.mark.parametrize("case", graphs.ALL, ids=lambda f: f.__name__)
def test_literal_reading_is_the_same_system(case):
    """With every law in eta [thesis 39], W_x = 0 and dx/dt is the same."""
    graph, _, _ = case()
    plain, literal = graph.equations(), graph.equations(literal=True)
    assert literal.W_x.nnz == 0
    x = np.random.default_rng(1).standard_normal(plain.states.size)
    expected = plain.system.rhs(0.0, x)
    # The bridge's loop is then solved by Newton, to 1e-9 relative at worst.
    np.testing.assert_allclose(literal.system.rhs(0.0, x), expected, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("case", graphs.ALL, ids=lambda f: f.__name__)
def test_power_balances_at_every_junction_and_in_all(case):
    graph, _, _ = case()
    equations = graph.equations()
    x = np.random.default_rng(2).standard_normal(equations.states.size)
    values = list(equations.bonds(0.0, x).values())
    for name, bonds in graph.junction_bonds.items():
        flows = [sign * float(np.sum(values[b][0] * values[b][1])) for b, sign in bonds]
        assert abs(sum(flows)) <= ROUNDING * (1.0 + max(map(abs, flows))), name
    power = equations.power(0.0, x)
    left = power["sources"] - power["dissipation"] - power["storage"]
    assert abs(left) <= ROUNDING * (1.0 + max(map(abs, power.values())))


def test_dependent_inertia_on_a_lever():
    """p_a' = F/13, and the dependent element's energy is counted."""
    graph, _, _ = graphs.lever()
    equations = graph.equations()
    assert equations.dependent == ("Ib",)
    assert equations.W_s.toarray()[0, 0] == pytest.approx(1 / 13, rel=1e-15)
    energy = equations.energy(0.0, np.array([1.0]))
    # v_a = 1, v_b = 2: 1/2 m v^2
    assert energy == {"Ia": pytest.approx(0.5), "Ib": pytest.approx(0.5 * 3 * 4)}


def test_four_hundred_bonds_in_a_second():
    graph = graphs.chain(66, law=lambda q: q + q**3)
    assert len(graph.joined) == 399
    began = time.process_time()
    equations = graph.equations()
    assert time.process_time() - began < 1.0
    assert equations.states.size == 132
    # Entries: only 0, +-1, 1/m and linear R: the chain couples neighbours alone.
    assert equations.W_eta.nnz == 3 * 66 - 2 + 66 - 66 or equations.W_eta.nnz <= 3 * 66


def test_star_and_random_trees_stay_within_the_time():
    elements = [One("hub"), Se("F")] + [C(f"c{i}", 1.0) for i in range(200)]
    elements += [R(f"r{i}", 1.0) for i in range(198)] + [I("m", 1.0)]
    bonds = ["F -> hub", "hub -> m"] + [f"hub -> c{i}" for i in range(200)]
    bonds += [f"hub -> r{i}" for i in range(198)]
    began = time.process_time()
    equations = BondGraph(elements, bonds).equations()
    assert time.process_time() - began < 1.0
    assert equations.W_x[[200]].toarray()[0, 200] == pytest.approx(-198.0)


INDEPENDENT = [f for f in graphs.ALL if f not in (graphs.lever, graphs.parallel_capacitors)]


@pytest.mark.parametrize("case", INDEPENDENT, ids=lambda f: f.__name__)
@pytest.mark.filterwarnings("ignore")  # of that package and its dependencies, not ours
def test_linear_graphs_equal_bondgraphtools(case):
    bgt = pytest.importorskip("BondGraphTools")
    graph, _, _ = case()
    theirs, names = _translated(bgt, graph)
    equations = graph.equations()
    order = [names.index(b.name.rpartition(".")[0]) for b in equations.states]
    mine = equations.W_x.toarray()
    # Both solve the same small linear relations exactly or by elimination.
    np.testing.assert_allclose(mine, theirs[np.ix_(order, order)], rtol=1e-12, atol=1e-12)


def _translated(bgt, graph):
    """A of the same graph built with BondGraphTools, sources at zero, and its states' names."""
    import sympy as sp

    model = bgt.new(name="model")
    made = {}
    for element in graph.elements:
        kind = type(element).__name__
        value = {
            "R": lambda e: e.resistance,
            "C": lambda e: e.compliance if e.compliance is not None else 1.0 / e.stiffness,
            "I": lambda e: e.inertance,
            # Theirs: e_out = r e_in for a TF; both flows of a GY counted inwards.
            "TF": lambda e: 1.0 / e.ratio,
            "GY": lambda e: -e.ratio,
            "Se": lambda e: 0.0,
            "Sf": lambda e: 0.0,
        }.get(kind)
        kind = {"One": "1", "Zero": "0"}.get(kind, kind)
        made[element.name] = bgt.new(kind, value=value(element)) if value else bgt.new(kind)
    bgt.add(model, *made.values())
    for bond in graph.joined:
        ends = []
        for name, port in bond.ends:
            part = made[name]
            ends.append((part, {"in": 0, "out": 1}[port]) if port else part)
        bgt.connect(*ends)
    where = {id(component): name for name, component in made.items()}
    names = [where[id(component)] for component, _ in model.state_vars.values()]
    symbols = [sp.Symbol(str(s)) for s in model.state_vars]
    rates = [sp.Symbol(f"d{s}") for s in model.state_vars]
    known = {str(s): s for s in [*symbols, *rates]}
    relations = [sp.sympify(str(r), locals=known) for r in model.constitutive_relations]
    solved = sp.solve(relations, rates, dict=True)[0]
    return np.array([[float(sp.diff(solved[r], s)) for s in symbols] for r in rates]), names
