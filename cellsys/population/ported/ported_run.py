"""Runs of cells on one shared linear field, each cell with its own controller."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg as sla

from cellsys.contracts import Integrator
from cellsys.errors import DimensionError, IntegrationError, ParameterError
from cellsys.integrate.capabilities import ComposesFlows
from cellsys.integrate.simulate import simulate
from cellsys.integrate.splitting import Splitting
from cellsys.integrate.step_runs import StepRun, refuse_integrator
from cellsys.loop import ClosedLoop
from cellsys.loop.blocks import loop_diagram
from cellsys.loop.substeps import SUBSTEPS, headings_inside
from cellsys.model import LatentModel
from cellsys.population.flows import CellFlows, polarities, symbolic_cells
from cellsys.population.headings import commands, loop_of, rates, sensed, steering, turn
from cellsys.population.ported.cells_at_ports import CellsAtPorts
from cellsys.population.ported.plant import linear_plant
from cellsys.population.signals import cell_prefixes
from cellsys.system import Block, Layout, OdeSystem, SymbolicForm
from cellsys.trajectory import Trajectory

if TYPE_CHECKING:
    import casadi as ca
    from control import InterconnectedSystem


class PortFlow:
    """Exact flow of x' = M x + G (b + B c) with c held; x = [z_1 .. z_K, q]."""

    def __init__(self, cells: CellsAtPorts) -> None:
        self.cells = cells
        self.M, G = cells.whole
        K, cell = cells.n_cells, cells.model
        self.n_inputs = cell.B.shape[1]
        self.drive = np.column_stack([G @ np.kron(np.eye(K), cell.B), G @ np.tile(cell.offset, K)])
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
        sensor = self.cells.model.sensor
        if sensor is None:
            raise ParameterError("the cell has no sensor: give CellPort(..., sensor=)")
        return self.states(x) @ sensor.S_d.T


def ported_loop(cells: CellsAtPorts) -> ClosedLoop | None:
    """The polarity loop of every cell, or None without headings or sensor."""
    cell = cells.model
    if cell.dt is None:
        A, B, b = cell.A, cell.B, cell.offset
    else:
        A, B, b = (cell.A - np.eye(cell.order)) / cell.dt, cell.B / cell.dt, cell.offset / cell.dt
    model = LatentModel(A=A, B=B, offset=b, dt=cell.dt, input_names=cell.input_names)
    return loop_of(model, cells.controller, cell.sensor, cells.normalise)


def ported_diagram(cells: CellsAtPorts) -> InterconnectedSystem:
    """See `PortedCells.interconnect`."""
    loop, each = steering(ported_loop(cells)), cell_prefixes(cells.n_cells)
    return loop_diagram(
        linear_plant(cells, None, "input"),
        loop.controller.block(each, dt=cells.model.dt),
        lambda z: sensed(loop, z @ loop.sensor.S_d.T),
        lambda p: commands(loop, p),
        cells=each,
        order=cells.order,
        more=[f"field_q[{i}]" for i in range(int(cells.coupling.field.order))],
    )


def run_ported(
    cells: CellsAtPorts,
    t: np.ndarray,
    integrator: Integrator | None,
    z0: np.ndarray | None,
    p0: np.ndarray | None,
    q0: np.ndarray | None,
) -> Trajectory:
    """See `PortedCells.simulate`."""
    cell, loop = cells.model, ported_loop(cells)
    start = initial(cells, loop, z0, p0, q0)
    label = f"{cells.n_cells} cells on one field"
    if cell.dt is not None:
        steps = PortedSteps(cells=cells, flow=PortFlow(cells), loop=loop, x0=start, dt=cell.dt)
        refuse_integrator(steps, integrator, "cells without dt take any")
        return simulate(steps, None, t, auxiliaries=False, label=label)
    method = Splitting() if integrator is None else integrator
    method = method.of_cells() if isinstance(method, ComposesFlows) else method
    return simulate(ported_system(cells, loop, start), method, t, auxiliaries=False, label=label)


def initial(
    cells: CellsAtPorts,
    loop: ClosedLoop | None,
    z0: np.ndarray | None,
    p0: np.ndarray | None,
    q0: np.ndarray | None,
) -> np.ndarray:
    """z, q and, with a loop, p at the start, as one array."""
    cell, K, m, n = cells.model, cells.n_cells, cells.order, int(cells.coupling.field.order)
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
    return np.concatenate([z.ravel(), q, *([] if loop is None else [p.ravel()])])


def layout(cells: CellsAtPorts, loop: ClosedLoop | None) -> Layout:
    """z (K, m), q and, with a loop, p (K, 3)."""
    K, n = cells.n_cells, int(cells.coupling.field.order)
    blocks = [Block("z", (K, cells.order)), Block("q", (n,), "um", role="field")]
    return Layout(blocks if loop is None else [*blocks, polarities(K)])


class PortedSystem(OdeSystem):
    """Continuous cells on their field: x' = M x + G (b + B c(p)), and polarities behind it."""

    flow: PortFlow
    loop: ClosedLoop | None

    def splitting(self) -> CellFlows:
        """The exact linear flow, and the polarities that turn."""
        return CellFlows(self.flow.cells, self.flow, self.loop, (len(self.flow.M),))

    def observe(self, t: float, x: np.ndarray) -> dict[str, np.ndarray]:
        if self.loop is None:
            return {}
        n = len(self.flow.M)
        d = sensed(self.loop, self.flow.sense(x[:n]))
        return {"p": x[n:].reshape(-1, 3).copy(), "d": d}

    def casadi(self) -> SymbolicForm[ca.MX]:
        """CasADi form of cells and field."""
        cells, M, drive = self.flow.cells, self.flow.M, self.flow.drive
        kept = cells.__dict__.get("_symbolic_form")
        if kept is None:
            K, size = cells.n_cells, cells.n_cells * cells.order
            read = np.eye(size, len(M)), np.zeros(size)
            kept = symbolic_cells(self.loop, K, (M, drive[:, :-1], drive[:, -1]), read)
            cells.__dict__["_symbolic_form"] = kept
        return kept


