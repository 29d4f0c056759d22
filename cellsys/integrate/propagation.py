"""From the windows of the slow states to the whole state at every sample.

Inside a window w' = lambda w + B c(t) with a known c. The window is cut into pieces on which c is
a polynomial through q Gauss nodes, so that a piece of b equally spaced samples is one product

    [z_1 .. z_b] = [w, c_1 .. c_q] T

with a table T of the spacing alone. Samples without a common spacing take the end of the piece
before them and one exponential of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache

import numpy as np

from cellsys.integrate.semilinear import Flow, Semilinear
from cellsys.integrate.windows import Path, grid

FEWEST = 16  # pieces of a window that has no samples to be cut at
LONGEST = 32  # samples of a piece
BYTES = 4e6  # of a table T at most
TABLES = 16  # tables T kept with a system
_GAUSS = (3, 4, 6, 8, 10)


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
    edges, lengths = np.array(path.edges), np.array(path.lengths)
    # Cells first: a cell's windows and their pieces then lie one behind the other.
    Y, W = np.stack(path.y, axis=1), np.stack(path.w, axis=1)
    unit = spacing(t)
    if unit is not None and (t[-1] - t[0]) / unit > 4 * len(t):
        unit = None  # most of the grid is not asked for
    index = np.zeros(0) if unit is None else np.round((t - t[0]) / unit).astype(int)
    owner = np.clip(np.searchsorted(edges, t, side="left") - 1, 0, len(path.y) - 1)
    places = [
        (_slice(fast), _slice(slow)) for fast, slow in zip(system.fast, system.slow, strict=True)
    ]
    for h in np.unique(lengths):
        windows = np.flatnonzero(lengths == h)
        group = _Group(system, flow, s, float(h), Y[:, windows], W[:, windows], tolerance)
        steps = 0 if unit is None else round(h / unit)
        if unit is not None and steps >= 1 and abs(h / unit - steps) < 1e-6:
            for which, rows, z, y in group.on_grid(unit, steps):
                begin = round((edges[windows[which]] - t[0]) / unit)
                first, last = np.searchsorted(index, [begin + 1, begin + steps + 1])
                if last - first < steps:  # samples are left out of the grid
                    chosen = index[first:last] - begin - 1 - rows.start
                    inside = (chosen >= 0) & (chosen < z.shape[1])
                    z, y = z[:, chosen[inside]], y[:, chosen[inside]]
                    target: slice | np.ndarray = np.arange(first, last)[inside]
                else:
                    target = slice(first + rows.start, first + rows.stop)
                _write(x, target, places, z, y)
            continue
        mine = np.flatnonzero((lengths[owner] == h) & (t > edges[0]))
        if mine.size:
            found = np.searchsorted(windows, owner[mine])
            z, y = group.anywhere(found, t[mine] - edges[owner[mine]])
            _write(x, mine, places, z, y)


_Part = slice | np.ndarray


def _write(
    x: np.ndarray, rows: _Part, places: list[tuple[_Part, _Part]], z: np.ndarray, y: np.ndarray
) -> None:
    for k, pair in enumerate(places):
        for at, values in zip(pair, (z[k], y[k]), strict=True):
            if isinstance(rows, slice) or isinstance(at, slice):
                x[rows, at] = values
            else:
                x[np.ix_(rows, at)] = values


def _slice(index: np.ndarray) -> _Part:
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


class _Group:
    """Windows of one length h: slow states Y (cells, G, s, n_y), starts W (cells, G, M)."""

    def __init__(
        self,
        system: Semilinear,
        flow: Flow,
        s: int,
        h: float,
        Y: np.ndarray,
        W: np.ndarray,
        tolerance: float,
    ) -> None:
        self.system, self.flow, self.s, self.h = system, flow, s, h
        self.Y, self.W, self.tolerance = Y, W, tolerance

    def _values(self, L: np.ndarray) -> np.ndarray:
        """y (cells, G, points, n_y) by the rows L of `lagrange`."""
        flat = np.swapaxes(self.Y, -1, -2).reshape(-1, self.s) @ L.T
        return np.swapaxes(flat.reshape(*self.Y.shape[:2], self.Y.shape[3], len(L)), -1, -2)

    def _commands(self, y: np.ndarray) -> np.ndarray:
        """[c, 1] (..., n_c + 1)."""
        C = self.system.commands(y)
        return np.concatenate([C, np.ones((*C.shape[:-1], 1))], axis=-1)

    def _nodes(self, begin: float, piece: float, count: int) -> tuple[np.ndarray, np.ndarray, bool]:
        """Gauss nodes of pieces, [c, 1] there (cells, G, count, q, n_c + 1), fine enough?"""
        finest, full = gauss(_GAUSS[-1]), legendre(_GAUSS[-1])
        at = (begin + piece * (np.arange(count)[:, None] + finest)) / self.h
        C = self._commands(self._values(lagrange(self.s, at.ravel())))
        C = C.reshape(*C.shape[:2], count, len(finest), -1)
        size = np.abs(full @ C).max(axis=(0, 1, 2, 4))
        # The two highest coefficients tell how far the polynomial is from the commands.
        enough = [q for q in _GAUSS if size[q - 2 :].max() <= self.tolerance]
        if not enough or enough[0] == _GAUSS[-1]:
            return finest, C, bool(enough)
        nodes = gauss(enough[0])
        return nodes, legendre_at(nodes, len(finest)) @ full @ C, True

    def _march(self, W: np.ndarray, piece: float, nodes: np.ndarray, C: np.ndarray) -> np.ndarray:
        """w (cells, G, count + 1, M) at the starts of the pieces, and at the end of the last."""
        count, flow = C.shape[2], self.flow
        pushed = flow.response(_weights(self.system, flow, piece, nodes), _rows(C))
        pushed = pushed.reshape(*C.shape[:3], -1)
        w = np.empty((*W.shape[:2], count + 1, W.shape[2]), dtype=W.dtype)
        w[:, :, 0], E = W, flow.exponential(piece)
        for j in range(count):
            w[:, :, j + 1] = flow.apply(E, w[:, :, j]) + pushed[:, :, j]
        return w

    def on_grid(
        self, unit: float, steps: int
    ) -> Iterator[tuple[int, slice, np.ndarray, np.ndarray]]:
        """(window, range of its steps, z, y (cells, steps, .)) at the ends of `steps` steps."""
        q, (cells, G) = _GAUSS[-1], self.Y.shape[:2]
        width = (2 * self.flow.size + q * (self.system.B.shape[1] + 1)) * self.system.A.shape[0]
        b = max(1, min(steps, LONGEST, int(BYTES / (8 * width))))
        b = 2 ** int(np.log2(b))
        while b > 1 and not self._nodes(0.0, b * unit, steps // b)[2]:
            b //= 2
        y = self._values(fractions(self.s, steps))
        if b > 1:
            done, W = 0, self.W
            while done < steps:
                if steps - done < b:
                    b = 2 ** int(np.log2(steps - done))
                count = (steps - done) // b
                nodes, C, _ = self._nodes(done * unit, b * unit, count)
                w = self._march(W, b * unit, nodes, C)
                T = _table(self.system, self.flow, unit, b, len(nodes))
                start = np.ascontiguousarray(w[:, :, :-1])
                X = np.concatenate(
                    [
                        (start.view(float) if np.iscomplexobj(w) else start),
                        C.reshape(*C.shape[:3], -1),
                    ],
                    axis=-1,
                )
                z = (X.reshape(-1, X.shape[-1]) @ T).reshape(cells, G, count * b, -1)
                rows = slice(done, done + count * b)
                for g in range(G):
                    yield g, rows, z[:, g], y[:, g, rows]
                done, W = done + count * b, w[:, :, -1]
            return
        # Steps of one sample, or parts of one where a window has few.
        parts = max(1, int(2 ** np.ceil(np.log2(FEWEST / steps))))
        nodes, C, _ = self._nodes(0.0, unit / parts, steps * parts)
        w = self._march(self.W, unit / parts, nodes, C)[:, :, parts::parts]
        for g in range(G):
            yield g, slice(0, steps), self.flow.read(w[:, g]), y[:, g]

    def anywhere(self, window: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """z and y (cells, samples, .) `offset` seconds after the start of their windows."""
        n = 4 * FEWEST
        piece = self.h / n
        nodes, C, _ = self._nodes(0.0, piece, n)
        w = self._march(self.W, piece, nodes, C)
        j = np.minimum(np.floor(offset / piece + 1e-7).astype(int), n)
        found, left = w[:, window, j], offset - j * piece
        late = np.flatnonzero(left > 1e-7 * piece)
        if late.size:
            found[:, late] = self._remainder(
                nodes, window[late], found[:, late], (j * piece)[late], left[late]
            )
        L = lagrange(self.s, np.clip(offset / self.h, 0.0, 1.0))
        y = np.matmul(L[:, None], self.Y[:, window])[:, :, 0]
        return self.flow.read(found), y

    def _remainder(
        self,
        nodes: np.ndarray,
        window: np.ndarray,
        w: np.ndarray,
        begin: np.ndarray,
        left: np.ndarray,
    ) -> np.ndarray:
        """States `left` seconds after the end of a piece."""
        at = (begin[:, None] + left[:, None] * nodes) / self.h
        L = lagrange(self.s, at.ravel()).reshape(*at.shape, self.s)
        C = self._commands(np.matmul(L, self.Y[:, window]))
        out = np.empty_like(w)
        times, back = np.unique(left, return_inverse=True)
        weights = self.flow.interval(times, nodes)
        for k, time in enumerate(times):
            i = np.flatnonzero(back == k)
            pushed = self.flow.response(weights[k], C[:, i].reshape(-1, *C.shape[-2:]))
            moved = self.flow.apply(self.flow.exponential(float(time)), w[:, i])
            out[:, i] = moved + pushed.reshape(moved.shape)
        return out


def _rows(C: np.ndarray) -> np.ndarray:
    return C.reshape(-1, *C.shape[-2:])


def _kept(system: Semilinear, key: tuple, most: int, make: Callable[[], np.ndarray]) -> np.ndarray:
    """An entry of the system's tables; the oldest of its kind is given up above `most`."""
    if key not in system.tables:
        same = [k for k in system.tables if k[0] == key[0]]
        if len(same) >= most:
            system.tables.pop(same[0])
        system.tables[key] = make()
    return system.tables[key]


