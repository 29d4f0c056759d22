"""The closed polarity loop on an equivariant cell, whose plant follows its clock.

The plant steps by its own dt; the heading turns by the exact law for the mean sensed direction of
the step, and drives the plant from half-way through it: second order in dt in the coupling, exact
in each part. The error of the coupling is estimated by the run of `substeps`.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cellsys.arguments import checked
from cellsys.cell.dynamics import CellState
from cellsys.cell.forecast import watched
from cellsys.cell.model import EquivariantModel
from cellsys.contracts import Integrator
from cellsys.errors import DataError, ParameterError
from cellsys.integrate.estimate import estimate_by
from cellsys.loop.closed_loop import ClosedLoop
from cellsys.loop.loop_system import model_error
from cellsys.loop.polarity import PolarityLaw
from cellsys.loop.substeps import SUBSTEPS, headings_inside
from cellsys.model.network_sensor import LocalSensor
from cellsys.model.sensor import StiffnessSensor
from cellsys.response import Margins, margins
from cellsys.system import Block, Layout
from cellsys.trajectory import Trajectory


@checked
@dataclass(frozen=True, eq=False)
class ScheduledLoop:
    """Equivariant plant, controller and sensor joined.

    Parameters
    ----------
    model : EquivariantModel
    controller : PolarityLaw
    sensor : StiffnessSensor
        Its direction is normalised, as in the full-order model.
    z0, p0 : (m,), (3,)
        Start of `simulate`, at contact.
    """

    model: EquivariantModel
    controller: PolarityLaw
    sensor: StiffnessSensor
    z0: np.ndarray
    p0: np.ndarray

    @property
    def order(self) -> int:
        """m."""
        return self.model.order

    def simulate(
        self,
        t: np.ndarray,
        integrator: Integrator | None = None,
        *,
        amplitude: float | np.ndarray = 1.0,
    ) -> Trajectory:
        """Run the loop from contact; samples at `t` (s, multiples of the model's step).

        Parameters
        ----------
        integrator : None
            The model brings its own step; another one is refused.
        amplitude : float or (K,)
            Lamellipodium amplitude of every step.

        Returns
        -------
        Trajectory
            Its events say when commands, shape or latent state leave the trained range.
        """
        if integrator is not None:
            raise ParameterError(
                f"an equivariant plant steps by itself every {self.model.dt:g} s and takes no "
                f"integrator, got {integrator!r}; use closed_loop(model.at(t)) for a frozen plant"
            )
        dt, t = self.model.dt, np.asarray(t, dtype=float)
        steps = np.round(t / dt).astype(int)
        if t.ndim != 1 or not len(t) or np.any(np.abs(steps * dt - t) > 1e-6) or steps[0] != 0:
            raise ParameterError(f"t must start at 0 and lie on multiples of {dt:g} s")
        if np.any(np.diff(steps) <= 0):
            raise DataError("t must increase")
        K = int(steps[-1])
        drive = np.broadcast_to(np.asarray(amplitude, dtype=float), (K,))
        if not np.all(np.isfinite(drive)):
            raise DataError("amplitude holds NaN or inf")
        began = clock.perf_counter()
        z, p = self._run(drive, self._step)
        d = self.sensor.direction(z)
        heading = np.arctan2(p[:-1, 1], p[:-1, 0])
        states = Layout(
            [Block("z", (self.order,)), Block("p", (3,), "1", "controller", "internal")]
        )
        x = np.concatenate([z, p], axis=1)[steps]

        def better() -> np.ndarray:
            return np.concatenate(self._run(drive, self._finer_steps()), axis=1)[steps]

        return Trajectory(
            t,
            x,
            states,
            p=p[steps][:, None],
            d=d[steps][:, None],
            events=watched(self.model, dt * np.arange(K + 1), z, drive, heading, "the cell"),
            statistics={
                "steps": K,
                "wall_time": clock.perf_counter() - began,
                "estimate_factor": 4.0,
            },
            label="closed loop, equivariant",
            model_error=model_error(self.model),
            estimator=estimate_by(x, better, f"heading in {SUBSTEPS} sub-steps"),
        )

    def _run(self, drive: np.ndarray, step: Callable) -> tuple[np.ndarray, np.ndarray]:
        """States (K + 1, m) and polarities (K + 1, 3) under the amplitudes (K,)."""
        K = len(drive)
        z, p = np.empty((K + 1, self.order)), np.empty((K + 1, 3))
        z[0], p[0] = self.z0, self.p0
        for k in range(K):
            z[k + 1], p[k + 1] = step(z[k], p[k], k * self.model.dt, float(drive[k]))
        return z, p

    def _finer_steps(self) -> Callable:
        """A step like `_step` with the heading followed inside it; for one run."""
        dt, law, last = self.model.dt, self.controller, None

        def step(z: np.ndarray, p: np.ndarray, t: float, amplitude: float) -> tuple:
            nonlocal last
            now, (ahead, _) = self.sensor.direction(z), self._step(z, p, t, amplitude)
            for _ in range(2):
                three = (last, now, self.sensor.direction(ahead))
                angles, end = headings_inside(law.step, p, three, dt)
                ahead = self._moved(z, angles, t, amplitude)
            last = now
            return ahead, end

        return step

    def _step(
        self, z: np.ndarray, p: np.ndarray, t: float, amplitude: float
    ) -> tuple[np.ndarray, np.ndarray]:
        dt, law = self.model.dt, self.controller
        before = self.sensor.direction(z)
        middle = law.step(p, before, 0.5 * dt)
        ahead = self._plant(z, middle, t, amplitude)
        mean = 0.5 * (before + self.sensor.direction(ahead))
        size = float(np.linalg.norm(mean))
        mean = mean / size if size > 0 else before
        return self._plant(z, law.step(p, mean, 0.5 * dt), t, amplitude), law.step(p, mean, dt)

    def _plant(self, z: np.ndarray, p: np.ndarray, t: float, amplitude: float) -> np.ndarray:
        return self._moved(z, np.arctan2(p[1:2], p[:1]), t, amplitude)

    def _moved(self, z: np.ndarray, angles: np.ndarray, t: float, amplitude: float) -> np.ndarray:
        """z after a step under the mean of the harmonics of these headings."""
        dynamics = self.model.dynamics
        state, w = dynamics.split(z), dynamics.clock.weights(t)
        drive = np.full(len(angles), amplitude)
        features = [f.mean(axis=0) for f in dynamics.features(drive, angles)]
        x = dynamics.advance(state, features, w)
        moved = dynamics.moved(state.x[1], x[1], features[1], w)
        return dynamics.join(CellState(tuple(x), state.place + moved))

    def linearize(self, at: float | None = None, *, slower_than: float = 0.0) -> Any:
        """`Linearisation` of the loop with the plant frozen at time `at` (default: the end).

        About the state the loop has then; see `ClosedLoop.linearize` for the rest.
        """
        end = self.model.horizon if at is None else float(at)
        dt = self.model.dt
        steps = round(end / dt)
        if not (np.isfinite(end) and steps >= 0):
            raise ParameterError(f"at must be a time >= 0 s, got {at!r}")
        run = self.simulate(dt * np.arange(steps + 1))
        point = (run.x[-1, : self.order], run.x[-1, self.order :])
        return self.frozen(end, point[0]).linearize(point, slower_than=slower_than)

    def open_loop(self, at: Any = None) -> Any:
        """Return ratio at a `Linearisation` or a time; see `ClosedLoop.open_loop`."""
        point = self.linearize(at) if at is None or isinstance(at, (int, float)) else at
        return self.frozen(self.model.horizon).open_loop(point)

    def margins_along(
        self, times: np.ndarray, *, slower_than: float = 0.0
    ) -> dict[float, Margins]:
        """Margins of the return ratio with the plant frozen at each of the times (s).

        The frozen-time family: what the Bode plot of the loop is early, later, and at the end. A
        loop whose plant varies in time is not proven stable by stable members.
        """
        found = {}
        for t in np.atleast_1d(np.asarray(times, dtype=float)):
            point = self.linearize(float(t), slower_than=slower_than)
            found[float(t)] = margins(self.frozen(float(t)).open_loop(point))
        return found

    def frozen(self, t: float, z: np.ndarray | None = None) -> ClosedLoop:
        """`ClosedLoop` on the plant frozen at t, which any integrator can run.

        A sensor that reads the network is taken linear about z (default: the start).
        """

        plain, sensor = replace(self.model.at(t), z_start=self.z0), self.sensor
        if isinstance(sensor, LocalSensor):
            sensor = sensor.frozen(self.z0 if z is None else z)
        return ClosedLoop(plain, self.controller, sensor, True, self.z0, self.p0)
