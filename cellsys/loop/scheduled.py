"""The closed polarity loop on an equivariant cell, whose plant follows its clock.

The plant steps by its own dt; the heading turns by the exact law for the mean sensed direction of
the step, and drives the plant from half-way through it: second order in dt in the coupling, exact
in each part. The error of the coupling is estimated by the run of `substeps`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cellsys.arguments import checked
from cellsys.cell.model import EquivariantModel
from cellsys.contracts import Integrator
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.integrate.record import check_times
from cellsys.integrate.simulate import simulate
from cellsys.integrate.step_runs import marks_of, refuse_integrator
from cellsys.loop.blocks import scheduled_diagram
from cellsys.loop.closed_loop import ClosedLoop, Linearisation
from cellsys.loop.loop_system import model_error
from cellsys.loop.polarity import PolarityLaw
from cellsys.loop.scheduled_system import ScheduledSystem
from cellsys.model.network_sensor import LocalSensor
from cellsys.model.sensor import StiffnessSensor
from cellsys.response import Margins, margins
from cellsys.trajectory import Trajectory

if TYPE_CHECKING:
    from control import InterconnectedSystem, StateSpace


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
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
        instead = "use closed_loop(model.at(t)) for a frozen plant"
        refuse_integrator(self.system, integrator, instead)
        times = check_times(t)
        if times[0] != 0:
            raise ParameterError(f"t must start at 0 s, contact; got {times[0]:g} s")
        steps = int(marks_of(times, self.model.dt, "the model")[-1])
        drive = np.asarray(amplitude, dtype=float)
        if drive.shape not in ((), (steps,)):
            raise DimensionError(f"amplitude must be a number or ({steps},), got {drive.shape}")
        if not np.all(np.isfinite(drive)):
            raise DataError("amplitude holds NaN or inf")
        return simulate(
            self.system,
            None,
            times,
            u=np.broadcast_to(drive, (steps,))[:, None],
            label="closed loop, equivariant",
            model_error=model_error(self.model),
        )

    def interconnect(self, *, amplitude: float | None = 1.0) -> InterconnectedSystem:
        """The loop as a diagram of python-control, with the step of the model.

        Blocks: the plant on its clock, the controller, the sensor and what the step of the
        heading needs besides (see `scheduled_diagram`); time is that since contact. Started from
        ``system.x0`` (z, then p) its ``control.input_output_response`` is `simulate`, step for
        step; outputs are z, p and d.

        Parameters
        ----------
        amplitude : float or None
            Lamellipodium amplitude; None makes it an input ``amplitude`` of the diagram.
        """
        if amplitude is not None and not np.isfinite(amplitude):
            raise DataError(f"amplitude must be finite, or None for an input, got {amplitude!r}")
        return scheduled_diagram(
            self.system,
            self.controller,
            self.sensor.direction,
            order=self.order,
            dt=self.model.dt,
            amplitude=amplitude,
            unit=not self.sensor.noise,
        )

    @cached_property
    def system(self) -> ScheduledSystem:
        """The loop as a system with a step of its own, for `simulate`."""
        start = np.concatenate([self.z0, self.p0])
        return ScheduledSystem(
            model=self.model, controller=self.controller, sensor=self.sensor, x0=start
        )

    def linearize(self, at: float | None = None, *, slower_than: float = 0.0) -> Linearisation:
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

    def open_loop(self, at: Linearisation | float | None = None) -> StateSpace:
        """Return ratio at a `Linearisation` or a time; see `ClosedLoop.open_loop`."""
        point = self.linearize(at) if at is None or isinstance(at, (int, float)) else at
        return self.frozen(self.model.horizon).open_loop(point)

    def margins_along(self, times: np.ndarray, *, slower_than: float = 0.0) -> dict[float, Margins]:
        """Margins of the return ratio with the plant frozen at each of the times (s).

        The frozen-time family: what the Bode plot of the loop is early, later, and at the end. A
        loop whose plant varies in time is not proven stable by stable members.
        """
        found = {}
        for t in np.atleast_1d(np.asarray(times, dtype=float)):
            point = self.linearize(float(t), slower_than=slower_than)
            found[float(t)] = margins(point.return_ratio())
        return found

    def frozen(self, t: float, z: np.ndarray | None = None) -> ClosedLoop:
        """`ClosedLoop` on the plant frozen at t, which any integrator can run.

        A sensor that reads the network is taken linear about z (default: the start).
        """

        plain, sensor = replace(self.model.at(t), z_start=self.z0), self.sensor
        if isinstance(sensor, LocalSensor):
            sensor = sensor.frozen(self.z0 if z is None else z)
        return ClosedLoop(
            model=plain,
            controller=self.controller,
            sensor=sensor,
            normalise=True,
            z0=self.z0,
            p0=self.p0,
        )
