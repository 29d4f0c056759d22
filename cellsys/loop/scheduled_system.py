"""A scheduled loop as a system with a step of its own: states [z; p], input the amplitude."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cellsys.cell.dynamics import CellState
from cellsys.cell.forecast import watched
from cellsys.cell.model import EquivariantModel
from cellsys.integrate.step_runs import StepRun
from cellsys.loop.polarity import PolarityLaw
from cellsys.loop.substeps import SUBSTEPS, headings_inside
from cellsys.model.sensor import StiffnessSensor
from cellsys.system import Block, Event, Layout


@dataclass(frozen=True, eq=False, kw_only=True)
class ScheduledSystem:
    """Plant, controller and sensor of a `ScheduledLoop`, a step of the plant at a time.

    Parameters
    ----------
    model : EquivariantModel
    controller : PolarityLaw
    sensor : StiffnessSensor
    x0 : (m + 3,)
        z and p at contact.
    inside : bool
        The heading is followed inside each step: what the error of a run is measured by.
    """

    model: EquivariantModel
    controller: PolarityLaw
    sensor: StiffnessSensor
    x0: np.ndarray
    inside: bool = False

    @property
    def dt(self) -> float:
        """Step of the plant, s."""
        return self.model.dt

    @property
    def states(self) -> Layout:
        """z (m,) and p (3,)."""
        return Layout(
            [
                Block("z", (self.model.order,)),
                Block("p", (3,), "1", role="controller", kind="internal"),
            ]
        )

    @property
    def better_by(self) -> tuple[str, float]:
        """How `better` is better."""
        return f"heading in {SUBSTEPS} sub-steps", 1.0

    def better(self) -> ScheduledSystem:
        """The heading followed inside each step."""
        return ScheduledSystem(
            model=self.model,
            controller=self.controller,
            sensor=self.sensor,
            x0=self.x0,
            inside=True,
        )

    def begin(self) -> ScheduledRun:
        """A run, which keeps what its events are read from."""
        return ScheduledRun(self)

    def step(self, x: np.ndarray, u: np.ndarray | None, t: float) -> np.ndarray:
        """z and p a step later under the amplitude u (1,), 1 when left out."""
        m = self.model.order
        z, p = self.turned(x[:m], x[m:], t, 1.0 if u is None else float(u[0]))
        return np.concatenate([z, p])

    def turned(
        self, z: np.ndarray, p: np.ndarray, t: float, amplitude: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """(z, p) a step later."""
        dt, law = self.model.dt, self.controller
        before = self.sensor.direction(z)
        middle = law.step(p, before, 0.5 * dt)
        ahead = self._plant(z, middle, t, amplitude)
        mean = 0.5 * (before + self.sensor.direction(ahead))
        if not self.sensor.noise:
            size = float(np.linalg.norm(mean))
            mean = mean / size if size > 0 else before
        return self._plant(z, law.step(p, mean, 0.5 * dt), t, amplitude), law.step(p, mean, dt)

    def _plant(self, z: np.ndarray, p: np.ndarray, t: float, amplitude: float) -> np.ndarray:
        return self.moved(z, np.arctan2(p[1:2], p[:1]), t, amplitude)

    def moved(self, z: np.ndarray, angles: np.ndarray, t: float, amplitude: float) -> np.ndarray:
        """z after a step under the mean of the harmonics of these headings."""
        dynamics = self.model.dynamics
        state, w = dynamics.split(z), dynamics.clock.weights(t)
        drive = np.full(len(angles), amplitude)
        features = [f.mean(axis=0) for f in dynamics.features(drive, angles)]
        x = dynamics.advance(state, features, w)
        moved = dynamics.moved(state.x[1], x[1], features[1], w)
        return dynamics.join(CellState(tuple(x), state.place + moved))


class ScheduledRun(StepRun):
    """A run: z, heading and amplitude of every step, and what was sensed a step before."""

    system: ScheduledSystem

    def __init__(self, system: ScheduledSystem) -> None:
        super().__init__(system)
        self.t0 = 0.0
        self.z: list[np.ndarray] = []
        self.p: list[np.ndarray] = []
        self.drive: list[float] = []
        self.last: np.ndarray | None = None

    def step(self, x: np.ndarray, u: np.ndarray | None, t: float) -> np.ndarray:
        """z and p a step later."""
        m, drive = self.system.model.order, 1.0 if u is None else float(u[0])
        z, p = x[:m], x[m:]
        if not self.z:
            self.t0 = t
            self._keep(z, p)
        after = self._inside(z, p, t, drive) if self.system.inside else None
        z, p = self.system.turned(z, p, t, drive) if after is None else after
        self.drive.append(drive)
        self._keep(z, p)
        return np.concatenate([z, p])

    def _keep(self, z: np.ndarray, p: np.ndarray) -> None:
        self.z.append(z)
        self.p.append(p)

    def _inside(self, z: np.ndarray, p: np.ndarray, t: float, drive: float) -> tuple:
        system = self.system
        now, (ahead, end) = system.sensor.direction(z), system.turned(z, p, t, drive)
        for _ in range(2):
            three = (self.last, now, system.sensor.direction(ahead))
            angles, end = headings_inside(system.controller.step, p, three, system.dt)
            ahead = system.moved(z, angles, t, drive)
        self.last = now
        return ahead, end

    def observed(self, marks: np.ndarray, rows: np.ndarray) -> dict[str, np.ndarray]:
        """p and d (T, 1, 3)."""
        m = self.system.model.order
        z = np.array(self.z) if self.z else rows[:, :m]
        d = self.system.sensor.direction(z)
        return {"p": rows[:, None, m:].copy(), "d": d[marks][:, None]}

    def events(self) -> tuple[Event, ...]:
        """Where commands, shape or latent state leave the trained range."""
        if not self.z:
            return ()
        p = np.array(self.p[:-1])
        heading = np.arctan2(p[:, 1], p[:, 0])
        return watched(
            self.system.model,
            self.t0 + self.system.dt * np.arange(len(self.z)),
            np.array(self.z),
            np.array(self.drive),
            heading,
            "the cell",
        )

    def statistics(self) -> Mapping[str, float]:
        """What an estimate costs over the run."""
        return {"estimate_factor": 4.0}
