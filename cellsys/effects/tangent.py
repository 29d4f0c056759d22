"""Over-estimates of the tangent: the matrices they are made of, and their sum by blocks."""

from __future__ import annotations

from functools import partial

import numpy as np
import scipy.sparse as sp

from cellsys.effects.protocol import Stiffness
from cellsys.overdamped import MajorantBlock


def laplacian(n: int, edges: np.ndarray, weight: np.ndarray) -> sp.csc_array:
    """Graph Laplacian (n, n) with one weight per edge."""
    i, j = edges.T
    rows, cols = np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])
    return sp.csc_array((np.concatenate([weight, weight, -weight, -weight]), (rows, cols)), (n, n))


def diagonal(values: np.ndarray) -> sp.csc_array:
    """Diagonal matrix in compressed columns."""
    return sp.csc_array(sp.diags_array(np.asarray(values, float)))


def combine(array: str, index: np.ndarray, items: list[Stiffness], t: float) -> list[MajorantBlock]:
    """Sum the stiffnesses of one array into as few blocks as they allow.

    Coupled parts make one block of all coordinates; otherwise coordinates with the same parts
    share a block and its factorisation.
    """
    n = len(index)
    groups: dict[tuple[int, ...], tuple[int, ...]] = {}
    if any(not item.axes for item in items):
        groups[tuple(range(len(items)))] = ()
    else:
        for axis in range(3):
            members = tuple(i for i, item in enumerate(items) if axis in item.axes)
            groups[members] = (*groups.get(members, ()), axis)
    blocks = []
    for members, axes in groups.items():
        chosen = [items[i] for i in members]
        keys = tuple(item.key for item in chosen)
        # A part without a key may differ at every look.
        key = (t, keys) if any(k is None for k in keys) else keys
        blocks.append(
            MajorantBlock(
                f"{array}.{''.join('xyz'[a] for a in axes) or 'xyz coupled'}",
                index[:, axes] if axes else index.reshape(-1, 1),
                partial(_sum, n, chosen, bool(axes)),
                key,
            )
        )
    return blocks


def _sum(n: int, items: list[Stiffness], separate: bool) -> sp.csc_array:
    total = sp.csc_array((n, n) if separate else (3 * n, 3 * n))
    for item in items:
        matrix = item.matrix()
        if not separate and item.axes:
            on = np.zeros(3)
            on[list(item.axes)] = 1.0
            entries = matrix.tocoo()
            if np.array_equal(entries.row, entries.col):
                # Diagonal, as foundation and adhesion are: no need for a Kronecker product.
                spread = np.outer(matrix.diagonal(), on).ravel()
                matrix = sp.csc_array(sp.diags_array(spread))
            else:
                matrix = sp.kron(matrix, sp.diags_array(on), format="csc")
        total = total + matrix
    return sp.csc_array(total)
