"""Shape of a membrane in spherical harmonics of its material points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as sla
from scipy.special import gammaln, lpmv

from cellsys.cell.charges import TOP
from cellsys.errors import DataError, DimensionError, ParameterError


def harmonics(material: np.ndarray, degree: int, m: int) -> np.ndarray:
    """Orthonormal Y_lm (n, degree - |m| + 1) of unit vectors (n, 3), l = |m| .. degree.

    Y_l,-m = (-1)^m conj Y_lm, so a mirror image in the x-z plane conjugates them.
    """
    cosine = np.clip(material[:, 2], -1.0, 1.0)
    phase = np.exp(1j * m * np.arctan2(material[:, 1], material[:, 0]))
    order, columns = abs(m), []
    for degree_l in range(order, degree + 1):
        norm = np.exp(
            0.5 * (np.log((2 * degree_l + 1) / (4 * np.pi)))
            + 0.5 * (gammaln(degree_l - order + 1) - gammaln(degree_l + order + 1))
        )
        columns.append(norm * lpmv(order, degree_l, cosine) * phase)
    values = np.array(columns).T
    return values if m >= 0 else (-1) ** order * values


@dataclass(frozen=True, eq=False)
class ShapeBasis:
    """x_i = c + sum_lm C_lm Y_lm(xi_i), xi_i the material point of node i.

    See [notes: theory, equivariant cell].

    Parameters
    ----------
    material : (n, 3)
        Unit vectors from the centre to the nodes of the sphere the cell starts as.
    degree : int
        10 resolves the shipped membrane to about 0.1 um.
    radius : float
        Of that sphere, um.
    """

    material: np.ndarray
    radius: float
    degree: int = 10

    def __post_init__(self) -> None:
        material = np.asarray(self.material, dtype=float)
        if material.ndim != 2 or material.shape[1] != 3:
            raise DimensionError(f"material must be (n, 3), got {material.shape}")
        norm = np.linalg.norm(material, axis=1)
        if not np.all(np.abs(norm - 1.0) < 1e-9):
            raise DataError("material points must be unit vectors")
        if (self.degree + 1) ** 2 > len(material):
            raise ParameterError(
                f"degree {self.degree} needs {(self.degree + 1) ** 2} nodes, the membrane has "
                f"{len(material)}; lower the degree"
            )
        object.__setattr__(self, "material", material)

    @classmethod
    def of(cls, nodes: np.ndarray, degree: int = 10) -> ShapeBasis:
        """From the nodes (n, 3) of the cell at its start."""
        nodes = np.asarray(nodes, dtype=float)
        # |x|^2 = 2 c.x + (R^2 - |c|^2): the centre of the sphere, not the mean of its nodes
        about = nodes - nodes.mean(axis=0)
        rows = np.column_stack([2.0 * about, np.ones(len(about))])
        centre = sla.lstsq(rows, np.sum(about**2, axis=1))[0][:3]
        out = about - centre
        length = np.linalg.norm(out, axis=1)
        if not length.min() > 0 or np.ptp(length) > 0.05 * length.mean():
            raise DataError(
                "the cell does not start as a sphere: its nodes are "
                f"{length.min():.3g} to {length.max():.3g} um from its centre"
            )
        return cls(out / length[:, None], float(length.mean()), degree)

    @property
    def orders(self) -> range:
        """Azimuthal orders m used by charges up to 5."""
        return range(-self.degree, self.degree + 1)

    @cached_property
    def _table(self) -> tuple[np.ndarray, dict[int, slice]]:
        columns, where, start = [], {}, 0
        for m in self.orders:
            values = harmonics(self.material, self.degree, m)
            columns.append(values)
            where[m] = slice(start, start + values.shape[1])
            start += values.shape[1]
        return np.hstack(columns), where

    @cached_property
    def _fit(self) -> np.ndarray:
        """Least-squares map from node values to coefficients ((degree + 1)^2, n)."""
        Y = self._table[0]
        return sla.lstsq(Y, np.eye(len(Y), dtype=complex))[0]

    @cached_property
    def sphere(self) -> np.ndarray:
        """Node positions of the start about its centre (n, 3)."""
        return self.radius * self.material

    def coefficients(
        self, nodes: np.ndarray
    ) -> tuple[np.ndarray, dict[int, np.ndarray], dict[int, np.ndarray]]:
        """Centroid (..., 3) and W_m, Z_m (..., n_m) of the change of shape from the sphere."""
        nodes = np.asarray(nodes, dtype=float)
        if nodes.shape[-2:] != self.material.shape:
            raise DimensionError(f"nodes must be (..., {len(self.material)}, 3), got {nodes.shape}")
        mean = nodes.mean(axis=-2)
        change = nodes - mean[..., None, :] - self.sphere
        W_all = (change[..., 0] + 1j * change[..., 1]) @ self._fit.T
        Z_all = change[..., 2] @ self._fit.T
        where = self._table[1]
        # The centroid is the coefficient l = 0: unlike the mean of the nodes it turns exactly.
        first, unit = where[0].start, np.sqrt(4.0 * np.pi)
        shift = [W_all[..., first].real, W_all[..., first].imag, Z_all[..., first].real]
        centre = mean + np.stack(shift, axis=-1) / unit
        W_all[..., first] = 0.0
        Z_all[..., first] = 0.0
        W = {m: W_all[..., where[m]] for m in self.orders if 1 - TOP <= m <= 1 + TOP}
        Z = {m: Z_all[..., where[m]] for m in self.orders if abs(m) <= TOP}
        return centre, W, Z

    def sizes(self) -> tuple[dict[int, int], dict[int, int]]:
        """Number of coefficients of every W_m and Z_m that a charge can hold."""
        where = self._table[1]
        n = {m: where[m].stop - where[m].start for m in self.orders}
        return (
            {m: n[m] for m in self.orders if 1 - TOP <= m <= 1 + TOP},
            {m: n[m] for m in self.orders if abs(m) <= TOP},
        )

    def nodes(
        self, centre: np.ndarray, W: dict[int, np.ndarray], Z: dict[int, np.ndarray]
    ) -> np.ndarray:
        """Node positions (..., n, 3) from centroid and coefficients."""
        table, where = self._table
        flat = sum(W[m] @ table[:, where[m]].T for m in W)
        up = np.zeros(flat.shape)
        for m in Z:
            # Z_m and Z_-m are conjugate and only m <= 0 are carried by charges.
            if m <= 0:
                weight = 1.0 if m == 0 else 2.0
                up = up + weight * (Z[m] @ table[:, where[m]].T).real
        change = np.stack([flat.real, flat.imag, up], axis=-1)
        return np.asarray(centre)[..., None, :] + self.sphere + change
