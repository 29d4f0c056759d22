"""`GalerkinField`: the matrix as its own passive system on load-response modes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.field.elasticity import MatrixEnergy
from cellsys.field.field import GradientField
from cellsys.field.modes import response_modes
from cellsys.kinds import FILLED, Filled, Seed
from cellsys.mechanics.spreading import SpreadingSystem
from cellsys.trajectory import Trajectory
from cellsys.units import real_array


@checked
@dataclass(frozen=True, eq=False)
class GalerkinField(GradientField[np.ndarray]):
    """Galerkin projection of the matrix's own fibre energy on load-response modes.

        C_e q' = -d/dq U(U q) + U^T f        u = U q, U^T U = I   [notes: theory, matrix field]

    All fibres are evaluated each time; the projected flow is the gradient flow of an energy, hence
    passive at collocated ports.

    Parameters
    ----------
    system : SpreadingSystem
        ``cs.build(scene)`` of any scene on a disc; only its matrix part is used.
    order : int
        Number of modes q.
    linear : bool
        Quadratic energy at rest (and modes from linear responses).
    seed : int
        Of the random places and loads that the modes answer.
    snapshots : runs, or array (k, n, 3), optional
        Displacements that enter the POD besides the responses, with the same total weight.
    places, per_place : int
        Number of places, and of loads at each; None: 180, and as many as modes beyond 200 of them
        (with fewer, the last modes answer single loads).
    slope : float
        Slope of every fibre in the kept factorisation of the implicit step.
    tolerance : float
        Residual of a step over its load; 1e-6 changes a run by less than 1e-4 of its size.
    iterations : int
        Most force evaluations of a step.
    modes : (3 n, order), optional
        Modes to use instead; orthonormal columns, zero at clamped nodes.

    Raises
    ------
    SceneError
        A scene without a matrix or without its elasticity.
    RankError
        More modes asked for than the responses span.
    """

    system: SpreadingSystem = field(repr=False)
    _: KW_ONLY
    order: int = 200
    linear: bool = False
    seed: Seed = 0
    snapshots: np.ndarray | Trajectory | Sequence[np.ndarray | Trajectory] | None = field(
        default=None, repr=False
    )
    places: Filled[int] = FILLED
    per_place: int = 5
    slope: float = 0.85
    tolerance: float = 1e-3
    iterations: int = 200
    modes: Filled[np.ndarray] = field(default=FILLED, repr=False)
    singular_values: np.ndarray | None = field(default=None, init=False, repr=False)
    _rows: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        matrix = MatrixEnergy(self.system)
        if self.places is None:
            many = isinstance(self.order, (int, np.integer)) and self.order > 200
            object.__setattr__(self, "places", int(self.order) if many else 180)
        for name in ("order", "places", "per_place", "iterations"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
                raise ParameterError(f"GalerkinField.{name} must be an integer >= 1, got {value!r}")
        for name, most in (("slope", np.inf), ("tolerance", 1.0)):
            value = getattr(self, name)
            if not (np.isfinite(value) and 0 < value <= most):
                raise ParameterError(
                    f"GalerkinField.{name} must be finite, > 0 and <= {most:g}, got {value!r}"
                )
        if self.modes is None:
            free, s = response_modes(
                matrix,
                int(self.order),
                linear=self.linear,
                seed=self.seed,
                snapshots=self.snapshots,
                places=self.places,
                per_place=self.per_place,
                slope=self.slope,
            )
            modes = np.zeros((3 * matrix.n, free.shape[1]))
            modes[matrix.free] = free
            object.__setattr__(self, "singular_values", s)
        else:
            modes = _given_modes(self.modes, matrix)
        modes.setflags(write=False)
        rows = np.ascontiguousarray(modes[matrix.free])
        rows.setflags(write=False)
        for name, value in (
            ("matrix", matrix),
            ("modes", modes),
            ("order", modes.shape[1]),
            ("_rows", rows),
        ):
            object.__setattr__(self, name, value)

    def truncated(self, order: int, *, linear: bool | None = None) -> GalerkinField:
        """The field on the first `order` of these modes, without computing them again."""
        if not 1 <= order <= self.order:
            raise ParameterError(f"order must be between 1 and {self.order}, got {order}")
        return GalerkinField(
            system=self.system,
            linear=self.linear if linear is None else linear,
            seed=self.seed,
            slope=self.slope,
            tolerance=self.tolerance,
            iterations=self.iterations,
            modes=self.modes[:, :order],
        )

    def project(self, f: np.ndarray) -> np.ndarray:
        """U^T f (..., order), pN, of nodal loads f (..., n, 3)."""
        f = np.asarray(f, dtype=float)
        if f.shape[-2:] != self.nodes.shape:
            raise DimensionError(f"f must be (..., {len(self.nodes)}, 3), got {f.shape}")
        return f.reshape(*f.shape[:-2], -1)[..., self.matrix.free] @ self._rows

    def displacement(self, q: np.ndarray) -> np.ndarray:
        """u = U q (..., n, 3), um, of coordinates q (..., order); velocities alike."""
        q = np.asarray(q, dtype=float)
        if q.shape[-1:] != (self.order,):
            raise DimensionError(f"q must be (..., {self.order}), got {q.shape}")
        out = np.zeros((*q.shape[:-1], 3 * self.matrix.n))
        out[..., self.matrix.free] = q @ self._rows.T
        return out.reshape(*q.shape[:-1], -1, 3)

    def _lift(self, q: np.ndarray) -> np.ndarray:
        # Force and energy are asked for at the same q, one after the other.
        if self._lifted and np.array_equal(self._lifted[0][0], q):
            return self._lifted[0][1]
        u: np.ndarray = np.zeros(3 * self.matrix.n)
        u[self.matrix.free] = self._rows @ q
        u = u.reshape(-1, 3)
        u.setflags(write=False)
        self._lifted[:] = [(np.array(q), u)]
        return u

    @cached_property
    def _lifted(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The last q, and its u."""
        return []

    def _reduce(self, f: np.ndarray) -> np.ndarray:
        return f.ravel()[self.matrix.free] @ self._rows

    def _compress(self, K: sp.csc_array) -> np.ndarray:
        free = self.matrix.free
        small = self._rows.T @ (K[free][:, free] @ self._rows)
        return 0.5 * (small + small.T)

    def _solver(self, K: np.ndarray, shift: float) -> Callable[[np.ndarray], np.ndarray]:
        factor = sla.cho_factor(K + shift * np.eye(len(K)))
        return lambda r: sla.cho_solve(factor, r, check_finite=False)


def _given_modes(modes: np.ndarray, matrix: MatrixEnergy) -> np.ndarray:
    modes = real_array(modes, "modes").copy()
    if modes.ndim != 2 or len(modes) != 3 * matrix.n or modes.shape[1] < 1:
        raise DimensionError(f"modes must be ({3 * matrix.n}, order), got {modes.shape}")
    if not np.all(np.isfinite(modes)):
        raise DataError("modes hold NaN or inf")
    held = np.ones(len(modes), bool)
    held[matrix.free] = False
    if np.any(modes[held]):
        raise DataError("modes move clamped nodes; set those rows to zero")
    off = float(np.abs(modes.T @ modes - np.eye(modes.shape[1])).max())
    if off > 1e-8:
        raise DataError(f"modes are not orthonormal: |U^T U - I| = {off:.1e}, bound 1e-8")
    return modes
