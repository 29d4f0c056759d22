"""What every matrix field has: energy, tangent, implicit step, simulation, port plant, passivity.

    C q' = F(q) + load,     F = -dU/dq,     q = coordinates of the displacement u = U q

a gradient flow: U' = load . q' - C |q'|^2, passive at any port that takes load E^T f and gives
y = E q' [notes: theory, load ports].
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import TypeVar

import numpy as np
import scipy.sparse as sp

from cellsys.errors import DataError, DimensionError, IntegrationError, ParameterError
from cellsys.field.descent import StepInfo, StepMemory, StepProblem, implicit_step
from cellsys.field.elasticity import MatrixEnergy
from cellsys.field.linear import LinearisedField
from cellsys.field.stepping import FieldSystem
from cellsys.integrate.simulate import simulate
from cellsys.trajectory import Trajectory

_Form = TypeVar("_Form", np.ndarray, sp.csc_array)


class GradientField(LinearisedField[_Form]):
    """Common part of `GalerkinField` and the full field; subclasses give coordinates and solves.

    Attributes
    ----------
    matrix : MatrixEnergy
        Energy and forces of the full-order matrix.
    order : int
        Number of coordinates q.
    modes : (3 n, order)
        U, orthonormal columns; rows of clamped nodes are zero. Dense, or sparse (full field).
    linear : bool
        Quadratic energy at rest instead of the true one.
    slope, tolerance, iterations
        Of the implicit step, see `step`.
    """

    matrix: MatrixEnergy
    order: int
    linear: bool
    slope: float
    tolerance: float
    iterations: int

    # What a subclass gives

    @abstractmethod
    def _lift(self, q: np.ndarray) -> np.ndarray:
        """u = U q (n, 3) of one q (order,)."""

    @abstractmethod
    def _reduce(self, f: np.ndarray) -> np.ndarray:
        """U^T f (order,) of one f (n, 3)."""

    @abstractmethod
    def _compress(self, K: sp.csc_array) -> _Form:
        """U^T K U (order, order) of K (3 n, 3 n)."""

    @abstractmethod
    def _solver(self, K: _Form, shift: float) -> Callable[[np.ndarray], np.ndarray]:
        """Solves (K + shift I) x = r."""

    @abstractmethod
    def displacement(self, q: np.ndarray) -> np.ndarray:
        """u = U q, um: (..., order) to (..., n, 3); velocities and rates alike."""

    # Matrix

    @property
    def drag(self) -> float:
        """C_e of every matrix node, pN s/um."""
        return self.matrix.drag

    @property
    def nodes(self) -> np.ndarray:
        """Rest positions (n, 3) of the matrix nodes, um."""
        return self.matrix.rest

    @property
    def surface(self) -> np.ndarray:
        """Indices of the nodes that cells and external loads can load."""
        return self.matrix.disc.surface

    def loads(self, run: Trajectory, at: str = "average") -> np.ndarray:
        """Nodal loads (T - 1, n, 3), pN, on the matrix in a run of its scene.

        Averages over the sampling intervals as logged, or their values at its "end"; see
        `MatrixEnergy.loads`.
        """
        return self.matrix.loads(run, at)

    # Energy

    @property
    def stiffness(self) -> _Form:
        """Hess U at rest, (order, order), pN/um; symmetric."""
        return self._rest

    @cached_property
    def _rest(self) -> _Form:
        return self._compress(self.matrix.tangent(np.zeros_like(self.nodes)))

    def energy(self, q: np.ndarray) -> float:
        """U(q), pN um, 0 at rest."""
        q = self._checked(q, "q")
        if self.linear:
            return 0.5 * float(q @ (self.stiffness @ q))
        return self.matrix.energy(self._lift(q))

    def force(self, q: np.ndarray) -> np.ndarray:
        """F = -dU/dq (order,), pN."""
        q = self._checked(q, "q")
        if self.linear:
            return -(self.stiffness @ q)
        return self._reduce(self.matrix.force(self._lift(q)))

    def tangent(self, q: np.ndarray) -> _Form:
        """Hess U at q (order, order), pN/um; indefinite where fibres under compression push."""
        q = self._checked(q, "q")
        if self.linear:
            return self.stiffness
        return self._compress(self.matrix.tangent(self._lift(q)))

    # Dynamics

    def memory(self) -> StepMemory:
        """An empty memory for a sequence of steps, see `step`."""
        return StepMemory()

    def step(
        self,
        q: np.ndarray,
        load: np.ndarray,
        dt: float,
        *,
        memory: StepMemory | None = None,
        t: float = 0.0,
    ) -> tuple[np.ndarray, StepInfo]:
        """One implicit Euler step of C q' = F(q) + load, load held over dt.

        Quasi-Newton with one factorisation per dt (C/dt I + K with every fibre at `slope`, or K at
        rest of a linear field), steps shortened where they overshoot, fresh tangents where that
        does not converge. The end satisfies |C (q+ - q)/dt - F(q+) - load| <= tolerance times
        the larger of |load| and |F(q)|, and U(q+) - U(q) <= load . (q+ - q).

        Parameters
        ----------
        q, load : (order,)
            um and pN; ``load = field.project(f)``.
        dt : float
            s.
        memory : StepMemory, optional
            From `memory`, the same one for successive steps: fewer evaluations, same result
            within the tolerance.
        t : float
            Time written into an error, s.

        Raises
        ------
        IntegrationError
            When `iterations` evaluations do not suffice.
        """
        q, load = self._checked(q, "q"), self._checked(load, "load")
        self._check_step(dt)
        if self.linear:
            end = self._kept_solver(dt)((self.drag / dt) * q + load)
            work, gain = float(load @ (end - q)), self.energy(end) - self.energy(q)
            return self._finite(end, q, dt, t), StepInfo(
                iterations=1, residual=0.0, halvings=0, fresh=0, work=work, gain=gain
            )
        problem = StepProblem(
            drag=self.drag,
            energy=self.energy,
            force=self.force,
            kept=self._kept_solver(dt),
            fresh=lambda at: self._fresh_solver(at, dt),
        )
        return implicit_step(
            problem,
            q,
            load,
            dt,
            tolerance=self.tolerance,
            cap=self.iterations,
            memory=StepMemory() if memory is None else memory,
            t=t,
        )

    def simulate(
        self, loads: np.ndarray, dt: float, *, q0: np.ndarray | None = None, every: int = 1
    ) -> Trajectory:
        """Steps from q0 (rest when left out) under loads held over intervals of dt.

        Parameters
        ----------
        loads : (T, n, 3) or (T, order)
            Nodal loads or loads on the coordinates, pN.
        dt : float
            s.
        every : int
            Average this many intervals into one step.

        Returns
        -------
        Trajectory
            State block ``field.modes`` (order,), um; ``field.displacement(run.x)`` are nodes.
            `statistics`: evaluations, fresh tangents, largest residual, least power balance
            (work - gain over the steps, pN um).
        """
        f = self._checked_loads(loads)
        if every < 1 or len(f) % every:
            raise ParameterError(f"every = {every} must divide the {len(f)} intervals of loads")
        f = f.reshape(-1, every, self.order).mean(axis=1)
        h = dt * every
        self._check_step(h)
        q = np.zeros(self.order) if q0 is None else self._checked(q0, "q0")
        system = FieldSystem(self, h, q)
        return simulate(system, None, h * np.arange(len(f) + 1), u=f, label="matrix field")

    # Solves and checks

    @cached_property
    def _bound(self) -> _Form:
        """Hess U with every fibre at `slope`."""
        return self._compress(self.matrix.tangent(np.zeros_like(self.nodes), self.slope))

    @cached_property
    def _solvers(self) -> dict[float, Callable[[np.ndarray], np.ndarray]]:
        """By dt."""
        return {}

    def _kept_solver(self, dt: float) -> Callable[[np.ndarray], np.ndarray]:
        if float(dt) not in self._solvers:
            K = self.stiffness if self.linear else self._bound
            self._solvers[float(dt)] = self._solver(K, self.drag / dt)
        return self._solvers[float(dt)]

    def _fresh_solver(self, q: np.ndarray, dt: float) -> Callable[[np.ndarray], np.ndarray]:
        # Tension only: compression would make it indefinite, and a direction could lead uphill.
        K = self._compress(self.matrix.tangent(self._lift(q), tension_only=True))
        return self._solver(K, self.drag / dt)

    def _checked(self, value: np.ndarray, name: str) -> np.ndarray:
        value = np.asarray(value, dtype=float)
        if value.shape != (self.order,):
            raise DimensionError(f"{name} must have shape ({self.order},), got {value.shape}")
        if not np.isfinite(value.sum()):
            raise DataError(f"{name} holds NaN or inf")
        return value

    def _checked_loads(self, loads: np.ndarray) -> np.ndarray:
        f = np.asarray(loads, dtype=float)
        nodal = f.ndim == 3 and f.shape[1:] == self.nodes.shape
        if not nodal and not (f.ndim == 2 and f.shape[1] == self.order):
            raise DimensionError(
                f"loads must be (T, {len(self.nodes)}, 3) or (T, {self.order}), got {f.shape}"
            )
        if not np.all(np.isfinite(f)):
            raise DataError("loads hold NaN or inf")
        return self.project(f) if nodal else f

    @staticmethod
    def _check_step(dt: float) -> None:
        if not (np.isfinite(dt) and dt > 0):
            raise ParameterError(f"dt must be finite and > 0 s, got {dt!r}")

    def _finite(self, end: np.ndarray, q: np.ndarray, dt: float, t: float) -> np.ndarray:
        if not np.all(np.isfinite(end)):
            raise IntegrationError(
                "the matrix field left the finite numbers; take smaller loads",
                time=t,
                state_norm=float(np.linalg.norm(q)),
                step=dt,
            )
        return end
