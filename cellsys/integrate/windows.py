"""Collocation of the slow states of a semilinear system over long windows.

On a window [t, t + h] the slow states y are a polynomial through s Chebyshev nodes, and so are
the commands c(y). What y needs of z at the nodes is exact for such commands:

    o_i = s + S e^{A c_i h} z_n + sum_j Q_ij c_j
    Q_ij = h int_0^c_i S e^{A h (c_i - r)} B l_j(r) dr

so the unknowns are the s values of y; they are found by a Picard iteration with the decay of y
taken implicitly. Windows grow while the last coefficients of y' and c are below the tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import scipy.linalg as sla
from scipy.linalg import lapack

from cellsys.errors import IntegrationError
from cellsys.integrate.semilinear import NODES, DenseFlow, ModalFlow, Semilinear

LARGEST = 1e120  # of a state, beyond which a run is reported as unstable
KEPT = 128  # tables kept with a system
HELD = 3  # windows after a rejected one that do not grow
ROOM = 0.2  # error that a longer window may be foreseen to have, in units of the tolerance
FLOOR = 0.05  # coefficients below this are what the iteration left over


@dataclass(frozen=True, eq=False)
class Grid:
    """Nodes of a window on [0, 1] and what can be worked out without the system."""

    nodes: np.ndarray  # (s,), 0 and 1 among them
    integral: np.ndarray  # (s, s): integrals of the Lagrange polynomials from 0 to each node
    coefficients: np.ndarray  # (s, s): Chebyshev coefficients


@lru_cache(maxsize=32)
def grid(s: int) -> Grid:
    """The grid of s nodes."""
    nodes = 0.5 * (1.0 - np.cos(np.pi * np.arange(s) / (s - 1)))
    nodes[-1] = 1.0
    V = np.polynomial.chebyshev.chebvander(2 * nodes - 1, s - 1)
    coefficients = sla.solve(V, np.eye(s))
    x, w = np.polynomial.legendre.leggauss(s)
    integral = np.empty((s, s))
    for i, c in enumerate(nodes):
        at = np.polynomial.chebyshev.chebvander(c * (x + 1) - 1, s - 1)
        integral[i] = 0.5 * c * (w @ (at @ coefficients))
    return Grid(nodes, integral, coefficients)


@lru_cache(maxsize=64)
def samples(levels: int) -> np.ndarray:
    """Where the kernel is sampled on [0, 1]: NODES Chebyshev nodes on each dyadic piece."""
    x = 0.5 * (1.0 - np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES))
    return np.concatenate([a + (b - a) * x for a, b in _pieces(levels)])


def _pieces(levels: int) -> list[tuple[float, float]]:
    far = 0.5 ** np.arange(levels + 1)
    return list(zip([*(0.5 * far[:-1]), 0.0], far, strict=True))


@lru_cache(maxsize=64)
def convolution(s: int, levels: int) -> np.ndarray:
    """(samples, s, s): kernel samples -> int_0^c_i k(r) l_j(c_i - r) dr, exact for pieces."""
    g, (x, w) = grid(s), np.polynomial.legendre.leggauss((NODES + s) // 2 + 1)
    local = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)[::-1]  # increasing in r
    to_chebyshev = sla.solve(np.polynomial.chebyshev.chebvander(local, NODES - 1), np.eye(NODES))
    out = np.zeros((NODES * (levels + 1), s, s))
    for i, c in enumerate(g.nodes):
        for k, (a, b) in enumerate(_pieces(levels)):
            end = min(b, c)
            if end <= a:
                continue
            r = a + 0.5 * (end - a) * (x + 1)
            inside = 2 * (r - a) / (b - a) - 1
            chi = np.polynomial.chebyshev.chebvander(inside, NODES - 1) @ to_chebyshev
            ell = np.polynomial.chebyshev.chebvander(2 * (c - r) - 1, s - 1) @ g.coefficients
            part = (0.5 * (end - a) * w)[:, None, None] * chi[:, :, None] * ell[:, None, :]
            out[k * NODES : (k + 1) * NODES, i] = part.sum(axis=0)
    return out


def foreseen(size: np.ndarray, factor: float) -> float:
    """Error of a window `factor` times as long, by the decay of the coefficients of this one.

    Coefficients of a function fall as e^{-a k}, where sinh(a) is the distance of its nearest
    singularity over half the window [Trefethen, Approximation Theory and Approximation Practice,
    ch. 8]; on a window twice as long that ratio is half.
    """
    s, falling = len(size), np.maximum.accumulate(size[::-1])[::-1]
    last = int(np.flatnonzero(falling > FLOOR).max(initial=0))
    if last == 0:
        return 0.0
    bottom = max(float(falling[min(last + 1, s - 1)]), FLOOR)
    a = min(np.log(max(float(falling[1]) / bottom, 1.0)) / max(last, 1), 30.0)
    return float(falling[1] * np.exp(-(s - 2) * np.arcsinh(np.sinh(a) / factor)) / s)


@dataclass(frozen=True, eq=False, kw_only=True)
class WindowTable:
    """What a window of length h needs, for one system."""

    observe: np.ndarray  # w (as reals) -> S z at the nodes, (s n_o, .)
    constant: np.ndarray  # (s, n_o): s and the offset b
    Q: np.ndarray  # (s n_o, s n_c)
    E: np.ndarray  # e^{A h}
    end: np.ndarray  # (M, n_c, s): commands -> w at the end


def make_table(
    system: Semilinear, flow: ModalFlow | DenseFlow, h: float, s: int
) -> WindowTable | None:
    """Tables of a window; None when the kernel cannot be resolved over h seconds."""
    levels = flow.levels(h)
    if levels is None:
        return None
    g, T = grid(s), convolution(s, levels)
    kernel = flow.kernel(h * samples(levels))  # (q, M, n_c + 1)
    seen = flow.seen(kernel)
    q, n_o, n_c = seen.shape
    Q = h * (seen.reshape(q, -1).T @ T.reshape(q, -1)).reshape(n_o, n_c, s, s)
    constant = system.s + Q[:, -1].sum(axis=-1).T
    Q = Q[:, :-1].transpose(2, 0, 3, 1).reshape(s * n_o, s * (n_c - 1))
    end = h * np.tensordot(kernel, T[:, -1], axes=(0, 0))
    return WindowTable(
        observe=flow.observer(h * g.nodes),
        constant=constant,
        Q=np.ascontiguousarray(Q),
        E=flow.exponential(h),
        end=end,
    )


@dataclass(kw_only=True)
class Path:
    """The windows of a solved run."""

    edges: list[float] = field(default_factory=list)  # (windows + 1,)
    lengths: list[float] = field(default_factory=list)  # (windows,), equal on one rung
    y: list[np.ndarray] = field(default_factory=list)  # node values (cells, s, n_y)
    w: list[np.ndarray] = field(default_factory=list)  # (cells, M) at every edge
    counts: dict[str, int] = field(
        default_factory=lambda: {
            "steps": 0,
            "rejected": 0,
            "rhs": 0,
            "jacobians": 0,
            "factorisations": 0,
        }
    )


class WindowSolver:
    """Marches windows of s nodes over one semilinear system."""

    def __init__(
        self, system: Semilinear, flow: ModalFlow | DenseFlow, s: int, rtol: float, atol: float
    ) -> None:
        self.system, self.flow, self.s, self.rtol, self.atol = system, flow, s, rtol, atol
        self.grid = grid(s)
        self.made = 0

    def table(self, h: float) -> WindowTable | None:
        """Tables of windows of length h, kept with the system from run to run."""
        kept, key = self.system.tables, (type(self.flow), self.s, h)
        if key not in kept:
            if len(kept) >= KEPT:
                kept.pop(next(iter(kept)))
            kept[key] = make_table(self.system, self.flow, h, self.s)
            self.made += 1
        return kept[key]

    def _newton(self, h: float, Y: np.ndarray, o: np.ndarray, table: WindowTable) -> list:
        """Factorised Jacobian, (s - 1) n_y square, of each cell's collocation residual."""
        c_y, r_y, r_o = self.system.slopes(Y, o)
        s, (cells, _, n_y), n_o = self.s, Y.shape, o.shape[-1]
        n_c = c_y.shape[-2]
        # o sees the commands of every node: (cells, s_i, n_o, s_j, n_y).
        Q = table.Q.reshape(s * n_o, s, n_c).transpose(1, 0, 2)
        seen = np.matmul(Q, c_y).transpose(0, 2, 1, 3).reshape(cells, s, n_o, s * n_y)
        slope = np.matmul(r_o, seen).reshape(cells, s, n_y, s, n_y)
        at = np.arange(s)
        slope[:, at, :, at] += r_y.transpose(1, 0, 2, 3)
        weights = h * self.grid.integral[1:]
        total = np.matmul(weights, slope.reshape(cells, s, -1)).reshape(cells, s - 1, n_y, s, n_y)[
            :, :, :, 1:
        ]
        size = (s - 1) * n_y
        J = np.eye(size) - total.reshape(cells, size, size)
        return [lapack.dgetrf(matrix)[:2] for matrix in J]

    def window(
        self, h: float, w: np.ndarray, y: np.ndarray, guess: np.ndarray, path: Path
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """y at the nodes, w at the end, Chebyshev coefficients (s,); None: not converged.

        The coefficients are the largest of h y' and of c, in units of the tolerance.
        """
        table, system, g = self.table(h), self.system, self.grid
        if table is None:
            return None
        cells, s = len(y), self.s
        real = w.view(float) if np.iscomplexobj(w) else w
        free = (real @ table.observe.T).reshape(cells, s, -1) + table.constant
        Y, start = guess.copy(), y[:, None]
        Y[:, 0] = y
        scale = self.rtol * float(np.abs(y).max()) + self.atol
        weights, before, J = h * g.integral[1:], np.inf, None
        for _ in range(12):
            C = system.commands(Y)
            o = free + (C.reshape(cells, -1) @ table.Q.T).reshape(free.shape)
            F = system.rate(Y, o)
            path.counts["rhs"] += s
            if J is None:
                J = self._newton(h, Y, o, table)
                path.counts["jacobians"] += 1
            residual = start + weights @ F - Y[:, 1:]
            change = np.stack(
                [lapack.dgetrs(*f, r.ravel())[0] for f, r in zip(J, residual, strict=True)]
            ).reshape(residual.shape)
            Y[:, 1:] += change
            size = float(np.abs(change).max())
            # The next change would be smaller by the contraction seen so far.
            rest = size * min(1.0, size / before) if before < np.inf else size
            if rest <= 0.01 * scale:
                break
            if not size < 2.0 * before:
                return None
            before = size
        else:
            return None
        C = system.commands(Y)
        size = np.maximum(
            h * np.abs(g.coefficients @ F).max(axis=(0, 2)) / scale,
            np.abs(g.coefficients @ C).max(axis=(0, 2)) / (self.rtol + self.atol),
        )
        M = table.end.shape[0]
        pushed = (
            table.end[:, -1].sum(axis=-1)
            + C.transpose(0, 2, 1).reshape(cells, -1) @ table.end[:, :-1].reshape(M, -1).T
        )
        return Y, self.flow.apply(table.E, w) + pushed, size

    def run(self, t0: float, t_end: float, unit: float, w: np.ndarray, y: np.ndarray) -> Path:
        """Windows from t0 to t_end; lengths are unit times powers of two, aligned with t0.

        `unit` is the spacing of the samples, where they have one, so that samples fall on equal
        fractions of every window.
        """
        path = Path(edges=[t0], lengths=[], y=[], w=[w])
        t, last, held = t0, None, 0
        h = unit * 2.0 ** np.floor(np.log2(max(self._first(w, y), 1e-12) / unit))
        while t < t_end:
            length = t_end - t if t_end - t < h * (1 + 1e-9) else h
            found = self.window(length, path.w[-1], y, self._extend(last, length, y), path)
            if found is None or found[2][-2:].max() > self.s:
                path.counts["rejected"] += 1
                held = HELD
                short = [f for f in (0.5, 0.25) if found and foreseen(found[2], f) < 1.0]
                allowed = length * (short[0] if short else 0.25 if found else 0.5)
                while h > allowed * (1 + 1e-9):
                    h = 0.5 * h
                if not float(np.abs(path.w[-1]).max(initial=0.0)) < LARGEST:
                    self._fail("the state is not finite; the linear part is unstable", path, t, h)
                if h < 1e-12 * max(abs(t), abs(t_end)) or h < 2.0**-60 * unit:
                    self._fail("the windows shrink to nothing; the law is not smooth", path, t, h)
                continue
            Y, w_end, size = found
            if not (np.isfinite(w_end.sum()) and np.isfinite(Y.sum())):
                self._fail("the state is not finite; the linear part is unstable", path, t, length)
            path.counts["steps"] += 1
            t = t_end if length == t_end - t else t + length
            path.edges.append(t)
            path.lengths.append(length)
            path.y.append(Y)
            path.w.append(w_end)
            y, last, held = Y[:, -1].copy(), (Y, length), max(held - 1, 0)
            # A longer window starts at a multiple of its length: the samples stay aligned.
            for factor in (4.0, 2.0):
                turns = (t - t0) / (factor * h)
                if held or abs(turns - round(turns)) > 1e-6:
                    continue
                if foreseen(size, factor) < ROOM:
                    h = factor * h
                    break
        path.counts["factorisations"] = self.made
        return path

    def again(self, path: Path, finer: WindowSolver) -> tuple[np.ndarray, np.ndarray]:
        """Largest change of y (cells, n_y) and z (cells, m) when solved again on more nodes.

        Each of the two solutions carries its own errors along, so this is the global error of
        the first one, as far as the second is better.
        """
        counted = Path()
        up = between(self.s, finer.s)
        w, y = path.w[0], path.y[0][:, 0]
        worst_y, worst_w = np.zeros(y.shape), []
        for k, Y in enumerate(path.y):
            found = finer.window(path.lengths[k], w, y, up @ Y, counted)
            if found is None:
                shape = (path.w[0].shape[0], self.system.A.shape[0])
                return np.full((shape[0], Y.shape[-1]), np.inf), np.full(shape, np.inf)
            worst_w += self._inside(path.lengths[k], w - path.w[k], found[0], up @ Y, finer)
            other, w, _ = found
            y = other[:, -1].copy()
            change = np.abs(other - up @ Y).max(axis=1)
            worst_y = np.maximum(worst_y, change)
            worst_w.append(w - path.w[k + 1])
        z = np.abs(self.flow.read(np.array(worst_w))).max(axis=0)
        return worst_y, z

    def _inside(
        self, h: float, w: np.ndarray, Y: np.ndarray, coarse: np.ndarray, finer: WindowSolver
    ) -> list[np.ndarray]:
        """What w differs by a quarter, a half and three quarters into a window."""
        table = finer.table(0.25 * h)
        if table is None:
            return []
        g, commands, out = finer.grid, self.system.commands, []
        C = commands(Y) - commands(coarse)
        end = table.end[:, :-1].reshape(len(table.end), -1)
        for quarter in range(3):
            at = 0.5 * (quarter + g.nodes) - 1.0  # of the whole window, in [-1, 1]
            L = np.polynomial.chebyshev.chebvander(at, finer.s - 1) @ g.coefficients
            pushed = (L @ C).transpose(0, 2, 1).reshape(len(C), -1) @ end.T
            w = self.flow.apply(table.E, w) + pushed
            out.append(w)
        return out

    def _first(self, w: np.ndarray, y: np.ndarray) -> float:
        """Half the time in which y would change by its own size, s."""
        o = self.system.s + self.flow.read(w) @ self.system.S.T
        rate = float(np.abs(self.system.rate(y, o)).max())
        size = float(np.abs(y).max())
        return 0.5 * size / rate if rate > 0 and size > 0 else 1e12

    def _fail(self, reason: str, path: Path, t: float, h: float) -> None:
        norm = float(np.linalg.norm(self.flow.read(path.w[-1])))
        raise IntegrationError(f"Exponential: {reason}", time=t, state_norm=norm, step=h)

    def _extend(self, last: tuple[np.ndarray, float] | None, h: float, y: np.ndarray) -> np.ndarray:
        """First guess: the last window's end, levelled off half a window later."""
        if last is None:
            return np.repeat(y[:, None], self.s, axis=1)
        Y, length = last
        tau = np.minimum(self.grid.nodes * (h / length), 0.5)
        at = [0, self.s // 2, -1]
        a, b, c = self.grid.nodes[at] - 1.0
        # The parabola through three nodes of the last window, by Lagrange's formula.
        ell = np.stack(
            [
                (tau - b) * (tau - c) / ((a - b) * (a - c)),
                (tau - a) * (tau - c) / ((b - a) * (b - c)),
                (tau - a) * (tau - b) / ((c - a) * (c - b)),
            ],
            axis=1,
        )
        return ell @ Y[:, at]


@lru_cache(maxsize=64)
def between(s: int, other: int) -> np.ndarray:
    """(other, s): values on a grid of s nodes -> values on a grid of `other` nodes."""
    at = np.polynomial.chebyshev.chebvander(2 * grid(other).nodes - 1, s - 1)
    return at @ grid(s).coefficients