def ported_system(cells: CellsAtPorts, loop: ClosedLoop | None, start: np.ndarray) -> PortedSystem:
    """Continuous cells and field as an `OdeSystem`."""
    flow = PortFlow(cells)
    n, still = len(flow.M), np.zeros((cells.n_cells, flow.n_inputs))

    def forcing(t: float, x: np.ndarray) -> np.ndarray:
        p = x[n:].reshape(-1, 3)
        c = still if loop is None else commands(loop, p)
        moved = flow.M @ x[:n] + flow.drive @ np.append(c.ravel(), 1.0)
        if loop is None:
            return moved
        d = sensed(loop, flow.sense(x[:n]))
        return np.concatenate([moved, rates(loop.controller, p, d).ravel()])

    system = PortedSystem(states=layout(cells, loop), x0=start, forcing=forcing)
    object.__setattr__(system, "flow", flow)
    object.__setattr__(system, "loop", loop)
    # CasADi's integrators are kept with the cells: they take their start as an argument.
    system.__dict__["_integrators"] = cells.__dict__.setdefault("_integrators", {})
    return system


@dataclass(frozen=True, eq=False, kw_only=True)
class PortedSteps:
    """Cells with a step of their own: midpoint exchange, commands held over each step.

    `inside`: the heading is followed inside each step and commands act by their means.
    """

    cells: CellsAtPorts
    flow: PortFlow
    loop: ClosedLoop | None
    x0: np.ndarray
    dt: float  # step of the cells, s
    inside: bool = False

    @property
    def states(self) -> Layout:
        """z, q and p."""
        return layout(self.cells, self.loop)

    @property
    def better_by(self) -> tuple[str, float]:
        """How `better` is better."""
        own = "the cells' own steps" if self.loop is None else f"heading in {SUBSTEPS} sub-steps"
        return own, 1.0

    def better(self) -> PortedSteps:
        """The heading followed inside each step."""
        return replace(self, inside=True)

    def begin(self) -> PortedRun:
        """A run."""
        return PortedRun(self)

    def step(self, x: np.ndarray, u: np.ndarray | None, t: float) -> np.ndarray:
        """x a step later."""
        n = len(self.flow.M)
        if self.loop is None:
            return self.moved(x, np.zeros((self.cells.n_cells, self.flow.n_inputs)))
        y, p = x[:n], x[n:].reshape(-1, 3)
        ahead = self.moved(y, commands(self.loop, p))
        return np.concatenate([ahead, self.turned(p, self.sensed(y), self.dt).ravel()])

    def moved(self, y: np.ndarray, c: np.ndarray) -> np.ndarray:
        """Cells and field a step later under the commands c (K, n_c)."""
        return self.flow.M @ y + self.flow.drive @ np.append(c.ravel(), 1.0)

    def sensed(self, y: np.ndarray) -> np.ndarray:
        """d (K, 3) of cells and field."""
        return sensed(steering(self.loop), self.flow.sense(y))

    def turned(self, p: np.ndarray, d: np.ndarray, h: float) -> np.ndarray:
        """p after h with d held."""
        return turn(steering(self.loop).controller, p, d, h)


class PortedRun(StepRun):
    """A run of `PortedSteps`: what was sensed a step before, and the bound of the run."""

    system: PortedSteps

    def __init__(self, system: PortedSteps) -> None:
        super().__init__(system)
        self.last: np.ndarray | None = None
        self.limit: float | None = None

    def step(self, x: np.ndarray, u: np.ndarray | None, t: float) -> np.ndarray:
        """x a step later.

        Raises
        ------
        IntegrationError
            With the growth rate, beyond 1e100 times the start.
        """
        system, n = self.system, len(self.system.flow.M)
        if self.limit is None:
            self.limit = 1e100 * max(1.0, float(np.linalg.norm(x[:n])))
        with np.errstate(over="ignore", invalid="ignore"):
            loop = system.loop if system.inside else None
            after = system.step(x, u, t) if loop is None else self._inside(x, loop)
            size = np.linalg.norm(after[:n])
        if not size <= self.limit:
            raise IntegrationError(
                "the coupled cells are unstable and grow at "
                f"{system.cells.pole_set().abscissa:.6g} 1/s",
                time=t + system.dt,
                state_norm=float(size),
                step=system.dt,
            )
        return after

    def _inside(self, x: np.ndarray, loop: ClosedLoop) -> np.ndarray:
        system, n = self.system, len(self.system.flow.M)
        y, p = x[:n], x[n:].reshape(-1, 3)
        d, ahead, end = system.sensed(y), system.moved(y, commands(loop, p)), p
        for _ in range(2):
            three = (self.last, d, system.sensed(ahead))
            angles, end = headings_inside(system.turned, p, three, system.dt)
            each = [commands(loop, np.stack([np.cos(a), np.sin(a)], axis=1)) for a in angles]
            ahead = system.moved(y, np.mean(each, axis=0))
        self.last = d
        return np.concatenate([ahead, end.ravel()])

    def observed(self, marks: np.ndarray, rows: np.ndarray) -> dict[str, np.ndarray]:
        """p and d (T, K, 3)."""
        if self.system.loop is None:
            return {}
        n = len(self.system.flow.M)
        d = np.array([self.system.sensed(row[:n]) for row in rows])
        return {"p": rows[:, n:].reshape(len(rows), -1, 3).copy(), "d": d}
