"""Equivariant cells on one shared field: nonlinear runs, linear poles, one certificate.

Each cell keeps its polarity: p turns exactly by half a step towards the sensed direction before
and after every step of cells and field, in which loads and velocities are exchanged at the
midpoint. What is certified (shapes, loads, field) does not depend on the commands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from cellsys.cell.charged import ChargedModel
from cellsys.cell.on_field import CellsOnField
from cellsys.contracts import Integrator
from cellsys.drawable import Drawable
from cellsys.errors import DimensionError, ParameterError
from cellsys.geometry.surface import convex_triangles
from cellsys.integrate.record import check_times
from cellsys.integrate.simulate import simulate
from cellsys.integrate.step_runs import marks_of, refuse_integrator
from cellsys.loop import PolarityLaw
from cellsys.loop.loop_system import model_error
from cellsys.population.poleset import PoleSet
from cellsys.population.ported.diagram import field_diagram, leaping_start
from cellsys.population.ported.equivariant_system import EquivariantSystem
from cellsys.population.ported.linear_cells import PortedCells
from cellsys.population.ported.placement import Placement
from cellsys.population.ported.plant import moving_plant
from cellsys.population.verdict import CoupledStability
from cellsys.ports.capabilities import CellSensor, steps_itself
from cellsys.ports.polar import frozen_port, polar_gather
from cellsys.system import Block, Layout
from cellsys.trajectory import Trajectory

if TYPE_CHECKING:
    import control
    from control import InterconnectedSystem


@dataclass(frozen=True, eq=False, kw_only=True)
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

    model: ChargedModel
    coupling: Placement
    controller: PolarityLaw | None = None
    sensor: CellSensor | None = None
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
    def dt(self) -> float:
        """Step of cells and field, s."""
        return self.model.dt

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
    def _linear_coupling(self) -> Placement:
        field = self.coupling.field
        return replace(self.coupling, port=polar_gather(self.model, field))

    def pole_set(self, t: float | None = None) -> PoleSet:
        """Poles of shapes, loads and field, frozen at t, 1/s; centroids are set apart."""
        return self.frozen(t).pole_set()

    def poles(self, t: float | None = None) -> np.ndarray:
        """Every pole, frozen at t, 1/s."""
        return self.frozen(t).poles()

    def plant(
        self,
        t: float | None = None,
        *,
        commands: Literal["heading", "harmonics"] = "heading",
        points: np.ndarray | None = None,
        offset: Literal["input", "drop"] = "input",
    ) -> control.StateSpace:
        """Cells, centroids and field frozen at t, linear, as a named `control.StateSpace`.

        A step system (dt of the model) about cells that stand at their places, with amplitude 1
        and the headings of the placement, on a field at rest. It has no controller: headings are
        commanded. Loads stay where the cells stand, which holds as long as they do.

        Parameters
        ----------
        t : float, optional
            s since contact; default the end of training.
        commands : {"heading", "harmonics"}
            Inputs of each cell: ``cell1_amplitude`` (1) and ``cell1_heading`` (rad), about which
            the harmonics are taken linear; or the harmonics themselves, by the names of
            `model.input_names`, in which the plant is exact.
        points : (P, 2) or (P, 3), optional
            um. At the surface node nearest to each, loads ``load1_x, ...`` (pN) are inputs and
            displacements ``matrix1_x, ...`` (um) are outputs.
        offset : {"input", "drop"}
            What is constant: the column of a last input ``one``, which is 1 at all times (inputs
            and outputs are then absolute), or nothing (they are differences).

        Returns
        -------
        StateSpace
            Outputs, after those of `points`: of each cell centroid ``cell1_x, cell1_y`` (um) and
            polarity ``cell1_p_x, cell1_p_y``, and of each cell and its nearest neighbour ``gap1_2``
            (um), the distance of their centroids along the line between their places.
        """
        return moving_plant(
            self.frozen(t),
            self.model,
            self.model.horizon if t is None else t,
            commands=commands,
            points=points,
            offset=offset,
        )

    def stability(self) -> CoupledStability:
        """The certificate: every vertex contractive in one norm, collocated port, passive field.

        It holds for the schedule of the clock and for the nonlinear field as well, whose implicit
        step never gains more energy than the work done on it.
        """
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
        integrator: Integrator | None = None,
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
        integrator : None
            The step is the model's, one implicit step of the field each; another is refused.
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
        instead = "cells.frozen(t) has linear cells frozen at a time"
        refuse_integrator(self, integrator, instead)
        times, K = check_times(t), self.n_cells
        steps = int(marks_of(times, self.dt, "the model")[-1])
        u = self._command(amplitude, "amplitude", steps, 1.0)
        if heading is not None:
            u = np.hstack([u, self._command(heading, "heading", steps, 0.0)])
        p0 = self._headed() if p0 is None else p0
        p = np.array(np.broadcast_to(np.asarray(p0, float), (K, 3)))
        if not np.all(np.isfinite(p)) or np.any(np.hypot(p[:, 0], p[:, 1]) == 0):
            raise ParameterError("p0 must be finite and have a heading for every cell")
        system = self._stepped(z0, p, tolerance, commanded=heading is not None)
        return simulate(
            system,
            None,
            times,
            u=u,
            label=f"{K} equivariant cells on one field",
            model_error=model_error(self.model),
        )

    def _headed(self) -> np.ndarray:
        theta = self.coupling.headings
        return np.column_stack([np.cos(theta), np.sin(theta), np.zeros(self.n_cells)])

    def _stepped(
        self, z0: np.ndarray | None, p: np.ndarray, tolerance: float, *, commanded: bool
    ) -> EquivariantSystem:
        field = self.coupling.field
        if not steps_itself(field):
            raise ParameterError(
                f"a run needs a field that steps itself, and a {type(field).__name__} does not; "
                "use a GalerkinField or a full field"
            )
        return EquivariantSystem(
            whole=CellsOnField(model=self.model, field=field, tolerance=tolerance),
            places=self.coupling.positions[:, :2],
            controller=None if commanded else self.controller,
            sensor=self.sensor,
            normalise=self.normalise,
            start=z0,
            p0=p,
            commanded=commanded,
        )

    def _steered(self) -> PolarityLaw:
        if self.controller is None or self.sensor is None:
            lacking = "a controller" if self.controller is None else "a sensor"
            raise ParameterError(f"these cells have no loop: they lack {lacking}; give couple both")
        return self.controller

    def interconnect(self, *, tolerance: float = 1e-5) -> InterconnectedSystem:
        """Cells, field, controllers and sensors as a diagram of python-control, nonlinear.

        Its step is the model's, time that since contact, the amplitude 1. Started from
        `diagram_start` its ``control.input_output_response`` is `simulate`, step for step, to the
        tolerance of the field's step. Outputs are z of every cell, field_q, p and d.

        Parameters
        ----------
        tolerance : float
            As in `simulate`.
        """
        law = self._steered()
        return field_diagram(self._stepped(None, self._headed(), tolerance, commanded=False), law)

    @property
    def diagram_start(self) -> np.ndarray:
        """State of `interconnect()` at contact.

        z of every cell, the field's coordinates and velocity, and the headings half a step
        before, of which the diagram makes those of the placement.
        """
        law = self._steered()
        return leaping_start(self._stepped(None, self._headed(), 1e-5, commanded=False), law)

    def _command(
        self, value: np.ndarray | None, name: str, steps: int, default: float
    ) -> np.ndarray:
        array = np.asarray(default if value is None else value, dtype=float)
        if array.shape not in ((), (self.n_cells,), (steps, self.n_cells)):
            raise DimensionError(f"{name} must be ({steps}, {self.n_cells}), got {array.shape}")
        if not np.all(np.isfinite(array)):
            raise ParameterError(f"{name} holds NaN or inf")
        return np.array(np.broadcast_to(array, (steps, self.n_cells)))

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
        blocks.append(Block("matrix.displacement", u.shape[1:], "um", role="field"))
        return Trajectory(
            t=run.t,
            x=np.column_stack([nodes.reshape(T, -1), u.reshape(T, -1)]),
            states=Layout(blocks),
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
