"""`full_field`: the matrix with all its degrees of freedom, the reference of `GalerkinField`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field

import numpy as np
import scipy.sparse as sp

from cellsys.arguments import checked
from cellsys.errors import DimensionError
from cellsys.field.elasticity import MatrixEnergy
from cellsys.field.field import GradientField
from cellsys.field.modes import symmetric_factor
from cellsys.mechanics.spreading import SpreadingSystem


@checked
@dataclass(frozen=True, eq=False)
class FullField(GradientField[sp.csc_array]):
    """The matrix on its free coordinates: modes are unit vectors, solves are sparse.

    Parameters as in `GalerkinField`; tangents are sparse.
    """

    system: SpreadingSystem = field(repr=False)
    _: KW_ONLY
    linear: bool = False
    slope: float = 0.85
    tolerance: float = 1e-4
    iterations: int = 200

    def __post_init__(self) -> None:
        matrix = MatrixEnergy(self.system)
        free = matrix.free
        ones = (np.ones(len(free)), (free, np.arange(len(free))))
        for name, value in (
            ("matrix", matrix),
            ("order", len(free)),
            ("modes", sp.csc_array(ones, shape=(3 * matrix.n, len(free)))),
        ):
            object.__setattr__(self, name, value)

    def project(self, f: np.ndarray) -> np.ndarray:
        """U^T f (..., order), pN, of nodal loads f (..., n, 3)."""
        f = np.asarray(f, dtype=float)
        if f.shape[-2:] != self.nodes.shape:
            raise DimensionError(f"f must be (..., {len(self.nodes)}, 3), got {f.shape}")
        return f.reshape(*f.shape[:-2], -1)[..., self.matrix.free]

    def displacement(self, q: np.ndarray) -> np.ndarray:
        """u = U q (..., n, 3), um, of coordinates q (..., order); velocities alike."""
        q = np.asarray(q, dtype=float)
        if q.shape[-1:] != (self.order,):
            raise DimensionError(f"q must be (..., {self.order}), got {q.shape}")
        out = np.zeros((*q.shape[:-1], 3 * self.matrix.n))
        out[..., self.matrix.free] = q
        return out.reshape(*q.shape[:-1], -1, 3)

    def _lift(self, q: np.ndarray) -> np.ndarray:
        return self.displacement(q)

    def _reduce(self, f: np.ndarray) -> np.ndarray:
        return f.ravel()[self.matrix.free]

    def _compress(self, K: sp.csc_array) -> sp.csc_array:
        free = self.matrix.free
        return sp.csc_array(K[free][:, free])

    def _solver(self, K: sp.csc_array, shift: float) -> Callable[[np.ndarray], np.ndarray]:
        return symmetric_factor(K + shift * sp.eye_array(K.shape[0])).solve


@checked
def full_field(
    system: SpreadingSystem, *, linear: bool = False, tolerance: float = 1e-4
) -> FullField:
    """The matrix of a built scene with all its degrees of freedom, nonlinear and implicit.

    The interface of `GalerkinField`; ``order`` is the number of free coordinates, ``modes`` and
    ``stiffness`` are sparse.

    Parameters
    ----------
    system : SpreadingSystem
        ``cs.build(scene)``.
    linear : bool
        Quadratic energy at rest.
    tolerance : float
        Residual of a step over its load.
    """
    return FullField(system=system, linear=linear, tolerance=tolerance)
