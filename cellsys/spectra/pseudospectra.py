"""Epsilon-pseudospectra: where the poles of A + E, |E| <= epsilon, can lie."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.drawable import Drawable
from cellsys.errors import ParameterError
from cellsys.spectra.poles import poles
from cellsys.spectra.realization import realization
from cellsys.spectra.roots import RootSet
from cellsys.spectra.singular import schur_matrix, smallest_singular


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Pseudospectra(Drawable):
    """sigma_min(z I - A) on a rectangle of the complex plane.

    Attributes
    ----------
    x, y : array (a,), (b,)
        Real and imaginary parts of the grid.
    sigma : array (b, a)
        sigma_min(z I - A): the level line epsilon bounds the epsilon-pseudospectrum.
    poles : RootSet
    dt : float
    """

    _figure: ClassVar[str] = "pseudospectra"
    x: np.ndarray
    y: np.ndarray
    sigma: np.ndarray
    poles: RootSet
    dt: float

    def __str__(self) -> str:
        return (
            f"pseudospectra of {len(self.poles)} poles on {len(self.x)} x {len(self.y)} points, "
            f"sigma_min {self.sigma.min():.2e} .. {self.sigma.max():.2e}"
        )


@checked
def pseudospectra(
    sys: LinearSystem, x: np.ndarray | None = None, y: np.ndarray | None = None, *, points: int = 60
) -> Pseudospectra:
    """Smallest singular value of z I - A on a grid.

        z lies in the epsilon-pseudospectrum  iff  sigma_min(z I - A) <= epsilon

    in the given coordinates (2-norm). One Schur form, then inverse Lanczos for all points together.

    Parameters
    ----------
    sys : control.StateSpace or what `poles` takes
    x, y : array, optional
        Real and imaginary parts; default: a box around the field of values.
    points : int
        Points per side of the default grid, >= 2.

    Returns
    -------
    Pseudospectra

    Raises
    ------
    ParameterError
        points < 2 or a grid that is not finite.
    DataError, DimensionError, MemoryBudgetError
        As for `poles`.

    References
    ----------
    Trefethen and Embree, Spectra and Pseudospectra (2005), section 39.
    """
    if points < 2:
        raise ParameterError(f"points must be at least 2, got {points!r}")
    system = realization(sys).dense()
    found = poles(system)
    left, right, high = _window(system.A)
    x = np.linspace(left, right, points) if x is None else _axis(x, "x")
    y = np.linspace(-high, high, points) if y is None else _axis(y, "y")
    T = schur_matrix(system.A)
    sigma = np.empty((len(y), len(x)))
    if np.array_equal(y, -y[::-1]):  # real A: the lower half mirrors the upper one
        upper = len(y) // 2
        sigma[upper:] = _sigma(T, x, y[upper:])
        sigma[: len(y) - upper] = sigma[upper:][::-1]
    else:
        sigma[:] = _sigma(T, x, y)
    return Pseudospectra(x=x, y=y, sigma=sigma, poles=found, dt=system.dt)


def _window(A: np.ndarray) -> tuple[float, float, float]:
    """Least and largest Re, largest Im of the box around the field of values, a fifth wider."""
    if not len(A):
        return -1.0, 1.0, 1.0
    real = sla.eigvalsh(0.5 * (A + A.T))
    high = float(sla.svdvals(0.5 * (A - A.T))[0])
    width = max(float(real[-1] - real[0]), high, 0.5 * float(np.abs(real).max()), 1e-12)
    return float(real[0]) - 0.2 * width, float(real[-1]) + 0.2 * width, max(1.2 * high, 0.5 * width)


def _sigma(T: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    z = x[None, :] + 1j * y[:, None]
    return smallest_singular(T, z.ravel()).reshape(z.shape)


def _axis(value: np.ndarray, name: str) -> np.ndarray:
    array = np.asarray(value, dtype=float)
    if array.ndim != 1 or not len(array) or not np.all(np.isfinite(array)):
        raise ParameterError(f"{name} must be a finite one-dimensional array, not empty")
    return array


@checked
def pseudospectral_abscissa(sys: LinearSystem, epsilon: float) -> float:
    """Largest Re z (|z| in discrete time) of the epsilon-pseudospectrum.

        alpha_eps = max { Re z : sigma_min(z I - A) <= epsilon }

    by the criss-cross method, which converges to the global maximum.

    Parameters
    ----------
    sys : control.StateSpace or what `poles` takes
    epsilon : float
        2-norm of the perturbation, > 0.

    Returns
    -------
    float
        1/s in continuous time; -inf (0 in discrete time) without states.

    Raises
    ------
    ParameterError
        epsilon <= 0 or not finite.
    DataError, DimensionError, MemoryBudgetError
        As for `poles`.

    References
    ----------
    Burke, Lewis and Overton, IMA J. Numer. Anal. 23 (2003) 359; Mengi and Overton 25 (2005) 648.
    """
    if not (np.isfinite(epsilon) and epsilon > 0):
        raise ParameterError(f"epsilon must be > 0 and finite, got {epsilon!r}")
    system = realization(sys).dense()
    values = sla.eigvals(system.A) if system.n_states else np.zeros(0)
    return abscissa(system.A, float(epsilon), values, discrete=system.is_discrete)


def abscissa(A: np.ndarray, epsilon: float, values: np.ndarray, *, discrete: bool) -> float:
    """Criss-cross for arrays; `values` are the eigenvalues of A."""
    if not len(A):
        return 0.0 if discrete else -np.inf
    size, turn = (np.abs(values), np.angle(values)) if discrete else (values.real, values.imag)
    best = float(size.max())
    best = max(best, _across(A, epsilon, float(abs(turn[np.argmax(size)])), discrete))
    for _ in range(30):
        edges = _along(A, epsilon, best, discrete)
        if not edges.size:
            break
        middles = np.unique(np.abs(0.5 * (edges[1:] + edges[:-1]))) if edges.size > 1 else edges
        new = max(_across(A, epsilon, float(m), discrete) for m in middles)
        if new <= best + 1e-10 * abs(best):
            return max(best, new)
        best = new
    return best


def _along(A: np.ndarray, epsilon: float, level: float, discrete: bool) -> np.ndarray:
    """Im z on the line Re z = level (angles on the circle |z| = level) where sigma = epsilon.

    With (z I - A) v = epsilon u and (z I - A)^H u = epsilon v on the line:
    ``z - level`` is an eigenvalue of [[A - x I, epsilon I], [-epsilon I, -(A - x I)^T]].
    """
    n = len(A)
    eye, zero = np.eye(n), np.zeros((n, n))
    if discrete:
        M = np.block([[A, epsilon * eye], [zero, level**2 * eye]])
        mu = sla.eigvals(M, np.block([[eye, zero], [epsilon * eye, A.T]]))
        mu = mu[np.isfinite(mu)]
        mu = mu[np.abs(np.abs(mu) - level) < 1e-6 * max(level, 1e-12)]
        return np.sort(np.angle(mu))
    shifted = A - level * eye
    mu = sla.eigvals(np.block([[shifted, epsilon * eye], [-epsilon * eye, -shifted.T]]))
    return np.sort(mu.imag[np.abs(mu.real) < 1e-7 * (sla.norm(shifted) + epsilon)])


def _across(A: np.ndarray, epsilon: float, at: float, discrete: bool) -> float:
    """Largest Re z on the line Im z = at (|z| on the ray of angle at) where sigma = epsilon.

    A real eigenvalue of [[F, epsilon I], [epsilon I, F^H]], F = A - j y I or exp(-j theta) A.
    """
    eye = np.eye(len(A))
    F = np.exp(-1j * at) * A if discrete else A - 1j * at * eye
    mu = sla.eigvals(np.block([[F, epsilon * eye], [epsilon * eye, F.conj().T]]))
    mu = mu[np.abs(mu.imag) < 1e-7 * (sla.norm(F) + epsilon)]
    return float(mu.real.max()) if mu.size else -np.inf
