"""Runs of cells on one shared linear field, each cell with its own controller."""

from __future__ import annotations

import time as clock
from typing import Any

import numpy as np
import scipy.linalg as sla

from cellsys.errors import DimensionError, IntegrationError, ParameterError
from cellsys.integrate.estimate import estimate_by
from cellsys.integrate.simulate import check_times
from cellsys.loop.substeps import SUBSTEPS, headings_inside
from cellsys.model import LatentModel
from cellsys.population.headings import commands, loop_of, sensed, turn
from cellsys.population.splitting import SplitRun, split_estimate
from cellsys.system import Block, Layout
from cellsys.trajectory import Trajectory


class PortFlow:
    """Exact flow of x' = M x + G (b + B c) with c held; x = [z_1 .. z_K, q]."""

    def __init__(self, cells: Any) -> None:
        self.cells = cells
        self.M, G = cells.whole
        K, cell = cells.n_cells, cells.model
        self.n_inputs = cell.B.shape[1]
        self.drive = np.column_stack(
            [G @ np.kron(np.eye(K), cell.B), G @ np.tile(cell.offset, K)]
        )
        self._kept: dict[float, tuple[np.ndarray, np.ndarray]] = {}

    def flow(self, x: np.ndarray, c: np.ndarray, h: float) -> np.ndarray:
        """x after h."""
        if h not in self._kept:
            n, k = self.drive.shape
            whole = np.zeros((n + k, n + k))
            whole[:n, :n], whole[:n, n:] = h * self.M, h * self.drive
            with np.errstate(over="ignore", invalid="ignore"):
                step = sla.expm(whole)
            if len(self._kept) > 30:
                self._kept.clear()
            self._kept[h] = step[:n, :n], step[:n, n:]
        E, F = self._kept[h]
        return E @ x + F @ np.append(c.ravel(), 1.0)

    def states(self, x: np.ndarray) -> np.ndarray:
        """z (K, m)."""
        K, m = self.cells.n_cells, self.cells.order
        return x[: K * m].reshape(K, m)

    def sense(self, x: np.ndarray) -> np.ndarray:
        """S_d z (K, 3)."""
        return self.states(x) @ self.cells.model.sensor.S_d.T


def ported_loop(cells: Any) -> Any:
    """The polarity loop of every cell, or None without headings or sensor."""
    cell = cells.model
    if cell.dt is None:
        A, B, b = cell.A, cell.B, cell.offset
    else:
        A, B, b = (cell.A - np.eye(cell.order)) / cell.dt, cell.B / cell.dt, cell.offset / cell.dt
    model = LatentModel(A, B=B, offset=b, dt=cell.dt, input_names=cell.input_names)
    return loop_of(model, cells.controller, cell.sensor, cells.normalise)


def run_ported(
    cells: Any, t: Any, integrator: Any, z0: Any, p0: Any, q0: Any
) -> Trajectory:
    """See `PortedCells.simulate`."""
    times = check_times(t)
    cell, K, m = cells.model, cells.n_cells, cells.order
    n = int(cells.coupling.field.order)
    loop = ported_loop(cells)
    z0 = cell.z_start if z0 is None and cell.z_start is not None else z0
    z = np.array(np.broadcast_to(0.0 if z0 is None else np.asarray(z0, float), (K, m)))
    q = np.zeros(n) if q0 is None else np.array(q0, dtype=float)
    theta = cells.coupling.headings
    if p0 is None:
        p0 = np.column_stack([np.cos(theta), np.sin(theta), np.zeros(K)])
    p = np.array(np.broadcast_to(np.asarray(p0, float), (K, 3)))
    if q.shape != (n,):
        raise DimensionError(f"q0 must be ({n},), got {q.shape}")
    if not all(np.all(np.isfinite(v)) for v in (z, q, p)):
        raise ParameterError("z0, q0 or p0 holds NaN or inf")
    flow, start = PortFlow(cells), np.concatenate([z.ravel(), q])

    def march(
        integrator: Any, times: np.ndarray, finer: bool = False
    ) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
        """States (T, K m + n), polarities (T, K, 3) and statistics."""
        if cell.dt is None:
            moving = SplitRun(cells, flow, loop, start, p, integrator)
        else:
            moving = _Steps(cells, flow, loop, start, p, finer)
        rows = [(moving.x, moving.p)]
        for k in range(1, len(times)):
            moving.advance(float(times[k - 1]), float(times[k]))
            rows.append((moving.x, moving.p))
        return *(np.array(v) for v in zip(*rows, strict=True)), moving.statistics

    def whole(states: np.ndarray, headings: np.ndarray, _: Any) -> np.ndarray:
        return states if loop is None else np.column_stack([states, headings.reshape(T, -1)])

    began, T = clock.perf_counter(), len(times)
    states, headings, statistics = march(integrator, times)
    statistics["wall_time"] = clock.perf_counter() - began
    blocks = [Block("z", (K, m)), Block("q", (n,), "um", "field")]
    directions = None
    if loop is not None:
        blocks.append(Block("p", (K, 3), "1", "controller", "internal"))
        directions = np.array([sensed(loop, flow.sense(x)) for x in states])
    x = whole(states, headings, None)
    if cell.dt is None:
        estimator = split_estimate(
            loop, integrator, times, x, lambda second, times: whole(*march(second, times))
        )
    else:
        method = "the cells' own steps" if loop is None else f"heading in {SUBSTEPS} sub-steps"
        estimator = estimate_by(x, lambda: whole(*march(None, times, finer=True)), method)
    return Trajectory(
        times,
        x,
        Layout(blocks),
        p=None if loop is None else headings,
        d=directions,
        statistics=statistics,
        label=f"{K} cells on one field",
        estimator=estimator,
    )


