"""The spreading cell's W_eta comes from two vector junctions, and is the I/C written by hand."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from cellsys.bondgraph import BondGraph, One, R
from cellsys.effects.protocol import Port
from cellsys.mechanics.junctions import JunctionArray, junction_graph
from cellsys.scene import build, load_scene
from cellsys.system import Block

SCENE = Path(__file__).parents[2] / "examples" / "spreading.toml"


def by_hand(system):
    """I/C for every nodal port, I for the rate of every internal state."""
    drag = system.drag()
    W = sp.lil_array((system.states.size, system.auxiliaries.size))
    for element in system.elements:
        for port in element.ports:
            array = "matrix.displacement" if port.array == "matrix" else f"{port.array}.position"
            rows = np.arange(system.states.size)[system.states.slice(array)]
            columns = np.arange(system.auxiliaries.size)[system.auxiliaries.slice(port.block)]
            free = np.isfinite(drag[rows])
            W[rows[free], columns[free]] = 1.0 / drag[rows[free]]
        for block in element.internal:
            rows = np.arange(system.states.size)[system.states.slice(block.name)]
            name = f"{block.name}.rate"
            W[rows, np.arange(system.auxiliaries.size)[system.auxiliaries.slice(name)]] = 1.0
    return sp.csr_array(W)


def test_spreading_cell_is_built_from_two_vector_junctions():
    system = build(load_scene(SCENE))
    expected = by_hand(system)
    assert (system.W_eta != expected).nnz == 0  # the same numbers, bit for bit
    assert system.W_eta.nnz == expected.nnz
    assert system.W_x.nnz == 0
    ports = [p.block for e in system.elements for p in e.ports]
    rates = [f"{b.name}.rate" for e in system.elements for b in e.internal]
    assert [b.name for b in system.auxiliaries] == ports + rates


def test_leaving_a_port_out_leaves_its_column_out():
    rng = np.random.default_rng(0)
    drag = rng.uniform(1, 2, (5, 3))
    drag[2] = np.inf
    array = JunctionArray("cell", Block("cell.position", (5, 3), "um"), np.zeros((5, 3)), drag)
    field = JunctionArray("matrix", Block("matrix.u", (4, 3), "um", role="field"), np.zeros((4, 3)),
                          np.ones((4, 3)))  # fmt: skip
    ports = [Port("cell", "cell.tension"), Port("cell", "cell.grip"), Port("matrix", "matrix.grip")]
    bond = Block("cell.bond", (5,), "1", role="component", kind="internal")
    full = junction_graph([array, field], ports, [(bond, np.full(5, 0.5))]).equations()
    assert full.W_eta.shape == (32, 47)
    np.testing.assert_array_equal(full.W_eta.toarray()[:15, :15], np.diag((1 / drag).ravel()))
    np.testing.assert_array_equal(full.x0[-5:], 0.5)
    assert full.auxiliaries["matrix.grip"].role == "field"
    assert full.auxiliaries["matrix.grip"].unit == "pN"
    fewer = junction_graph([array, field], ports[1:], []).equations()
    assert fewer.W_eta.shape == (27, 27)


def test_an_array_without_effects_stays_where_it_is():
    graph = BondGraph([One("n", shape=(2, 3), position="x"), R("drag", 1.0)], ["n -> drag"])
    equations = graph.equations()
    assert equations.W_eta.shape == (6, 0)
    np.testing.assert_array_equal(equations.system.rhs(0.0, np.ones(6)), 0.0)


def test_building_stays_cheap():
    """2000 matrix nodes and a membrane: tens of milliseconds, once per scene."""
    scene = load_scene(SCENE)
    build(scene)
    spent = []
    for _ in range(3):
        began = time.process_time()
        build(scene)
        spent.append(time.process_time() - began)
    assert min(spent) < 0.3
