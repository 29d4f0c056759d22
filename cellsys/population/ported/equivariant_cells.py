"""Equivariant cells on one shared field: nonlinear runs, linear poles, one certificate.

Each cell keeps its polarity: p turns exactly by half a step towards the sensed direction before
and after every step of cells and field, in which loads and velocities are exchanged at the
midpoint. What is certified (shapes, loads, field) does not depend on the commands.
"""

from __future__ import annotations

import time as clock
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from cellsys.cell.forecast import watched
from cellsys.cell.on_field import CellsOnField
from cellsys.contracts import FieldReader
from cellsys.drawable import Drawable
from cellsys.errors import DimensionError, ParameterError
from cellsys.integrate.estimate import EULER, estimate_by
from cellsys.integrate.simulate import check_times
from cellsys.loop import PolarityLaw
from cellsys.loop.loop_system import model_error
from cellsys.loop.substeps import SUBSTEPS, headings_inside
from cellsys.mechanics.geometry.surface import convex_triangles
from cellsys.population.headings import turn
from cellsys.population.poleset import PoleSet
from cellsys.population.ported.linear_cells import PortedCells
from cellsys.population.ported.polar import frozen_port, polar_gather
from cellsys.population.verdict import CoupledStability
from cellsys.system import Block, Layout
from cellsys.trajectory import Trajectory

FINER = f"two steps of the field for one, heading in {SUBSTEPS} sub-steps"


