"""Equivariant cells on one field as a system with a step of its own.

States z (K, m), field coordinates q, their velocity over the last step (where the exchange in the
next one begins) and polarities p (K, 3); inputs the amplitudes (K,) and, where headings are
commanded, these (K,).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cellsys.cell.forecast import watched
from cellsys.cell.on_field import CellsOnField, PortedState
from cellsys.integrate.estimate import EULER
from cellsys.integrate.step_runs import StepRun
from cellsys.loop import PolarityLaw
from cellsys.loop.substeps import SUBSTEPS, headings_inside
from cellsys.population.headings import turn
from cellsys.ports.capabilities import CellSensor, FieldReader
from cellsys.system import Block, Event, Layout


@dataclass(frozen=True, eq=False, kw_only=True)
class EquivariantSystem:
    """K cells of one model on one field, each with its polarity.

    Parameters
    ----------
    whole : CellsOnField
    places : (K, 2)
        um, at the start.
    controller : PolarityLaw or None
        None: headings keep their values, or follow the commands.
    sensor : StiffnessSensor, FieldSensor or None
    normalise : bool
    start : (K, m) or None
        z at the start; None: the model's.
    p0 : (K, 3)
    commanded : bool
        The inputs hold headings.
    finer : bool
        Two steps of the field for one, and the heading followed inside each step.
    """

    whole: CellsOnField
    places: np.ndarray
    controller: PolarityLaw | None
    sensor: CellSensor | None
    normalise: bool
    start: np.ndarray | None
    p0: np.ndarray
    commanded: bool
    finer: bool = False

    @property
    def n_cells(self) -> int:
        """K."""
        return len(self.places)

    @property
    def dt(self) -> float:
        """Step of the model, s."""
        return self.whole.model.dt

    @property
    def recorded(self) -> Layout:
        """z, field and p."""
        p = Block("p", (self.n_cells, 3), "1", role="controller", kind="internal")
        return self.whole.layout(self.n_cells) + Layout([p])

    @property
    def states(self) -> Layout:
        """What is recorded, with the field's velocity."""
        z, q, p = self.recorded
        return Layout([z, q, Block("field.rate", q.shape, "um/s", role="field"), p])

    @property
    def x0(self) -> np.ndarray:
        """The start."""
        return self.pack(self.whole.start(self.places, self.start), self.p0)

    def pack(self, state: PortedState, p: np.ndarray) -> np.ndarray:
        """x (n,) of cells, field and polarities."""
        return np.concatenate([self.whole.pack(state), p.ravel()])

    def unpack(self, x: np.ndarray) -> tuple[PortedState, np.ndarray]:
        """Inverse of `pack`."""
        K = self.n_cells
        return self.whole.unpack(x[: -3 * K], K), x[-3 * K :].reshape(K, 3)

    @property
    def better_by(self) -> tuple[str, float]:
        """How `better` is better; the error of implicit Euler over its distance to half steps."""
        return f"two steps of the field for one, heading in {SUBSTEPS} sub-steps", EULER

    def better(self) -> EquivariantSystem:
        """Half the step of the field, headings followed inside each step."""
        return replace(self, finer=True)

    def begin(self) -> EquivariantRun:
        """A run."""
        return EquivariantRun(self)

    def step(self, x: np.ndarray, u: np.ndarray | None, t: float) -> np.ndarray:
        """x a step later."""
        return self.begin().step(x, u, t)

    def sensed(self, state: PortedState, p: np.ndarray) -> np.ndarray:
        """d (K, 3); (K, 0) without a sensor."""
        sensor = self.sensor
        if sensor is None:
            return np.zeros((self.n_cells, 0))
        if isinstance(sensor, FieldReader):
            return sensor.directions(self.whole.field, state.q, state.cells.place, p)
        z = self.whole.model.dynamics.join(state.cells)
        return sensor.direction(z) if self.normalise else sensor.raw(z)


