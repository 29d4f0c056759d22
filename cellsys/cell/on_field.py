"""Cells on one field: loads scattered, matrix velocity gathered, exchanged at the midpoint.

    cell    x+ = A x + B u - gamma (I + A)/2 C^T y,   f = C (x + x+)/2
    field   C_e (q+ - q)/dt = -grad U(q+) + sum_k E_k^T f_k       y_k = E_k (q+ - q)/dt

E_k scatters and gathers through the same footprint, so every exchange is power-conjugate and

    sum_q dt |x_q|^2 / (2 gamma_q) + U   does not grow without commands  [notes: theory, passivity]

for any number and placement of cells, as long as every block is contractive and the implicit
step of the field does not gain energy.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.cell.charged import ChargedModel
from cellsys.cell.dynamics import CellState
from cellsys.cell.port import Footprint, PortSites
from cellsys.contracts import SteppedField
from cellsys.errors import DataError, DimensionError, IntegrationError
from cellsys.integrate.estimate import EULER
from cellsys.integrate.simulate import simulate
from cellsys.integrate.step_runs import StepRun
from cellsys.kinds import Count
from cellsys.system import Block, Layout
from cellsys.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class PortedState:
    """Cells (whitened charges (K, m_q), places (K, 2)), field coordinates and its velocity."""

    cells: CellState
    q: np.ndarray
    rate: np.ndarray


class Mixing:
    """Anderson acceleration of x = g(x), depth 8: the exchange alone need not contract."""

    def __init__(self) -> None:
        self.points: list[np.ndarray] = []
        self.misses: list[np.ndarray] = []

    def next(self, x: np.ndarray, g: np.ndarray) -> np.ndarray:
        """Next trial after g(x) = g."""
        self.points = [*self.points[-8:], g]
        self.misses = [*self.misses[-8:], g - x]
        if len(self.points) == 1:
            return g
        steps = np.diff(np.array(self.misses), axis=0).T
        weights = sla.lstsq(steps, self.misses[-1], cond=1e-12)[0]
        return g - np.diff(np.array(self.points), axis=0).T @ weights


@checked
@dataclass(frozen=True, eq=False)
class CellsOnField:
    """K cells of one model on one field.

    Parameters
    ----------
    model : EquivariantModel
    field : GalerkinField or FullField
    tolerance : float
        Change of the loads, relative, at which the exchange within a step ends. One pass is
        exact where every gamma is 0.
    cap : int
        Most passes of one step.
    """

    model: ChargedModel
    field: SteppedField
    _: KW_ONLY
    tolerance: float = 1e-5
    cap: Count = 60
    sites: PortSites = dataclasses.field(init=False, repr=False)
    cascade: bool = dataclasses.field(init=False, repr=False)

    def __post_init__(self) -> None:
        sites = PortSites.of(self.field.nodes, self.field.surface)
        object.__setattr__(self, "sites", sites)
        object.__setattr__(self, "cascade", all(b.gamma == 0 for b in self.model.dynamics.blocks))

    def start(self, places: np.ndarray, z: np.ndarray | None = None) -> PortedState:
        """Cells as at contact (or from z (K, m)) at `places` (K, 2) um on a field at rest."""
        places = np.atleast_2d(np.asarray(places, dtype=float))
        if places.shape[1] != 2 or not np.all(np.isfinite(places)):
            raise DataError(f"places must be finite, (K, 2), got shape {places.shape}")
        if z is None:
            if self.model.z_start is None:
                raise DataError("the model has no start; pass z= (K, m)")
            z = np.tile(self.model.z_start, (len(places), 1))
        z = np.array(z, dtype=float)
        if z.shape != (len(places), self.model.order):
            raise DimensionError(f"z must be ({len(places)}, {self.model.order}), got {z.shape}")
        z[:, -2:] = places
        zero = np.zeros(self.field.order)
        return PortedState(self.model.dynamics.split(z), zero, zero)

    def footprints(self, state: PortedState) -> list[Footprint]:
        """Ports of all cells at their places."""
        port = self.model.representation.port
        return [self.sites.under(c, port) for c in state.cells.place]

    def step(
        self,
        state: PortedState,
        amplitude: np.ndarray,
        heading: np.ndarray,
        t: float,
        memory: object = None,
        parts: int = 1,
    ) -> tuple[PortedState, int]:
        """One step from t under amplitude and heading (K,); returns the exchanges it took.

        A heading (n, K) acts by the means of its harmonics. The field takes `parts` steps under
        the same loads.

        Raises
        ------
        IntegrationError
            When the exchange does not settle, or the field's step fails.
        """
        dynamics, dt = self.model.dynamics, self.model.dt
        w = dynamics.clock.weights(t)
        features = dynamics.features(np.broadcast_to(amplitude, heading.shape), heading)
        if heading.ndim == 2:
            features = [f.mean(axis=0) for f in features]
        free = dynamics.advance(state.cells, features, w)
        under = self.footprints(state)

        def pulls(x: list[np.ndarray]) -> list[np.ndarray]:
            """Load coordinates of every charge at the midpoint."""
            return [
                0.5 * (a + b) @ block.C.T
                for a, b, block in zip(state.cells.x, x, dynamics.blocks, strict=True)
            ]

        def back_of(rate: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
            """Cells and load that follow from the field's velocity."""
            x = self._ported(free, self._gather(under, rate), w)
            return x, self._project(under, pulls(x))

        def answer(load: np.ndarray) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
            """Field, cells and load that follow from a load."""
            q = self._field(state.q, load, t, memory, parts)
            return q, *back_of((q - state.q) / dt)

        if self.cascade:
            # The loads do not depend on what they do to the field: one pass is exact.
            load = self._project(under, pulls(free))
            q = self._field(state.q, load, t, memory, parts)
            x, exchanges = free, 1
        else:
            load, exchanges = back_of(state.rate)[1], 1
            q, x, back = answer(load)
            mixing = Mixing()
            while np.linalg.norm(back - load) > self.tolerance * np.linalg.norm(back):
                if exchanges == self.cap:
                    raise IntegrationError(
                        f"cells and field did not settle within {self.cap} exchanges; the loads "
                        f"still change by {np.linalg.norm(back - load):.2g} pN",
                        time=t,
                        state_norm=float(np.linalg.norm(state.q)),
                        step=dt,
                    )
                load = mixing.next(load, back)
                exchanges += 1
                q, x, back = answer(load)
        rate = (q - state.q) / dt
        hats = self.model.representation.port.n_hats
        y = self._gather(under, rate)
        ridden = y[1][:, hats : 2 * hats]
        moved = dynamics.moved(state.cells.x[1], x[1], features[1], w, ridden)
        cells = CellState(tuple(x), state.cells.place + moved)
        return PortedState(cells, q, rate), exchanges

    def _field(
        self, q: np.ndarray, load: np.ndarray, t: float, memory: object, parts: int
    ) -> np.ndarray:
        h = self.model.dt / parts
        for i in range(parts):
            q, _ = self.field.step(q, load, h, memory=memory, t=t + i * h)
        return q

    def _ported(
        self, free: list[np.ndarray], y: dict[int, np.ndarray], w: np.ndarray
    ) -> list[np.ndarray]:
        out = []
        for q, (x, block) in enumerate(zip(free, self.model.dynamics.blocks, strict=True)):
            if block.gamma and block.size:
                A = block.at(w)[0]
                back = y[q] @ block.C
                x = x - 0.5 * block.gamma * (back + back @ A.T)
            out.append(x)
        return out

    def _project(self, under: list[Footprint], f: list[np.ndarray]) -> np.ndarray:
        nodal = np.zeros((len(self.field.nodes), 3))
        for k, footprint in enumerate(under):
            # Nodes under one port are distinct.
            nodal[footprint.nodes] += footprint.scatter({q: part[k] for q, part in enumerate(f)})
        return self.field.project(nodal)

    def _gather(self, under: list[Footprint], rate: np.ndarray) -> dict[int, np.ndarray]:
        velocity = self.field.displacement(rate)
        each = [p.gather(velocity[p.nodes]) for p in under]
        return {q: np.array([y[q] for y in each]) for q in each[0]}

    def storage(self, state: PortedState) -> float:
        """sum_q dt |x_q|^2/(2 gamma_q) + U of the charges that answer to the field, pN um."""
        total = float(self.field.energy(state.q))
        for x, block in zip(state.cells.x, self.model.dynamics.blocks, strict=True):
            if block.gamma:
                total += self.model.dt * float(np.sum(np.abs(x) ** 2)) / (2.0 * block.gamma)
        return total

    def simulate(
        self,
        amplitude: np.ndarray,
        heading: np.ndarray,
        places: np.ndarray,
        *,
        z: np.ndarray | None = None,
        t0: float = 0.0,
    ) -> Trajectory:
        """Run under amplitude and heading (T - 1, K) held over steps of the model.

        States ``z`` (K, m), centroids last, and ``field.modes`` (order,); the statistics have the
        greatest number of `exchanges` in a step.
        """
        state = self.start(places, z)
        K = len(state.cells.place)
        amplitude, heading = (np.asarray(v, dtype=float) for v in (amplitude, heading))
        if amplitude.shape != heading.shape or amplitude.shape[1:] != (K,):
            raise DimensionError(
                f"amplitude and heading must be (T - 1, {K}), got {amplitude.shape} and "
                f"{heading.shape}"
            )
        if not (np.all(np.isfinite(amplitude)) and np.all(np.isfinite(heading))):
            raise DataError("amplitude or heading holds NaN or inf")
        t = t0 + self.model.dt * np.arange(len(amplitude) + 1)
        system = CommandedCells(self, state)
        u = np.hstack([amplitude, heading])
        return simulate(system, None, t, u=u, label=f"{K} commanded cells on one field")

    def layout(self, K: int) -> Layout:
        """z (K, m) and the field's coordinates."""
        order = self.field.order
        return Layout(
            [Block("z", (K, self.model.order)), Block("field.modes", (order,), "um", role="field")]
        )

    def pack(self, state: PortedState) -> np.ndarray:
        """Cells, field and its velocity as one array."""
        z = self.model.dynamics.join(state.cells)
        return np.concatenate([z.ravel(), state.q, state.rate])

    def unpack(self, x: np.ndarray, K: int) -> PortedState:
        """Inverse of `pack`."""
        m, n = self.model.order, self.field.order
        z, q, rate = np.split(x, [K * m, K * m + n])
        return PortedState(self.model.dynamics.split(z.reshape(K, m)), q, rate)


