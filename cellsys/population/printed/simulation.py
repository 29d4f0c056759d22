"""Runs of coupled cells: exact linear flow, or an integrator on the whole system."""

from __future__ import annotations

import time as clock
from typing import Any

import numpy as np

from cellsys.errors import ParameterError
from cellsys.integrate.estimate import estimate_of
from cellsys.integrate.simulate import check_times, simulate
from cellsys.loop.loop_system import model_error
from cellsys.population.printed.propagators import Propagators
from cellsys.population.printed.system import coupled_system, initial, rest_offset
from cellsys.population.splitting import SplitRun, split_estimate
from cellsys.store.memory import check_memory
from cellsys.system import Block, Layout
from cellsys.trajectory import Trajectory


def run(
    cells: Any, t: Any, integrator: Any, z0: Any, p0: Any, progress: Any = None
) -> Trajectory:
    """Simulate `CoupledCells`; see `CoupledCells.simulate`."""
    times = check_times(t)
    if cells.modes is None:
        return _through_system(cells, times, integrator, z0, p0)
    K, m, loop = cells.n_cells, cells.order, cells.loop
    z, p = initial(cells, z0, p0)
    width = K * (m + (3 if loop is not None else 0))
    need = 8.0 * len(times) * (width + (6 * K if loop is not None else 0))
    check_memory(need, f"{len(times)} samples of {K} cells need", "sample less often")

    def march(
        integrator: Any, times: np.ndarray, progress: Any = None
    ) -> tuple[np.ndarray, Any, Any, dict[str, Any]]:
        """States (T, width), headings, directions and statistics."""
        moving = SplitRun(cells, flow, loop, flow.start(z), p, integrator)
        T = len(times)
        states = np.empty((T, width))
        headings, directions = (
            (np.empty((T, K, 3)), np.empty((T, K, 3))) if loop is not None else (None, None)
        )
        for k in range(T):
            if k:
                moving.advance(float(times[k - 1]), float(times[k]))
            states[k, : K * m] = flow.emergent(moving.x).ravel()
            if loop is not None:
                states[k, K * m :] = moving.p.ravel()
                headings[k], directions[k] = moving.p, moving.direction()
            if progress is not None:
                progress(k / max(T - 1, 1))
        return states, headings, directions, moving.statistics

    began, flow = clock.perf_counter(), EmergentFlow(cells)
    states, headings, directions, statistics = march(integrator, times, progress)
    return Trajectory(
        times,
        states,
        _layout(cells),
        p=headings,
        d=directions,
        statistics={**statistics, "wall_time": clock.perf_counter() - began},
        label=f"{K} coupled cells, {cells.coupling.name}",
        estimator=split_estimate(
            loop, integrator, times, states, lambda second, times: march(second, times)[0]
        ),
        model_error=model_error(cells.model),
    )


def _layout(cells: Any) -> Layout:
    blocks = [Block("z", (cells.n_cells, cells.order))]
    if cells.loop is not None:
        blocks.append(Block("p", (cells.n_cells, 3), "1", "controller", "internal"))
    return Layout(blocks)


def _through_system(cells: Any, times: np.ndarray, integrator: Any, z0: Any, p0: Any) -> Trajectory:
    """Dense and matrix-free routes: the integrator works on the whole system."""
    if integrator is None:
        raise ParameterError(
            f"the route of these cells is {cells.route}; simulate() needs an integrator there "
            "(DOP853, Radau or LSODA)"
        )
    system = coupled_system(cells, z0, p0)
    K, m = cells.n_cells, cells.order

    def states(run: Trajectory) -> np.ndarray:
        z = np.array([system.whole.read(row[: K * m].reshape(K, m)).ravel() for row in run.x])
        return np.column_stack([z, run.x[:, K * m :]])

    def again(second: Any) -> np.ndarray:
        return states(simulate(system, second, times, auxiliaries=False))

    found = simulate(system, integrator, times, auxiliaries=False)
    x = states(found)
    return Trajectory(
        times,
        x,
        _layout(cells),
        p=found.p,
        d=found.d,
        events=found.events,
        statistics=found.statistics,
        label=f"{K} coupled cells, {cells.coupling.name}",
        estimator=estimate_of(integrator, x, again, None),
        model_error=model_error(cells.model),
    )


class EmergentFlow(Propagators):
    """Propagators with the read-outs of emergent states and of the sensor."""

    def __init__(self, cells: Any) -> None:
        super().__init__(cells)
        self.offset = rest_offset(cells)
        if cells.loop is not None:
            S = cells.loop.sensor.S_d
            self.reader = S @ self.T
            self.shift = self.offset @ S.T

    def start(self, z: np.ndarray) -> np.ndarray:
        """Modal x of isolated latent states (K, m)."""
        return self.act(self.D, self.to_modes(z))

    def emergent(self, x: np.ndarray) -> np.ndarray:
        """z (K, m)."""
        return self.to_cells(self.act(self.T, x)) + self.offset

    def sense(self, x: np.ndarray) -> np.ndarray:
        """S_d z (K, 3)."""
        return self.to_cells(self.act(self.reader, x)) + self.shift
