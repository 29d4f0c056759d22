"""From the windows of the slow states to the whole state at every sample.

Inside a window w' = lambda w + B c(t) with a known c. Pieces of equal length take their part of c
through Gauss nodes, exactly weighted by phi functions; the recursion over them runs over all
windows of one length at once, in blocks, so that Python sees about 2 sqrt(n) steps.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from cellsys.integrate.semilinear import Flow, Semilinear
from cellsys.integrate.windows import Path, grid

FEWEST = 16  # pieces of a window
_GAUSS = (2, 3, 4, 6, 8, 10)


def sample(
    system: Semilinear,
    flow: Flow,
    path: Path,
    t: np.ndarray,
    s: int,
    tolerance: float,
    x: np.ndarray,
) -> None:
    """Write the states at the times t, inside the windows of `path`, into x (T, n).

    Parameters
    ----------
    s : int
        Nodes of the windows.
    tolerance : float
        Commands are interpolated on a piece to this share of a command.
    """
    edges = np.array(path.edges)
    # Cells first: a cell's windows and their pieces then lie one behind the other.
    Y, W = np.stack(path.y, axis=1), np.stack(path.w, axis=1)
    owner = np.clip(np.searchsorted(edges, t, side="left") - 1, 0, len(path.y) - 1)
    lengths, unit = np.array(path.lengths), spacing(t)
    starts = t == edges[0]
    places = [
        (_slice(fast), _slice(slow)) for fast, slow in zip(system.fast, system.slow, strict=True)
    ]
    for h in np.unique(lengths):
        windows = np.flatnonzero(lengths == h)
        mine = np.flatnonzero((lengths[owner] == h) & ~starts)
        if mine.size:
            group = _Group(system, flow, s, float(h), _pieces(h, unit), tolerance)
            which = np.searchsorted(windows, owner[mine])
            w, y = group.fill(Y[:, windows], W[:, windows], which, t[mine] - edges[owner[mine]])
            rows = _slice(mine)
            for k, (fast, slow) in enumerate(places):
                at = (rows, fast) if isinstance(fast, slice) else np.ix_(mine, fast)
                x[at] = flow.read(w[k])
                x[(rows, slow) if isinstance(slow, slice) else np.ix_(mine, slow)] = y[k]


def _slice(index: np.ndarray) -> Any:
    """A slice where indices are consecutive: numpy copies that without looking them up."""
    first, last = int(index[0]), int(index[-1])
    return slice(first, last + 1) if last - first == len(index) - 1 else index


def spacing(t: np.ndarray) -> float | None:
    """The time of which all intervals between samples are multiples, s; None where none is."""
    if len(t) < 2:
        return None
    gaps = np.diff(t)
    unit = float(gaps.min())
    multiples = gaps / unit
    equal = np.abs(multiples - np.round(multiples)).max() < 1e-7
    return unit if equal and (t[-1] - t[0]) / unit < 200_000 else None


def _pieces(h: float, unit: float | None) -> int:
    """Pieces of a window: samples fall on their ends where samples are equally spaced."""
    if unit is None:
        return 4 * FEWEST
    n = round(h / unit)
    if n < 1 or abs(h / unit - n) > 1e-6:
        return FEWEST
    return n * max(1, int(2 ** np.ceil(np.log2(FEWEST / n))))


class _Group:
    """Windows of one length h, cut into n pieces."""

    def __init__(
        self, system: Semilinear, flow: Flow, s: int, h: float, n: int, tolerance: float
    ) -> None:
        self.system, self.flow, self.s, self.h, self.n = system, flow, s, h, n
        self.piece, self.tolerance = h / n, tolerance

    def _values(self, at: np.ndarray, Y: np.ndarray) -> np.ndarray:
        """y (cells, G, points, n_y) at points of [0, 1] of windows Y (cells, G, s, n_y)."""
        flat = np.swapaxes(Y, -1, -2).reshape(-1, self.s) @ lagrange(self.s, at).T
        return np.swapaxes(flat.reshape(*Y.shape[:2], Y.shape[3], len(at)), -1, -2)

    def _commands(self, Y: np.ndarray) -> np.ndarray:
        """[c, 1] (cells, G, points, n_c + 1)."""
        C = self.system.commands(Y)
        return np.concatenate([C, np.ones((*C.shape[:-1], 1))], axis=-1)

    def fill(
        self, Y: np.ndarray, W: np.ndarray, window: np.ndarray, offset: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """w and y (cells, samples, .) `offset` seconds after the start of their windows."""
        cells, G = Y.shape[:2]
        n, piece, flow = self.n, self.piece, self.flow
        for q in _GAUSS:
            nodes, top = gauss(q)
            at = ((np.arange(n)[:, None] + nodes) / n).ravel()
            C = self._commands(self._values(at, Y)).reshape(cells * G * n, q, -1)
            if float(np.abs(top @ C).max(initial=0.0)) <= self.tolerance:
                break
        F = flow.response(flow.interval(np.float64(piece), nodes), C)
        states = _recursion(flow, piece, W, F.reshape(cells, G, n, -1))
        states = states.reshape(cells, G * n, -1)
        j = np.minimum(np.floor(offset / piece + 1e-7).astype(int), n)
        left = offset - j * piece
        # Samples share their place in the window with many others.
        place, back = np.unique(np.round(offset / self.h, 12), return_inverse=True)
        values = np.ascontiguousarray(self._values(np.clip(place, 0.0, 1.0), Y))
        values = values.reshape(cells, G * len(place), -1)
        index = window * n + j - 1
        if len(index) == G * n and np.array_equal(index, np.arange(G * n)):
            # A sample at the end of every piece: nothing to look up.
            return states, values
        found = states[:, index]
        early = np.flatnonzero(j == 0)
        found[:, early] = W[:, window[early]]
        late = np.flatnonzero(left > 1e-7 * piece)
        if late.size:
            found[:, late] = self._remainder(
                nodes, Y[:, window[late]], found[:, late], (j * piece)[late], left[late]
            )
        return found, values[:, window * len(place) + back]

    def _remainder(
        self, nodes: np.ndarray, Y: np.ndarray, w: np.ndarray, begin: np.ndarray, left: np.ndarray
    ) -> np.ndarray:
        """States `left` seconds after the end of a piece."""
        at = (begin[:, None] + left[:, None] * nodes) / self.h
        L = lagrange(self.s, at.ravel()).reshape(*at.shape, self.s)
        C = self._commands(np.matmul(L, Y))
        out = np.empty_like(w)
        times, back = np.unique(left, return_inverse=True)
        weights = self.flow.interval(times, nodes)
        for k, time in enumerate(times):
            i = np.flatnonzero(back == k)
            pushed = self.flow.response(weights[k], C[:, i].reshape(-1, *C.shape[-2:]))
            moved = self.flow.apply(self.flow.exponential(float(time)), w[:, i])
            out[:, i] = moved + pushed.reshape(moved.shape)
        return out


@lru_cache(maxsize=16)
def gauss(q: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss nodes on [0, 1] and the row (1, q) that gives the highest Legendre coefficient."""
    x, w = np.polynomial.legendre.leggauss(q)
    top = 0.5 * (2 * q - 1) * w * np.polynomial.legendre.legvander(x, q - 1)[:, -1]
    return 0.5 * (1.0 + x), top[None]