@dataclass(frozen=True, eq=False)
class CommandedCells:
    """Cells on a field as a system with a step of its own; inputs: amplitudes, then headings.

    Parameters
    ----------
    whole : CellsOnField
    start : PortedState
    parts : int
        Steps of the field for one of the cells.
    """

    whole: CellsOnField
    start: PortedState
    parts: int = 1

    @property
    def n_cells(self) -> int:
        """K."""
        return len(self.start.cells.place)

    @property
    def dt(self) -> float:
        """Step of the model, s."""
        return self.whole.model.dt

    @property
    def states(self) -> Layout:
        """z, field, and the field's velocity over the last step."""
        z, q = self.whole.layout(self.n_cells)
        return Layout([z, q, Block("field.rate", q.shape, "um/s", role="field")])

    @property
    def x0(self) -> np.ndarray:
        """The start."""
        return self.whole.pack(self.start)

    @property
    def better_by(self) -> tuple[str, float]:
        """How `better` is better; the error of implicit Euler over its distance to half steps."""
        return "two steps of the field for one", EULER

    def better(self) -> CommandedCells:
        """Half the step of the field."""
        return replace(self, parts=2 * self.parts)

    def begin(self) -> CommandedRun:
        """A run."""
        return CommandedRun(self)

    def step(self, x: np.ndarray, u: np.ndarray | None, t: float) -> np.ndarray:
        """x a step later under u (2 K,); amplitude 1 and heading 0 when left out."""
        return self.begin().step(x, u, t)


class CommandedRun(StepRun):
    """A run: the memory of the field's steps and the most exchanges of one."""

    system: CommandedCells

    def __init__(self, system: CommandedCells) -> None:
        super().__init__(system)
        self.memory, self.exchanges = system.whole.field.memory(), 0

    @property
    def recorded(self) -> Layout:
        """z and field."""
        return self.system.whole.layout(self.system.n_cells)

    def record(self, x: np.ndarray) -> np.ndarray:
        """The states without the field's velocity."""
        return x[: self.recorded.size]

    def step(self, x: np.ndarray, u: np.ndarray | None, t: float) -> np.ndarray:
        """x a step later."""
        system, K = self.system, self.system.n_cells
        a, h = (np.ones(K), np.zeros(K)) if u is None else (u[:K], u[K:])
        begin = system.whole.unpack(x, K)
        state, used = system.whole.step(begin, a, h, t, self.memory, system.parts)
        self.exchanges = max(self.exchanges, used)
        return system.whole.pack(state)

    def statistics(self) -> Mapping[str, float]:
        """Greatest number of exchanges in a step."""
        return {"exchanges": self.exchanges}
