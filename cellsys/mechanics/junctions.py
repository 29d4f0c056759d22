"""The full-order model as a bond graph on vector junctions.

The nodes of a cell and the nodes of the matrix are one 1-junction each, with the linear drag R on
it; every nodal port of an effect is an effort on that junction:

    C dx/dt = sum of port efforts      ->      W_eta block of a port = I/C       [thesis 60-67]
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellsys.bondgraph import BondElement, BondGraph, Internal, NodalEffort, One, R
from cellsys.compiled import compiled
from cellsys.effects.protocol import JunctionArray, Port
from cellsys.system import Block, Layout

Place = tuple[slice, tuple[int, ...]]  # where a block lies, and its shape


def place_of(layout: Layout, name: str) -> Place:
    """Where a block lies, and its shape."""
    return layout.slice(name), layout[name].shape


def junction_graph(
    arrays: Sequence[JunctionArray],
    ports: Sequence[Port],
    internal: Sequence[tuple[Block, np.ndarray]],
) -> BondGraph:
    """Bond graph of junction arrays, nodal ports on them and internal states.

    Parameters
    ----------
    arrays : sequence of JunctionArray
        In the order of the states.
    ports : sequence of Port
        In the order of the auxiliaries.
    internal : sequence of (Block, initial value)
        States inside elements; their rates are the last auxiliaries.

    Returns
    -------
    BondGraph
        Its equations give states, auxiliaries, x0 and W_eta; the laws stay with the elements,
        which exchange power between arrays by equal and opposite port efforts.
    """
    elements: list[BondElement] = []
    bonds = []
    for array in arrays:
        junction = f"{array.name} nodes"
        elements.append(
            One(
                junction,
                shape=array.block.shape,
                domain="translation",
                position=array.block,
                x0=array.start,
            )
        )
        bonds.append(f"{junction} -> {junction} drag")
    for array in arrays:
        elements.append(R(f"{array.name} nodes drag", conductance=1.0 / array.drag))
    for port in ports:
        elements.append(NodalEffort(port.block))
        bonds.append(f"{port.block} -> {port.array} nodes")
    for block, start in internal:
        elements.append(Internal(f"{block.name} inside", block, None, start))
    return BondGraph(elements, bonds, separate=True, name="full-order model")


@compiled
def product(indptr, indices, data, vector, out):
    """Add W vector to `out`, W in compressed rows: for one small product a step."""
    for i in range(out.size):
        total = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            total += data[k] * vector[indices[k]]
        out[i] += total
