"""Sparse Cholesky factorisation for matrices that keep their pattern and change their values.

SuperLU orders the pattern once (minimum degree) and the analysis is kept. A factorisation is
multifrontal [Duff & Reid 1983] on supernodes, columns that share their rows below the diagonal
(nearly: a few zeros are stored for longer loops). With half the numbers of an LU factorisation,
in dense panels, a solve takes about a quarter of SuperLU's time on the matrix of a fibre disc.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from cellsys.errors import DataError
from cellsys.mechanics import cholesky_kernels as kernels

_ZEROS = 0.15  # share of stored zeros up to which two supernodes are joined
_WIDE = 24  # most columns of a supernode: its square block is inverted
_SMALL = 12  # supernodes of together this many columns are joined whatever the zeros


@dataclass(frozen=True, eq=False, kw_only=True)
class Analysis:
    """Order, supernodes and index maps of one pattern; see `kernels.factorise` for the fields."""

    indptr: np.ndarray
    indices: np.ndarray
    order: np.ndarray
    source: np.ndarray
    target: np.ndarray
    entries: np.ndarray
    first: np.ndarray
    start: np.ndarray
    rows: np.ndarray
    place: np.ndarray
    children: np.ndarray
    panel_at: np.ndarray
    corner_at: np.ndarray
    front: int
    stack: int

    def fits(self, matrix: sp.csc_array) -> bool:
        """Whether `matrix` has this pattern."""
        return (
            len(matrix.indices) == len(self.indices)
            and np.array_equal(matrix.indptr, self.indptr)
            and np.array_equal(matrix.indices, self.indices)
        )


class SparseCholesky:
    """Factorises symmetric positive definite matrices, one pattern after the other."""

    def __init__(self) -> None:
        self._analysis: Analysis | None = None

    def __call__(self, matrix: sp.csc_array) -> Factorised:
        """Factorise `matrix` (n, n), symmetric with both triangles stored.

        Raises
        ------
        DataError
            When it is not positive definite, or holds NaN.
        """
        matrix.sort_indices()
        if self._analysis is None or not self._analysis.fits(matrix):
            self._analysis = analyse(matrix)
        return Factorised(self._analysis, matrix.data)


class Factorised:
    """L and D of one matrix; `factorised(rhs)` solves for (n,) or (n, k) right-hand sides."""

    def __init__(self, analysis: Analysis, values: np.ndarray) -> None:
        a = self.analysis = analysis
        self._panels, self._corners = np.empty(a.panel_at[-1]), np.empty(a.corner_at[-1])
        failed = kernels.factorise(
            values, a.source, a.target, a.entries, a.first, a.start, a.rows, a.place, a.children,
            np.empty(a.front), np.empty(a.stack),
            self._panels, a.panel_at, self._corners, a.corner_at,
        )  # fmt: skip
        if failed >= 0:
            raise DataError(
                f"matrix is not positive definite: no positive pivot in column {a.order[failed]}; "
                "check its entries for NaN, or use a smaller step"
            )
        self._work = np.empty(2 * a.order.size)

    def __call__(self, rhs: np.ndarray) -> np.ndarray:
        given, out = np.ascontiguousarray(rhs, dtype=float), np.empty(rhs.shape)
        index = np.arange(given.size).reshape(len(rhs), -1)
        self.placed(index)(given.ravel(), out.ravel())
        return out

    def rounded(self) -> Factorised:
        """The same with factors in single precision: half the memory that a solve reads.

        A solve is then right to some 1e-7 of its result, enough for a correction.
        """
        out = copy(self)
        out._panels, out._corners = (v.astype(np.float32) for v in (self._panels, self._corners))
        return out

    def placed(self, index: np.ndarray) -> Callable[[np.ndarray, np.ndarray], None]:
        """``solve(rhs, out)`` on the entries `index` (n,) or (n, k) of longer vectors."""
        a = self.analysis
        at = np.ascontiguousarray(index.reshape(len(index), -1)[a.order])
        return partial(
            kernels.solve, at, a.first, a.start, a.rows,
            self._panels, a.panel_at, self._corners, a.corner_at, self._work,
        )  # fmt: skip


def analyse(matrix: sp.csc_array) -> Analysis:
    """Order a symmetric pattern and find the supernodes of its factor."""
    n = matrix.shape[0]
    order = _postordered(matrix, _minimum_degree(matrix))
    pattern = _permuted(matrix, order)
    parent, count, start, rows = _columns(pattern)
    # Supernodes in postorder; each may take up the one before it.
    nodes: list[tuple[int, int, np.ndarray, int]] = []  # first, end, rows below, zeros stored
    begin = 0
    for c in range(n):
        alike = c + 1 < n and parent[c] == c + 1 and count[c] == count[c + 1] + 1
        if alike and c + 1 - begin < _WIDE:
            continue
        node = (begin, c + 1, rows[start[c] : start[c + 1]], 0)
        while nodes and (joined := _joined(nodes[-1], node)) is not None:
            node = joined
            nodes.pop()
        nodes.append(node)
        begin = c + 1
    first = np.array([node[0] for node in nodes] + [n])
    width = np.diff(first)
    height = np.array([len(node[2]) for node in nodes])
    below = np.concatenate([node[2] for node in nodes])
    starts = np.concatenate([[0], np.cumsum(height)])
    owner = np.repeat(np.arange(len(nodes)), width)  # supernode of each column
    place = np.empty(len(below), np.int64)
    children = np.zeros(len(nodes), np.int64)
    stack = deepest = 0
    for s, (_, _, r, _) in enumerate(nodes):
        if len(r):
            above = owner[r[0]]
            children[above] += 1
            place[starts[s] : starts[s + 1]] = _within(nodes[above], r)
    held: list[int] = []
    for s in range(len(nodes)):
        for _ in range(children[s]):
            stack -= held.pop()
        deepest = max(deepest, stack + int(height[s] * (height[s] + width[s])))
        if height[s]:
            held.append(int(height[s]) ** 2)
            stack += held[-1]
    # Where each entry of the matrix's triangle goes: row of the front = the earlier index.
    back = np.empty(n, np.int64)
    back[order] = np.arange(n)
    i, j = back[matrix.indices], back[np.repeat(np.arange(n), np.diff(matrix.indptr))]
    source = np.flatnonzero(i >= j)
    source = source[np.argsort(owner[j[source]], kind="stable")]
    i, j = i[source], j[source]
    entries = np.searchsorted(owner[j], np.arange(len(nodes) + 1))
    target = np.empty(len(source), np.int64)
    for s, node in enumerate(nodes):
        e = slice(entries[s], entries[s + 1])
        m = width[s] + height[s]
        target[e] = (j[e] - first[s]) * m + _within(node, i[e])
    return Analysis(
        indptr=matrix.indptr.copy(),
        indices=matrix.indices.copy(),
        order=order,
        source=source,
        target=target,
        entries=entries,
        first=first,
        start=starts,
        rows=below,
        place=place,
        children=children,
        panel_at=np.concatenate([[0], np.cumsum(width * height)]),
        corner_at=np.concatenate([[0], np.cumsum(width**2)]),
        front=int(((width + height) ** 2).max()),
        stack=deepest,
    )


def _minimum_degree(matrix: sp.csc_array) -> np.ndarray:
    """SuperLU's minimum-degree order; the values are replaced, for only the pattern counts."""
    n = matrix.shape[0]
    unit = sp.csc_matrix((np.ones(len(matrix.indices)), matrix.indices, matrix.indptr), (n, n))
    unit = sp.csc_matrix(unit + sp.diags_array(np.full(n, float(n))))
    factor = spla.splu(
        unit, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return np.argsort(factor.perm_c)


def _permuted(matrix: sp.csc_array, order: np.ndarray) -> sp.csc_array:
    out = sp.csc_array(matrix)[order][:, order]
    out.sort_indices()
    return out


def _columns(pattern: sp.csc_array) -> tuple[np.ndarray, ...]:
    n = pattern.shape[0]
    parent, count = np.empty(n, np.int64), np.empty(n, np.int64)
    # One type: the loops are compiled for each anew.
    indptr, indices = (v.astype(np.int64, copy=False) for v in (pattern.indptr, pattern.indices))
    kernels.elimination_tree(indptr, indices, parent, count)
    start = np.concatenate([[0], np.cumsum(count)])
    rows = np.empty(start[-1], np.int64)
    kernels.column_rows(indptr, indices, parent, start, rows)
    return parent, count, start, rows


def _postordered(matrix: sp.csc_array, order: np.ndarray) -> np.ndarray:
    """The same elimination with every subtree contiguous, its largest child last."""
    parent, count, _, _ = _columns(_permuted(matrix, order))
    children: list[list[int]] = [[] for _ in range(len(order) + 1)]
    for j in range(len(order)):
        children[parent[j]].append(j)
    out: list[int] = []
    # Parents first with the largest child next, then reversed.
    todo = children[-1]
    while todo:
        j = todo.pop()
        out.append(j)
        todo.extend(sorted(children[j], key=count.__getitem__))
    return order[np.array(out[::-1])]


def _joined(
    child: tuple[int, int, np.ndarray, int], node: tuple[int, int, np.ndarray, int]
) -> tuple[int, int, np.ndarray, int] | None:
    """The two as one supernode, if that is worth the zeros it stores; `child` comes before."""
    if not len(child[2]) or not node[0] <= child[2][0] < node[1]:
        return None
    narrow, wide = child[1] - child[0], node[1] - node[0]
    zeros = child[3] + node[3] + narrow * (wide + len(node[2]) - len(child[2]))
    width = narrow + wide
    stored = width * (width + 1) // 2 + width * len(node[2])
    if width > _WIDE or (zeros > _ZEROS * stored and width > _SMALL):
        return None
    return child[0], node[1], node[2], zeros


def _within(node: tuple[int, int, np.ndarray, int], i: np.ndarray) -> np.ndarray:
    """Positions of the indices `i` in the front of a supernode: its columns, then its rows."""
    begin, end, rows, _ = node
    return np.where(i < end, i - begin, end - begin + np.searchsorted(rows, i))
