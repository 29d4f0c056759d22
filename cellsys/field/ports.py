"""Ports of a field: load patterns by name, the linear plant between them, what is passive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.shown import Shown

MOST_DENSE = 3000  # coordinates: beyond, dense matrices and their eigenvalues take minutes
_ANGLES = 400  # frequencies on the unit circle


@checked
@dataclass(frozen=True, kw_only=True)
class FieldPassivity(Shown):
    """What the passivity of a field rests on; from `GradientField.passivity`.

    Attributes
    ----------
    dt : float
        Step of the implicit Euler scheme looked at, s.
    least_curvature : float
        Least eigenvalue of Hess U, pN/um.
    bound : float
        -2 C_e/dt: implicit Euler gains no more than its work while the curvature is above.
    index : float
        Least real part of the discrete port impedance of a step (load to (q+ - q)/dt, linearised)
        over the unit circle, over its greatest gain; >= 0 is passive.
    residual : float
        |F . d + dU/dd| / (|F| |d|) for a random direction d: how far the force is from the
        gradient of the energy.
    asymmetry : float
        |K - K^T| / |K| of the tangent.
    collocation : float
        |U^T U - I|: how far load map and read-out are from each other's transpose.
    """

    dt: float
    least_curvature: float
    bound: float
    index: float
    residual: float
    asymmetry: float
    collocation: float

    @property
    def passive(self) -> bool:
        """Curvature above the bound, index and residuals at rounding."""
        return bool(
            self.least_curvature >= self.bound
            and self.index >= -1e-12
            and max(self.residual, self.asymmetry, self.collocation) < 1e-6
        )

    def __str__(self) -> str:
        word = "passive" if self.passive else "NOT shown to be passive"
        return (
            f"{word} at dt = {self.dt:g} s: least curvature {self.least_curvature:.4g} pN/um "
            f"(bound {self.bound:.4g}), index {self.index:.1e}, residual {self.residual:.1e}"
        )


def port_patterns(
    ports: Mapping[str, np.ndarray] | np.ndarray, n: int
) -> tuple[np.ndarray, list[str]]:
    """Load patterns (p, n, 3) and their names.

    Parameters
    ----------
    ports : mapping of str to (n, 3), or array (p, n, 3), or 1-D int array of nodes
        Nodes give three ports each, a unit force along x, y and z.
    """
    if isinstance(ports, Mapping):
        names = [str(k) for k in ports]
        patterns = np.asarray(list(ports.values()), dtype=float)
    else:
        given = np.asarray(ports)
        if given.ndim == 1 and given.size and np.issubdtype(given.dtype, np.integer):
            if given.min() < 0 or given.max() >= n:
                raise ParameterError(f"port nodes must be between 0 and {n - 1}")
            names = [f"node{i}_{axis}" for i in given for axis in "xyz"]
            patterns = np.zeros((3 * len(given), n, 3))
            patterns[
                np.arange(len(patterns)), np.repeat(given, 3), np.tile([0, 1, 2], len(given))
            ] = 1.0
        else:
            patterns = given
            names = [f"port{i}" for i in range(len(given))] if given.ndim else []
    patterns = np.asarray(patterns, dtype=float)
    if patterns.ndim != 3 or patterns.shape[1:] != (n, 3) or not len(patterns):
        raise DimensionError(
            f"ports must be a mapping of names to ({n}, 3) load patterns, an array (p, {n}, 3), or "
            f"node indices; got shape {patterns.shape}"
        )
    if not np.all(np.isfinite(patterns)):
        raise DataError("ports hold NaN or inf")
    return patterns, names


def least_eigenvalue(K: np.ndarray | sp.csc_array) -> tuple[float, float]:
    """(least, greatest) eigenvalue of a symmetric matrix, dense or sparse."""
    if isinstance(K, np.ndarray):
        w = sla.eigvalsh(K)
        return float(w[0]), float(w[-1])
    start = np.ones(K.shape[0])
    low = spla.eigsh(K, 1, which="SA", v0=start, ncv=80, tol=1e-6, return_eigenvectors=False)
    high = spla.eigsh(K, 1, which="LA", v0=start, tol=1e-6, return_eigenvectors=False)
    return float(low[0]), float(high[0])


def step_index(curvatures: np.ndarray, drag: float, dt: float) -> float:
    """Passivity index of implicit Euler: min Re H / max |H| over the unit circle.

    H = w/(C w + lambda), w = (1 - 1/z)/dt, for every curvature lambda: Re H has the sign of
    2 C/dt + lambda.
    """
    angle = np.linspace(1e-6, np.pi, _ANGLES)
    w = (1.0 - np.exp(-1j * angle)) / dt
    h = w / (drag * w + np.asarray(curvatures)[:, None])
    return float(h.real.min() / np.abs(h).max())


def linear_matrices(
    K: np.ndarray, E: np.ndarray, drag: float, output: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(A, B, C, D) of C_e q' = -K q + E^T f, y = E q' (velocity) or E q (displacement)."""
    A, B = -K / drag, E.T / drag
    if output == "velocity":
        return A, B, E @ A, E @ B
    if output == "displacement":
        return A, B, E, np.zeros((len(E), len(E)))
    raise ParameterError(f"output must be 'velocity' or 'displacement', got {output!r}")