def _weights(system: Semilinear, flow: Flow, piece: float, nodes: np.ndarray) -> np.ndarray:
    """`flow.interval` of one length, kept with the system."""
    key = ("weights", type(flow), float(piece), len(nodes))
    return _kept(system, key, 8 * TABLES, lambda: flow.interval(np.float64(piece), nodes))


def _table(system: Semilinear, flow: Flow, unit: float, b: int, q: int) -> np.ndarray:
    """T (states as reals + q (n_c + 1), b m): w and commands at q nodes -> z at b samples."""
    key = ("block", type(flow), float(unit), b, q)
    return _kept(system, key, TABLES, lambda: _make_table(system, flow, unit, b, q))


def _make_table(system: Semilinear, flow: Flow, unit: float, b: int, q: int) -> np.ndarray:
    nodes, n_c = gauss(q), system.B.shape[1] + 1
    # The Lagrange polynomials of the piece's nodes are commands like any other on each step.
    at = ((np.arange(b)[:, None] + nodes) / b).ravel()
    basis = legendre_at(at, q) @ legendre(q)
    C = np.einsum("iaj,cd->ijcad", basis.reshape(b, q, q), np.eye(n_c)).reshape(-1, q, n_c)
    pushed = flow.response(_weights(system, flow, unit, nodes), C).reshape(b, q * n_c, -1)
    own = np.eye(flow.start(np.zeros(len(system.A))).view(float).size)
    own = own.view(pushed.dtype)
    state, E = np.concatenate([own, np.zeros((q * n_c, flow.size), pushed.dtype)]), None
    out = np.empty((len(state), b, len(system.A)))
    E = flow.exponential(unit)
    for j in range(b):
        state = flow.apply(E, state)
        state[len(own) :] += pushed[j]
        out[:, j] = flow.read(state)
    return out.reshape(len(state), -1)


@lru_cache(maxsize=16)
def gauss(q: int) -> np.ndarray:
    """Gauss nodes on [0, 1]."""
    return 0.5 * (1.0 + np.polynomial.legendre.leggauss(q)[0])


@lru_cache(maxsize=16)
def legendre(q: int) -> np.ndarray:
    """(q, q): values at the q Gauss nodes of [0, 1] -> Legendre coefficients."""
    w = np.polynomial.legendre.leggauss(q)[1]
    return 0.5 * (2 * np.arange(q)[:, None] + 1) * w * legendre_at(gauss(q), q).T


def legendre_at(at: np.ndarray, q: int) -> np.ndarray:
    """(points, q): Legendre coefficients -> values at points of [0, 1]."""
    return np.polynomial.legendre.legvander(2.0 * at - 1.0, q - 1)


@lru_cache(maxsize=64)
def fractions(s: int, n: int) -> np.ndarray:
    """`lagrange` at 1/n, 2/n, .. 1."""
    return lagrange(s, np.arange(1, n + 1) / n)


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