class EquivariantRun(StepRun):
    """A run: the memory of the field's steps, what was sensed, and what events are read from."""

    system: EquivariantSystem

    def __init__(self, system: EquivariantSystem) -> None:
        super().__init__(system)
        self.memory = system.whole.field.memory()
        self.steered = system.controller is not None and system.sensor is not None
        # A sensor of the cell's own state does not look at p.
        self.looks = system.finer or isinstance(system.sensor, FieldReader)
        self.t0, self.exchanges = 0.0, 0
        self.z: list[np.ndarray] = []
        self.d: list[np.ndarray] = []
        self.angles: list[np.ndarray] = []
        self.amplitudes: list[np.ndarray] = []
        self.last: np.ndarray | None = None

    @property
    def recorded(self) -> Layout:
        """z, field and p."""
        return self.system.recorded

    def record(self, x: np.ndarray) -> np.ndarray:
        """The states without the field's velocity."""
        state, p = self.system.unpack(x)
        z = self.system.whole.model.dynamics.join(state.cells)
        if not self.d:
            self._keep(state, self.system.sensed(state, p))
        return np.concatenate([z.ravel(), state.q, p.ravel()])

    def step(self, x: np.ndarray, u: np.ndarray | None, t: float) -> np.ndarray:
        """x a step later."""
        system, dt, K = self.system, self.system.dt, self.system.n_cells
        begin, p = system.unpack(x)
        if not self.angles:
            self.t0 = t
        if not self.d:
            self._keep(begin, system.sensed(begin, p))
        d, parts = self.d[-1], 1 + system.finer
        amplitude = np.ones(K) if u is None else u[:K]
        half = self._turn(p, d, 0.5 * dt) if self.steered else p
        told = u[K:] if u is not None and system.commanded else None
        angle = np.arctan2(half[:, 1], half[:, 0]) if told is None else told
        self.angles.append(angle)
        self.amplitudes.append(amplitude)
        state, used = system.whole.step(begin, amplitude, angle, t, self.memory, parts)
        self.exchanges = max(self.exchanges, used)
        if not self.steered and told is not None:
            p = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(K)])
        end = system.sensed(state, half if self.steered else p)
        if self.steered and system.finer:
            inside, ahead = headings_inside(self._turn, p, (self.last, d, end), dt)
            state, _ = system.whole.step(begin, amplitude, inside, t, self.memory, parts)
            self.last, p = d, ahead
        elif self.steered:
            p = self._turn(half, end, 0.5 * dt)
        self._keep(state, system.sensed(state, p) if self.steered and self.looks else end)
        return system.pack(state, p)

    def _keep(self, state: PortedState, d: np.ndarray) -> None:
        self.z.append(self.system.whole.model.dynamics.join(state.cells))
        self.d.append(d)

    def _turn(self, p: np.ndarray, d: np.ndarray, h: float) -> np.ndarray:
        law = self.system.controller
        return p if law is None else turn(law, p, d, h)

    def observed(self, marks: np.ndarray, rows: np.ndarray) -> dict[str, np.ndarray]:
        """p and, with a sensor, d (T, K, 3)."""
        found = {"p": self.recorded.view(rows, "p").copy()}
        if self.system.sensor is not None:
            found["d"] = np.array([self.d[k] for k in marks])
        return found

    def events(self) -> tuple[Event, ...]:
        """Where a cell leaves the trained range."""
        model = self.system.whole.model
        found: list[Event] = []
        if not self.angles:
            return ()
        t = self.t0 + self.system.dt * np.arange(len(self.z))
        z, drive, angles = (np.array(v) for v in (self.z, self.amplitudes, self.angles))
        for c in range(self.system.n_cells):
            found += watched(model, t, z[:, c], drive[:, c], angles[:, c], f"cell{c + 1}")
        return tuple(sorted(found))

    def statistics(self) -> Mapping[str, float]:
        """Most exchanges of a step, and what an estimate costs over the run."""
        factor = 2.0 if self.system.controller is None else 4.0
        return {"exchanges": self.exchanges, "estimate_factor": factor}
