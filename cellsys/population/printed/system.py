"""Coupled cells as an `OdeSystem`, for any integrator and any weights.

The state is x with z = T x + offset (see `cellsys.population.printed.blocks`), so that no inverse
of a small number is formed, and the polarities p.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from cellsys.errors import MemoryBudgetError, NotSymbolicError, ParameterError
from cellsys.population.flows import CellFlows, polarities, symbolic_cells
from cellsys.population.graph import InteractionGraph
from cellsys.population.headings import commands, rates, sensed, steering
from cellsys.population.printed.printed_cells import PrintedCells
from cellsys.population.printed.propagators import EmergentFlow, rest_offset
from cellsys.store.memory import check_memory
from cellsys.system import Block, Layout, OdeSystem, SymbolicForm

if TYPE_CHECKING:
    import casadi as ca

SYMBOLIC_LIMIT = 1000  # K m


class Whole:
    """x' = rate(x, c), z = read(x), x(0) = start(z_isolated), all (K, .), on every route.

    `modal`: x is kept in the coordinates of the graph's modes, where the route has them.
    """

    def __init__(self, cells: PrintedCells, *, modal: bool = False) -> None:
        self.cells, self.modal = cells, modal
        self.A, self.B, self.b = cells.matrices
        self.offset = rest_offset(cells)
        self.free = cells.route.startswith("matrix-free")
        if cells.modes is not None:
            self.parts = EmergentFlow(cells)
        elif self.free and cells.graph is not None:
            self._prepare_free(cells.graph)
        else:
            self.block = cells.blocks()[0]

    def _prepare_free(self, graph: InteractionGraph) -> None:
        cells = self.cells
        w, P, m = sp.csr_array(graph.weights), cells.rank.P, cells.order
        self.w, self.P, self.extra, self.lu = w, P, cells.coupling.extra(m), None
        if not cells.coupling.inverted():
            return
        # I + w (x) P is nonsingular for sure when |w| |P| < 1 in some norm.
        size = float(abs(w).sum(axis=1).max()) * float(np.clip(1 - cells.rank.gap, 0, 1).max())
        if not size < 1:
            raise MemoryBudgetError(
                f"{cells.coupling.name} on the matrix-free route needs I + w (x) P nonsingular, "
                f"shown by row sums of |w| times |P| < 1, and they reach {size:.3g}; scale the "
                "weights down, make them symmetric (graph route), or use Feedback()"
            )
        if self.extra is not None:
            N = sp.eye_array(cells.n_cells * m) + sp.kron(w, P)
            self.lu = spla.splu(sp.csc_array(N))

    def rate(self, x: np.ndarray, c: np.ndarray) -> np.ndarray:
        """dx/dt (K, m)."""
        return self.driven(x, np.column_stack([c, np.ones(len(c))]))

    def driven(self, x: np.ndarray, full: np.ndarray) -> np.ndarray:
        """dx/dt (K, m), linear in x and in the commands with a last column of ones (K, n_c + 1)."""
        if self.cells.modes is not None:
            q = self.parts
            rate = q.act(q.M, self._into(x)) + q.act(q.drive, q.to_modes(full))
            return rate if self.modal else q.to_cells(rate)
        force = full[:, :-1] @ self.B.T + full[:, -1:] * self.b
        if not self.free:
            flat = self.block.M @ x.ravel() + self.block.G @ force.ravel()
            return flat.reshape(x.shape)
        f = x @ self.A.T + force
        if not self.cells.coupling.inverted():
            R = np.eye(len(self.P)) if self.extra is None else np.eye(len(self.P)) + self.extra
            return f + (self.w @ f) @ (R @ self.P).T
        if self.extra is None or self.lu is None:
            return f
        more = (self.w @ f) @ (self.extra @ self.P).T
        return f + self.lu.solve(more.ravel()).reshape(f.shape)

    def _into(self, x: np.ndarray) -> np.ndarray:
        return x if self.modal else self.parts.to_modes(x)

    def read(self, x: np.ndarray) -> np.ndarray:
        """Emergent z (K, m)."""
        if self.free and not self.cells.coupling.inverted():
            return x
        return self.mixed(x) + self.offset

    def mixed(self, x: np.ndarray) -> np.ndarray:
        """T x (K, m): z without its offset."""
        if self.cells.modes is not None:
            return self.parts.to_cells(self.parts.act(self.parts.T, self._into(x)))
        if not self.free:
            return (self.block.T @ x.ravel()).reshape(x.shape)
        if not self.cells.coupling.inverted():
            return x
        return x + (self.w @ x) @ self.P.T

    def sense(self, x: np.ndarray) -> np.ndarray:
        """S_d z (K, 3) of each cell."""
        if self.modal and self.cells.modes is not None:
            return self.parts.sense(x)
        return self.read(x) @ steering(self.cells.loop).sensor.S_d.T

    def start(self, z: np.ndarray) -> np.ndarray:
        """x of isolated latent states z (K, m)."""
        if self.cells.modes is not None:
            x = self.parts.start(z)
            return x if self.modal else self.parts.to_cells(x)
        return z if self.free else (self.block.D @ z.ravel()).reshape(z.shape)

    def matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Dense M, D (n, K n_c), b of x' = M x + D c + b and T of z = T x + offset, n = K m."""
        K, m, n_c = self.cells.n_cells, self.cells.order, self.B.shape[1]
        n, still, rest = K * m, np.zeros((K, n_c + 1)), np.zeros((K, m))
        units = np.eye(n).reshape(n, K, m)
        M = np.column_stack([self.driven(e, still).ravel() for e in units])
        T = np.column_stack([self.mixed(e).ravel() for e in units])
        D = np.empty((n, K * n_c))
        for i in range(K * n_c):
            one = still.copy()
            one[i // n_c, i % n_c] = 1.0
            D[:, i] = self.driven(rest, one).ravel()
        still[:, -1] = 1.0
        return M, D, self.driven(rest, still).ravel(), T


class CoupledSystem(OdeSystem):
    """States x (K, m) and p (K, 3); `observe` gives p and d of every cell."""

    whole: Whole

    def observe(self, t: float, x: np.ndarray) -> dict[str, np.ndarray]:
        cells = self.whole.cells
        if cells.loop is None:
            return {}
        K, m = cells.n_cells, cells.order
        raw = self.whole.sense(x[: K * m].reshape(K, m))
        return {"p": x[K * m :].reshape(K, -1).copy(), "d": sensed(cells.loop, raw)}

    def casadi(self) -> SymbolicForm[ca.MX]:
        """CasADi form of all cells.

        Raises
        ------
        NotSymbolicError
            Above K m = 1000, where its dense matrices are no longer worth it.
        """
        kept = self.__dict__.get("_symbolic_form", self.symbols.get("form"))
        if kept is None:
            cells = self.whole.cells
            K, n = cells.n_cells, cells.n_cells * cells.order
            if n > SYMBOLIC_LIMIT:
                raise NotSymbolicError(
                    f"the symbolic form of coupled cells has dense matrices, up to K m = "
                    f"{SYMBOLIC_LIMIT}, and these have K m = {n}; use Exponential, DOP853 or LSODA"
                )
            M, D, b, T = self.whole.matrices()
            kept = symbolic_cells(cells.loop, K, (M, D, b), (T, self.whole.offset.ravel()))
            self.symbols["form"] = kept
        self.__dict__["_symbolic_form"] = kept
        return kept

    @property
    def symbols(self) -> dict[str, SymbolicForm[ca.MX]]:
        """The form, kept with the cells: it does not depend on where a run starts."""
        kept: dict[type, dict[str, SymbolicForm[ca.MX]]]
        kept = self.whole.cells.__dict__.setdefault("_symbols", {})
        return kept.setdefault(type(self), {})


class EmergentSystem(CoupledSystem):
    """The same in the coordinates of the modes; its samples show emergent z (K, m) and p."""

    @property
    def shown(self) -> Layout:
        """z (K, m) and p (K, 3)."""
        cells = self.whole.cells
        blocks = [Block("z", (cells.n_cells, cells.order))]
        return Layout(blocks if cells.loop is None else [*blocks, polarities(cells.n_cells)])

    def show(self, x: np.ndarray) -> np.ndarray:
        """Emergent z and p (T, .) of states (T, n)."""
        K, m = self.whole.cells.n_cells, self.whole.cells.order
        out = np.empty_like(x)
        for row, shown in zip(x, out, strict=True):
            shown[: K * m] = self.whole.read(row[: K * m].reshape(K, m)).ravel()
        out[:, K * m :] = x[:, K * m :]
        return out


class SplitSystem(EmergentSystem):
    """Of the modal and graph routes, which have exact flows."""

    def splitting(self) -> CellFlows:
        """The exact linear flow, and the polarities that turn."""
        cells, flow = self.whole.cells, self.whole.parts
        return CellFlows(cells, flow, cells.loop, (cells.n_cells, cells.order))


def initial(
    cells: PrintedCells, z0: np.ndarray | None, p0: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Isolated latent start (K, m) and polarities (K, 3)."""
    K, m = cells.n_cells, cells.order
    if z0 is None:
        z0 = cells.model.z_start if cells.model.z_start is not None else np.zeros(m)
    check_memory(
        8.0 * K * (m + 3),
        f"the states of {K} cells need",
        "simulate fewer (poles and stability take any number)",
    )
    z = np.array(np.broadcast_to(np.asarray(z0, dtype=float), (K, m)))
    if p0 is None:
        theta = np.zeros(K) if cells.headings is None else cells.headings
        p0 = np.column_stack([np.cos(theta), np.sin(theta), np.zeros(K)])
    p = np.array(np.broadcast_to(np.asarray(p0, dtype=float), (K, 3)))
    if not (np.all(np.isfinite(z)) and np.all(np.isfinite(p))):
        raise ParameterError("z0 or p0 holds NaN or inf")
    if cells.loop is not None and np.any(np.hypot(p[:, 0], p[:, 1]) == 0.0):
        raise ParameterError("p0 is zero or normal to the substrate for some cell: no heading")
    return z, p


def coupled_system(
    cells: PrintedCells,
    z0: np.ndarray | None = None,
    p0: np.ndarray | None = None,
    *,
    emergent: bool = False,
) -> CoupledSystem:
    """The whole as an `OdeSystem`; without a controller the commands are zero.

    `emergent`: one whose samples are emergent latent states, for `CoupledCells.simulate`.
    """
    K, m = cells.n_cells, cells.order
    z, p = initial(cells, z0, p0)  # first: it refuses what no memory holds
    whole, loop = Whole(cells, modal=emergent), cells.loop
    n_c = whole.B.shape[1]
    blocks = [Block("x", (K, m))]
    start = whole.start(z).ravel()
    if loop is not None:
        blocks.append(polarities(K))
        start = np.concatenate([start, p.ravel()])

    def forcing(t: float, state: np.ndarray) -> np.ndarray:
        x = state[: K * m].reshape(K, m)
        if loop is None:
            return whole.rate(x, np.zeros((K, n_c))).ravel()
        heading = state[K * m :].reshape(K, 3)
        d = sensed(loop, whole.sense(x))
        return np.concatenate(
            [
                whole.rate(x, commands(loop, heading)).ravel(),
                rates(loop.controller, heading, d).ravel(),
            ]
        )

    kind = CoupledSystem
    if emergent:
        kind = EmergentSystem if cells.modes is None else SplitSystem
    system = kind(states=Layout(blocks), x0=start, forcing=forcing)
    object.__setattr__(system, "whole", whole)
    # CasADi's integrators are kept with the cells too: they take their start as an argument.
    integrators = cells.__dict__.setdefault("_integrators_of", {})
    system.__dict__["_integrators"] = integrators.setdefault(kind, {})
    return system


def rightmost_poles(cells: PrintedCells, count: int) -> np.ndarray:
    """Rightmost poles of x' = M x by implicitly restarted Arnoldi iterations (ARPACK)."""
    whole = Whole(cells)
    K, m = cells.n_cells, cells.order
    if not 0 < count < K * m - 1:
        raise ParameterError(f"count must be from 1 to {K * m - 2}, got {count!r}")
    still = np.zeros((K, whole.B.shape[1]))
    whole.b = np.zeros(m)
    if cells.modes is not None:
        whole.parts.drive = np.zeros_like(whole.parts.drive)

    def act(v: np.ndarray) -> np.ndarray:
        return whole.rate(np.asarray(v, float).reshape(K, m), still).ravel()

    operator = spla.LinearOperator((K * m, K * m), matvec=act, dtype=float)
    start = np.random.default_rng(0).standard_normal(K * m)
    found = spla.eigs(operator, k=count, which="LR", v0=start, return_eigenvectors=False)
    return found[np.lexsort((found.imag, -found.real))]
