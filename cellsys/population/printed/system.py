"""Coupled cells as an `OdeSystem`, for any integrator and any weights.

The state is x with z = T x + offset (see `cellsys.population.printed.blocks`), so that no inverse
of a small number is formed, and the polarities p.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from cellsys.errors import MemoryBudgetError, ParameterError
from cellsys.population.headings import commands, rates, sensed
from cellsys.population.printed.propagators import Propagators
from cellsys.store.memory import check_memory
from cellsys.system import Block, Layout, OdeSystem


def rest_offset(cells: Any) -> np.ndarray:
    """(K, m): what neighbours add to z besides P z_l when z = 0 is not rest.

    With a centred basis each neighbour adds its mean field, V_phi^T S^-1 mean(phi); zero for
    `Feedback`, which couples rates [notes: theory, superposition].
    """
    model, K = cells.model, cells.n_cells
    if not cells.coupling.inverted() or K == 1:
        return np.zeros((K, cells.order))
    rows = cells.field
    scale = model.scale[rows]
    mean = np.divide(model.mean[rows], scale, out=np.zeros(len(rows)), where=scale > 0)
    step = model.V[rows].T @ mean
    if cells.graph is None:
        return np.tile((K - 1) * step, (K, 1))
    return np.outer(cells.graph.receive(np.ones(K)), step)


class Whole:
    """x' = rate(x, c), z = read(x), x(0) = start(z_isolated), all (K, .), on every route."""

    def __init__(self, cells: Any) -> None:
        self.cells = cells
        self.A, self.B, self.b = cells.matrices
        self.offset = rest_offset(cells)
        self.free = cells.route.startswith("matrix-free")
        if cells.modes is not None:
            self.parts = Propagators(cells)
        elif self.free:
            self._prepare_free()
        else:
            self.block = cells.blocks()[0]

    def _prepare_free(self) -> None:
        cells = self.cells
        w, P, m = sp.csr_array(cells.graph.weights), cells.rank.P, cells.order
        self.w, self.P, self.extra, self.lu = w, P, cells.coupling.extra(m), None
        if not cells.coupling.inverted():
            return
        # I + w (x) P is nonsingular for sure when |w| |P| < 1 in some norm.
        size = float(np.abs(w).sum(axis=1).max()) * float(np.clip(1 - cells.rank.gap, 0, 1).max())
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
        if self.cells.modes is not None:
            q = self.parts
            full = np.column_stack([c, np.ones(len(c))])
            return q.to_cells(q.act(q.M, q.to_modes(x)) + q.act(q.drive, q.to_modes(full)))
        force = c @ self.B.T + self.b
        if not self.free:
            flat = self.block.M @ x.ravel() + self.block.G @ force.ravel()
            return flat.reshape(x.shape)
        f = x @ self.A.T + force
        if not self.cells.coupling.inverted():
            R = np.eye(len(self.P)) if self.extra is None else np.eye(len(self.P)) + self.extra
            return f + (self.w @ f) @ (R @ self.P).T
        if self.extra is None:
            return f
        more = (self.w @ f) @ (self.extra @ self.P).T
        return f + self.lu.solve(more.ravel()).reshape(f.shape)

    def read(self, x: np.ndarray) -> np.ndarray:
        """Emergent z (K, m)."""
        if self.cells.modes is not None:
            q = self.parts
            return q.to_cells(q.act(q.T, q.to_modes(x))) + self.offset
        if not self.free:
            return (self.block.T @ x.ravel()).reshape(x.shape) + self.offset
        if not self.cells.coupling.inverted():
            return x
        return x + (self.w @ x) @ self.P.T + self.offset

    def start(self, z: np.ndarray) -> np.ndarray:
        """x of isolated latent states z (K, m)."""
        if self.cells.modes is not None:
            q = self.parts
            return q.to_cells(q.act(q.D, q.to_modes(z)))
        return z if self.free else (self.block.D @ z.ravel()).reshape(z.shape)


class CoupledSystem(OdeSystem):
    """States x (K, m) and p (K, 3); `observe` gives p and d of every cell."""

    whole: Any

    def observe(self, t: float, x: np.ndarray) -> dict[str, np.ndarray]:
        cells = self.whole.cells
        if cells.loop is None:
            return {}
        z, p = self._parts(x)
        return {"p": p.copy(), "d": self._sensed(z)}

    def _parts(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        K, m = self.whole.cells.n_cells, self.whole.cells.order
        return self.whole.read(x[: K * m].reshape(K, m)), x[K * m :].reshape(K, -1)

    def _sensed(self, z: np.ndarray) -> np.ndarray:
        loop = self.whole.cells.loop
        return sensed(loop, z @ loop.sensor.S_d.T)


def initial(cells: Any, z0: Any, p0: Any) -> tuple[np.ndarray, np.ndarray]:
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


def coupled_system(cells: Any, z0: Any = None, p0: Any = None) -> CoupledSystem:
    """The whole as an `OdeSystem`; without a controller the commands are zero."""
    whole, loop = Whole(cells), cells.loop
    K, m = cells.n_cells, cells.order
    z, p = initial(cells, z0, p0)
    n_c = whole.B.shape[1]
    blocks = [Block("x", (K, m))]
    start = whole.start(z).ravel()
    if loop is not None:
        blocks.append(Block("p", (K, 3), "1", "controller", "internal"))
        start = np.concatenate([start, p.ravel()])

    def forcing(t: float, state: np.ndarray) -> np.ndarray:
        x = state[: K * m].reshape(K, m)
        if loop is None:
            return whole.rate(x, np.zeros((K, n_c))).ravel()
        heading = state[K * m :].reshape(K, 3)
        d = sensed(loop, whole.read(x) @ loop.sensor.S_d.T)
        return np.concatenate(
            [whole.rate(x, commands(loop, heading)).ravel(), rates(loop, heading, d).ravel()]
        )

    system = CoupledSystem(states=Layout(blocks), x0=start, forcing=forcing)
    object.__setattr__(system, "whole", whole)
    return system


def rightmost_poles(cells: Any, count: int) -> np.ndarray:
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