@dataclass(frozen=True, eq=False)
class EquivariantCells(Drawable):
    """K equivariant cells on one field. Made by `couple(model, coupling=LoadPorts(...))`.

    Attributes
    ----------
    model : EquivariantModel
    coupling : LoadPorts
        Field, positions and headings.
    controller : PolarityLaw or None
        None: headings keep their values, or follow the commands given to `simulate`.
    sensor : StiffnessSensor, FieldSensor or None
        A `FieldSensor` reads the matrix all cells share, so that they turn to each other's
        strain; the others read the cell's own state.
    normalise : bool
        Scale the sensed direction to unit length.
    """

    model: Any
    coupling: Any
    controller: PolarityLaw | None = None
    sensor: Any = None
    normalise: bool = True

    _figure: ClassVar[str] = "coupled_cells"

    @property
    def n_cells(self) -> int:
        """K."""
        return len(self.coupling.positions)

    @property
    def order(self) -> int:
        """Real latent states of one cell, its centroid among them."""
        return self.model.order

    @property
    def route(self) -> str:
        """Which route the linear questions take."""
        return self.frozen().route

    def frozen(self, t: float | None = None) -> PortedCells:
        """Linear cells frozen at t (s since contact; default the end of training) at their places.

        The field is linear about rest.
        """
        key = "end" if t is None else float(t)
        kept = self.__dict__.setdefault("_frozen", {})
        if key not in kept:
            kept[key] = PortedCells(frozen_port(self.model, t), self._linear_coupling)
        return kept[key]

    @property
    def _linear_coupling(self) -> Any:
        from dataclasses import replace

        field = self.coupling.field
        return replace(self.coupling, port=polar_gather(self.model, field))

    def pole_set(self, t: float | None = None) -> PoleSet:
        """Poles of shapes, loads and field, frozen at t, 1/s; centroids are set apart."""
        return self.frozen(t).pole_set()

    def poles(self, t: float | None = None) -> np.ndarray:
        """Every pole, frozen at t, 1/s."""
        return self.frozen(t).poles()

    def plant(self, t: float | None = None) -> Any:
        """The frozen system as `control.StateSpace` with the model's step; no commands."""
        return self.frozen(t).plant()

    def stability(self) -> CoupledStability:
        """The certificate: every vertex contractive in one norm, collocated port, passive field.

        It holds for the schedule of the clock and for the nonlinear field as well, whose implicit
        step never gains more energy than the work done on it.
        """
        from dataclasses import replace

        report = self.frozen().stability()
        norm, index = self.model.dynamics.norm(), self.model.dynamics.passivity_index()
        text = f"greatest norm of a vertex {norm:.9g}, port index {index:.2g} over all vertices"
        if not report.verdict.endswith("every placement"):
            return replace(report, reason=f"{report.reason}; {text}")
        if norm > 1.0 + 1e-12:
            return replace(
                report,
                verdict="not decided",
                reason=f"a vertex of the schedule is not contractive: {text}",
            )
        return replace(report, reason=f"{report.reason}; {text}")

    def simulate(
        self,
        t: np.ndarray,
        integrator: Any = None,
        *,
        z0: np.ndarray | None = None,
        p0: np.ndarray | None = None,
        amplitude: np.ndarray | None = None,
        heading: np.ndarray | None = None,
        tolerance: float = 1e-5,
    ) -> Trajectory:
        """Run cells and field on the grid of the model's step.

        Parameters
        ----------
        t : (T,)
            s since contact, on the model's grid.
        integrator : optional
            Not used: the step is the model's, one implicit step of the field each.
        z0 : (K, m), optional
            Default the model's start at the positions.
        p0 : (K, 3), optional
            Polarities; default from the headings.
        amplitude : (steps, K), optional
            Lamellipodium amplitude; default 1.
        heading : (steps, K), optional
            Commanded headings, rad, instead of the controller; steps of the model's dt.
        tolerance : float
            Relative change of the loads at which the exchange in a step ends.

        Returns
        -------
        Trajectory
            States ``z`` (K, m), ``field.modes`` (order,) and ``p`` (K, 3). Its events say when a
            cell leaves the trained range.
        """
        times = check_times(t)
        dt, K = self.model.dt, self.n_cells
        count = (times - times[0]) / dt
        if np.abs(count - np.round(count)).max() > 1e-6:
            raise ParameterError(f"t must lie on the model's grid of {dt:g} s")
        marks = np.round(count).astype(int)
        steps = int(marks[-1])
        amplitude = self._command(amplitude, "amplitude", steps, 1.0)
        if heading is not None:
            heading = self._command(heading, "heading", steps, 0.0)
        law = self.controller if heading is None else None
        theta = self.coupling.headings
        if p0 is None:
            p0 = np.column_stack([np.cos(theta), np.sin(theta), np.zeros(K)])
        p = np.array(np.broadcast_to(np.asarray(p0, float), (K, 3)))
        if not np.all(np.isfinite(p)) or np.any(np.hypot(p[:, 0], p[:, 1]) == 0):
            raise ParameterError("p0 must be finite and have a heading for every cell")
        whole = CellsOnField(self.model, self.coupling.field, tolerance=tolerance)
        state = whole.start(self.coupling.positions[:, :2], z0)
        begin = (whole, state, p, amplitude, heading, law, times[0], set(marks.tolist()))
        began = clock.perf_counter()
        rows, every, angles, most = self._run(*begin)
        z, q, p_all, d_all = (
            None if rows[0][i] is None else np.array([r[i] for r in rows]) for i in range(4)
        )
        T = len(times)
        events = []
        if getattr(self.model, "monitor", None) is not None:
            when, path = times[0] + dt * np.arange(steps + 1), np.array(every)
            for c in range(K):
                who = f"cell{c + 1}"
                events += watched(
                    self.model, when, path[:, c], amplitude[:, c], angles[:, c], who
                )
        blocks = [
            Block("z", (K, self.order)),
            Block("field.modes", (q.shape[1],), "um", "field"),
            Block("p", (K, 3), "1", "controller", "internal"),
        ]
        x = np.column_stack([z.reshape(T, -1), q, p_all.reshape(T, -1)])

        def better() -> np.ndarray:
            rows = self._run(*begin, finer=True)[0]
            return np.array([np.concatenate([z.ravel(), q, p.ravel()]) for z, q, p, _ in rows])

        return Trajectory(
            times,
            x,
            Layout(blocks),
            p=p_all,
            d=d_all,
            events=tuple(sorted(events)),
            model_error=model_error(self.model),
            statistics={"steps": steps, "exchanges": most,
                        "wall_time": clock.perf_counter() - began,
                        "estimate_factor": 2.0 if law is None else 4.0},
            label=f"{K} equivariant cells on one field",
            estimator=estimate_by(x, better, FINER, share=EULER),
        )  # fmt: skip

    def _run(
        self,
        whole: CellsOnField,
        state: Any,
        p: np.ndarray,
        amplitude: np.ndarray,
        heading: np.ndarray | None,
        law: PolarityLaw | None,
        t0: float,
        wanted: set[int],
        finer: bool = False,
    ) -> tuple[list, list, np.ndarray, int]:
        """Wanted samples (z, q, p, d), z of every step, headings (steps, K), most exchanges.

        `finer`: two steps of the field for one, and the heading followed inside each step.
        """
        dt, join = self.model.dt, self.model.dynamics.join
        loop, memory = _Loop(law, self.normalise), self.coupling.field.memory()
        rows, every, angles, most = [], [join(state.cells)], np.empty(amplitude.shape), 0
        steered, parts, last = law is not None and self.sensor is not None, 1 + finer, None

        def move(p: np.ndarray, d: np.ndarray, h: float) -> np.ndarray:
            return turn(loop, p, d, h)

        d = self._sensed(state, p)
        for k in range(len(amplitude)):
            if k in wanted:
                rows.append((join(state.cells), state.q, p, d))
            half = move(p, d, 0.5 * dt) if steered else p
            angle = np.arctan2(half[:, 1], half[:, 0]) if heading is None else heading[k]
            angles[k] = angle
            t, begin = t0 + k * dt, state
            state, used = whole.step(begin, amplitude[k], angle, t, memory, parts)
            most = max(most, used)
            if not steered and heading is not None:
                p = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(self.n_cells)])
            end = self._sensed(state, half if steered else p)
            if steered and finer:
                inside, ahead = headings_inside(move, p, (last, d, end), dt)
                state, _ = whole.step(begin, amplitude[k], inside, t, memory, parts)
                last, p = d, ahead
            elif steered:
                p = move(half, end, 0.5 * dt)
            # A sensor of the cell's own state does not look at p.
            again = steered and (finer or isinstance(self.sensor, FieldReader))
            d = self._sensed(state, p) if again else end
            every.append(join(state.cells))
        if len(amplitude) in wanted:
            rows.append((join(state.cells), state.q, p, d))
        return rows, every, angles, most

    def _command(self, value: Any, name: str, steps: int, default: float) -> np.ndarray:
        value = default if value is None else value
        array = np.asarray(value, dtype=float)
        if array.shape not in ((), (self.n_cells,), (steps, self.n_cells)):
            raise DimensionError(f"{name} must be ({steps}, {self.n_cells}), got {array.shape}")
        if not np.all(np.isfinite(array)):
            raise ParameterError(f"{name} holds NaN or inf")
        return np.array(np.broadcast_to(array, (steps, self.n_cells)))

    def _sensed(self, state: Any, p: np.ndarray) -> np.ndarray | None:
        if self.sensor is None:
            return None
        if isinstance(self.sensor, FieldReader):
            return self.sensor.directions(self.coupling.field, state.q, state.cells.place, p)
        z = self.model.dynamics.join(state.cells)
        return self.sensor.direction(z) if self.normalise else self.sensor.raw(z)

    def matrix_displacement(self, run: Trajectory) -> np.ndarray:
        """Displacements (T, n, 3) um of the matrix in a run."""
        return self.coupling.field.displacement(run.block("field.modes"))

    def nodes(self, run: Trajectory) -> np.ndarray:
        """Membrane node positions (T, K, n, 3) um in a run."""
        return self.model.nodes(run.block("z"))

    def in_nodes(self, run: Trajectory) -> Trajectory:
        """The run as the full-order model would store it, for the read-outs of `observe`.

        States ``cellK.position`` (n, 3) and ``matrix.displacement`` (N, 3), um; p and d as they
        are. Forces, laws and internal states are not carried.
        """
        nodes, u = self.nodes(run), self.matrix_displacement(run)
        T, K, n = nodes.shape[:3]
        triangles = convex_triangles(self.model.representation.shape.sphere)
        blocks = [Block(f"cell{k + 1}.position", (n, 3), "um") for k in range(K)]
        blocks.append(Block("matrix.displacement", u.shape[1:], "um", "field"))
        return Trajectory(
            run.t,
            np.column_stack([nodes.reshape(T, -1), u.reshape(T, -1)]),
            Layout(blocks),
            p=run.p,
            d=run.d,
            statistics=run.statistics,
            label=run.label,
            model_error=run.model_error,
            geometry={
                "matrix.rest": self.coupling.field.nodes,
                **{f"cell{k + 1}.triangles": triangles for k in range(K)},
            },
        )

    def __str__(self) -> str:
        return (
            f"{self.n_cells} equivariant cells on a field of order {self.coupling.field.order}, "
            f"m = {self.order}\n  {self.frozen().certificate}"
        )


@dataclass(frozen=True)
class _Loop:
    controller: Any
    normalise: bool