def _recursion(flow: Flow, piece: float, W: np.ndarray, F: np.ndarray) -> np.ndarray:
    """w at the ends of the n pieces, (cells, G, n, M): w_j = E w_j-1 + f_j; F is overwritten."""
    n = F.shape[2]
    block = next(b for b in range(max(1, int(np.sqrt(n))), 0, -1) if n % b == 0)
    F = F.reshape(*F.shape[:2], n // block, block, F.shape[3])
    powers = [flow.exponential(piece * (j + 1)) for j in range(block)]
    for j in range(1, block):
        F[:, :, :, j] += flow.apply(powers[0], F[:, :, :, j - 1])
    start = np.empty((*F.shape[:3], F.shape[4]), dtype=F.dtype)
    start[:, :, 0] = W
    for k in range(1, n // block):
        start[:, :, k] = flow.apply(powers[-1], start[:, :, k - 1]) + F[:, :, k - 1, -1]
    for j in range(block):
        F[:, :, :, j] += flow.apply(powers[j], start)
    return F.reshape(*F.shape[:2], n, F.shape[4])


def lagrange(s: int, at: np.ndarray) -> np.ndarray:
    """(points, s): node values -> values at points of [0, 1]."""
    return np.polynomial.chebyshev.chebvander(2.0 * at - 1.0, s - 1) @ grid(s).coefficients


def average_commands(system: Semilinear, path: Path, t: np.ndarray, s: int) -> np.ndarray:
    """Averages (T - 1, cells, n_c) of the commands between samples, by exact integrals."""
    edges, Y = np.array(path.edges), np.array(path.y)
    lengths = np.diff(edges)
    C = system.commands(Y)  # (windows, cells, s, n_c)
    running = lengths[:, None, None, None] * (grid(s).integral @ C)
    before = np.concatenate([np.zeros_like(running[:1, :, -1]), running[:, :, -1].cumsum(axis=0)])
    owner = np.clip(np.searchsorted(edges, t, side="left") - 1, 0, len(Y) - 1)
    at = np.clip((t - edges[owner]) / lengths[owner], 0.0, 1.0)
    inside = np.einsum("ts,tksc->tkc", lagrange(s, at), running[owner])
    total = before[owner] + inside
    return np.diff(total, axis=0) / np.diff(t)[:, None, None]