class _Steps:
    """Cells with a step of their own: midpoint exchange, commands held over each step.

    `finer`: the heading is followed inside each step and commands act by their means.
    """

    def __init__(
        self,
        cells: Any,
        flow: PortFlow,
        loop: Any,
        x: np.ndarray,
        p: np.ndarray,
        finer: bool = False,
    ) -> None:
        self.finer, self.last = finer, None
        self.cells, self.flow, self.loop, self.x, self.p = cells, flow, loop, x, p
        self.dt = cells.model.dt
        self.limit = 1e100 * max(1.0, float(np.linalg.norm(x)))
        self.statistics: dict[str, Any] = {"steps": 0}

    def advance(self, t0: float, t1: float) -> None:
        """Move from t0 to t1, a whole number of steps."""
        count = (t1 - t0) / self.dt
        if abs(count - round(count)) > 1e-6 or round(count) < 1:
            raise ParameterError(
                f"t must lie on the cells' grid of {self.dt:g} s, got an interval of {t1 - t0:g} s"
            )
        still = np.zeros((self.cells.n_cells, self.flow.n_inputs))
        for i in range(round(count)):
            with np.errstate(over="ignore", invalid="ignore"):
                if self.loop is None:
                    self.x = self._moved(still)
                else:
                    self._controlled()
            self.statistics["steps"] += 1
            if not np.linalg.norm(self.x) <= self.limit:
                raise IntegrationError(
                    "the coupled cells are unstable and grow at "
                    f"{self.cells.pole_set().abscissa:.6g} 1/s",
                    time=t0 + (i + 1) * self.dt,
                    state_norm=float(np.linalg.norm(self.x)),
                    step=self.dt,
                )

    def _moved(self, c: np.ndarray) -> np.ndarray:
        return self.flow.M @ self.x + self.flow.drive @ np.append(c.ravel(), 1.0)

    def _controlled(self) -> None:
        """x and p a step later."""
        d, ahead = self._sensed(self.x), self._moved(commands(self.loop, self.p))
        if not self.finer:
            self.x, self.p = ahead, turn(self.loop, self.p, d, self.dt)
            return
        for _ in range(2):
            three = (self.last, d, self._sensed(ahead))
            angles, p = headings_inside(self._turn, self.p, three, self.dt)
            each = [commands(self.loop, np.stack([np.cos(a), np.sin(a)], axis=1)) for a in angles]
            ahead = self._moved(np.mean(each, axis=0))
        self.x, self.p, self.last = ahead, p, d

    def _sensed(self, x: np.ndarray) -> np.ndarray:
        return sensed(self.loop, self.flow.sense(x))

    def _turn(self, p: np.ndarray, d: np.ndarray, h: float) -> np.ndarray:
        return turn(self.loop, p, d, h)
