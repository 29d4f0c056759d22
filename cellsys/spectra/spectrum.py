"""Eigenvalues with condition numbers, error bounds and clusters.

Let B be the matrix (or pencil) as stored and X the one whose eigenvalues LAPACK returned exactly,
|B - X| <= delta. With unit right vectors x_i and left vectors y_i, y_i^H x_i = 1, the eigenvalues
of B lie in the union of the discs

    |z - lambda_i| <= n |y_i| delta                    [Wilkinson 1965, section 2.13; Bauer and
                                                        Fike 1960 by way of Gershgorin]

and a connected group of k discs holds exactly k of them: a *cluster*. For a (nearly) defective
matrix the discs of a matrix a distance delta away are taken as well, whose eigenvalues are simple,
and Elsner's bound (2 |B|)^(1 - 1/n) delta^(1/n) [Stewart and Sun 1990, theorem IV.1.3].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from scipy.sparse.csgraph import connected_components

from cellsys.spectra.realization import EPS


@dataclass(frozen=True, eq=False, kw_only=True)
class Spectrum:
    """Eigenvalues with what is known about their errors; all arrays (n,), same order.

    Attributes
    ----------
    values : complex array
    condition : array
        |y_i| |x_i| / |y_i^H x_i| in balanced coordinates: d lambda / |dA|, at least 1.
    bound : array
        There is a true eigenvalue within this distance, and each true one lies within it of a
        value of the same cluster.
    cluster : int array
        Number of the group of overlapping discs.
    backward : float
        delta, norm of the backward error counted on.
    """

    values: np.ndarray
    condition: np.ndarray
    bound: np.ndarray
    cluster: np.ndarray
    backward: float

    @property
    def cluster_size(self) -> np.ndarray:
        """Number of eigenvalues in the cluster of each."""
        if not self.cluster.size:
            return np.zeros(0, int)
        return np.bincount(self.cluster)[self.cluster]


def backward_error(n: int, norm: float) -> float:
    """delta = (10 + sqrt n) eps |A|_F; LAPACK's own tests ask for less than 30 n eps |A|."""
    return (10.0 + np.sqrt(n)) * EPS * norm


def _groups(centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Label of the connected group of each disc."""
    with np.errstate(invalid="ignore"):
        touch = np.abs(centres[:, None] - centres[None]) <= radii[:, None] + radii[None]
    return connected_components(touch, directed=False)[1]


def _within(
    values: np.ndarray, centres: np.ndarray, radii: np.ndarray, label: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Reach of the group of discs each value lies in, and that group's label."""
    distance = np.abs(values[:, None] - centres[None])
    with np.errstate(invalid="ignore"):
        outside = np.where(np.isinf(radii), -np.inf, distance - radii)
    mine = label[np.argmin(outside, axis=1)]
    reach = np.where(mine[:, None] == label[None], distance + radii, 0.0)
    return reach.max(axis=1), mine


def _condition(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    product = np.abs(np.einsum("ij,ij->j", left.conj(), right))
    size = np.linalg.norm(left, axis=0) * np.linalg.norm(right, axis=0)
    with np.errstate(divide="ignore", over="ignore"):
        return np.maximum(np.where(product > 0, size / product, np.inf), 1.0)


def spectrum(A: np.ndarray, values: np.ndarray | None = None) -> Spectrum:
    """Eigenvalues of a real or complex matrix with their error bounds.

    Parameters
    ----------
    A : array (n, n), balanced
    values : complex array (n,), optional
        Eigenvalues computed before; the bounds are for these.

    Returns
    -------
    Spectrum
    """
    n = A.shape[0]
    if n == 0:
        none = np.zeros(0)
        return Spectrum(
            values=none.astype(complex),
            condition=none,
            bound=none,
            cluster=none.astype(int),
            backward=0.0,
        )
    norm = float(sla.norm(A))
    delta = backward_error(n, norm)
    found, left, right = sla.eig(A, left=True, right=True)
    values = found if values is None else values
    condition = _condition(left, right)
    radii = n * condition * 2 * delta  # twice: `values` may come from another call
    label = _groups(found, radii)
    bound, cluster = _within(values, found, radii, label)
    nearest = np.argmin(np.abs(values[:, None] - found[None]), axis=1)
    condition = condition[nearest]
    if radii.max() > 1e-3 * norm:
        noise = np.random.default_rng(0).standard_normal((n, n))
        moved: np.ndarray = A + noise * (delta / sla.norm(noise))
        near, left, right = sla.eig(moved, left=True, right=True)
        radii = n * _condition(left, right) * 3 * delta
        second, other = _within(values, near, radii, _groups(near, radii))
        if second.max() < bound.max() or not np.isfinite(bound.max()):
            bound, cluster = second, other
        elsner = (2 * norm + delta) ** (1 - 1 / n) * (3 * delta) ** (1 / n)
        bound = np.minimum(bound, elsner)
    return Spectrum(
        values=values,
        condition=condition,
        bound=bound,
        cluster=np.unique(cluster, return_inverse=True)[1],
        backward=delta,
    )


def pencil_spectrum(A: np.ndarray, E: np.ndarray, delta_a: float, delta_e: float) -> Spectrum:
    """Finite eigenvalues of A - z E (E regular) with first-order condition and disc bounds.

    ``r_i = n |y_i| (delta_a + |z_i| delta_e) / (1 - n |y_i| delta_e)``, y_i^H E x_i = 1; infinite
    where the denominator is not positive.
    """
    n = A.shape[0]

    def discs(A: np.ndarray, E: np.ndarray, factor: float) -> tuple[np.ndarray, ...]:
        values, left, right = sla.eig(A, E, left=True, right=True)
        inner = np.abs(np.einsum("ij,ij->j", left.conj(), E @ right))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            y = np.linalg.norm(left, axis=0) * np.linalg.norm(right, axis=0) / inner
            room = 1 - n * y * factor * delta_e
            radii = n * y * factor * (delta_a + np.abs(values) * delta_e) / room
        radii = np.where((room > 0) & np.isfinite(radii), radii, np.inf)
        return values, y * (1 + np.abs(values)), radii

    values, condition, radii = discs(A, E, 1.0)
    finite = np.isfinite(values)
    values, condition, radii = values[finite], condition[finite], radii[finite]
    if not len(values):
        return spectrum(np.zeros((0, 0)))
    bound, cluster = _within(values, values, radii, _groups(values, radii))
    if radii.max() > 1e-3 * max(np.abs(values).max(), delta_a):
        rng = np.random.default_rng(0)
        noise = [rng.standard_normal((n, n)) for _ in "AE"]
        near, _, radii = discs(
            A + noise[0] * (delta_a / sla.norm(noise[0])),
            E + noise[1] * (delta_e / sla.norm(noise[1])),
            2.0,
        )
        keep = np.isfinite(near)
        near, radii = near[keep], radii[keep]
        if len(near):
            second, other = _within(values, near, radii, _groups(near, radii))
            if second.max() < bound.max() or not np.isfinite(bound.max()):
                bound, cluster = second, other
    return Spectrum(
        values=values,
        condition=condition,
        bound=bound,
        cluster=np.unique(cluster, return_inverse=True)[1],
        backward=delta_a,
    )
