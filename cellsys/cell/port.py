"""The load port of a cell: force density on a disc that rides with the centroid.

density  f(r, phi) = sum_km f_km h_k(r) e^{i m phi},    h_k radial hats, |m| <= 4
scatter  node force F_j = A_j f(X_j - c)      gather  y = the transpose, so that f.y is power
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as sla
from scipy.spatial import cKDTree

from cellsys.arguments import checked
from cellsys.cell.charges import TOP, pack, unpack
from cellsys.errors import DimensionError, ParameterError

REACH = 18.0  # um
SPACING = 2.0  # um between hats
ORDERS = 4  # highest azimuthal order


@checked
@dataclass(frozen=True, eq=False)
class PolarPort:
    """Radial hats times azimuthal orders.

    Parameters
    ----------
    reach, spacing : float
        Outer radius and distance of the hats, um.
    orders : int
        Highest |m|.
    """

    reach: float = REACH
    spacing: float = SPACING
    orders: int = ORDERS

    def __post_init__(self) -> None:
        if not (self.spacing > 0 and self.reach >= self.spacing):
            raise ParameterError(
                f"a port needs 0 < spacing <= reach, got {self.spacing!r} and {self.reach!r}"
            )
        if self.orders < 1:
            raise ParameterError(f"orders must be >= 1, got {self.orders!r}")

    @property
    def n_hats(self) -> int:
        """Hats at 0, spacing, ..., reach - spacing."""
        return round(self.reach / self.spacing)

    @cached_property
    def _quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Hats at Gauss points of every interval, and the points' weights 2 pi r dr."""
        x, w = np.polynomial.legendre.leggauss(4)
        r = (self.spacing * (np.arange(self.n_hats)[:, None] + 0.5 * (x + 1.0))).ravel()
        weight = np.pi * self.spacing * np.tile(w, self.n_hats) * r
        return self.hats(r), weight

    @cached_property
    def _integrals(self) -> np.ndarray:
        """Integrals of the orthonormal hats over the plane, um."""
        h, w = self._quadrature
        return (w @ h) @ self._inverse_root

    @cached_property
    def _inverse_root(self) -> np.ndarray:
        """L^-T, with L L^T the hats' mass matrix 2 pi int h_k h_l r dr."""
        h, w = self._quadrature
        lower = sla.cholesky((h.T * w) @ h, lower=True)
        return sla.solve_triangular(lower, np.eye(self.n_hats), lower=True).T

    def hats(self, r: np.ndarray) -> np.ndarray:
        """h_k(r), (..., n_hats)."""
        k = np.arange(self.n_hats)
        return np.clip(1.0 - np.abs(np.asarray(r)[..., None] / self.spacing - k), 0.0, None)

    def at(self, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Hats (n, n_hats) and e^{i m phi} (2 orders + 1, n) at places (n, 2) from the centroid.

        The hats are made orthonormal, so that coefficients have the L2 norm of the density.
        """
        r = np.hypot(offset[:, 0], offset[:, 1])
        phase = np.where(r > 0, (offset[:, 0] + 1j * offset[:, 1]) / np.where(r > 0, r, 1.0), 1.0)
        up = [np.ones_like(phase)]
        for _ in range(self.orders):
            up.append(up[-1] * phase)
        powers = np.array([*np.conj(up[:0:-1]), *up])
        return self.hats(r) @ self._inverse_root, powers

    def sizes(self) -> tuple[dict[int, int], dict[int, int]]:
        """Number of coefficients of every order W_m and Z_m."""
        each = {m: self.n_hats for m in range(-self.orders, self.orders + 1)}
        return dict(each), dict(each)

    def charges(self) -> range:
        """Charges that a load can hold: those with at least one order within reach."""
        return range(0, min(TOP, self.orders + 1) + 1)

    def analyse(
        self, at: tuple[np.ndarray, np.ndarray], values: np.ndarray
    ) -> dict[int, np.ndarray]:
        """Charges of node values (n, 3): their sum over nodes against the port's functions.

        For node forces these are the density's coefficients (up to sampling); for area times
        velocity they are the velocities y whose product with the load is the power.
        """
        hats, powers = at
        if values.shape != (len(hats), 3):
            raise DimensionError(f"node values must be ({len(hats)}, 3), got {values.shape}")
        turned = np.conj(powers)
        flat = (turned * (values[:, 0] + 1j * values[:, 1])) @ hats
        up = (turned * values[:, 2]) @ hats
        m = range(-self.orders, self.orders + 1)
        W, Z = dict(zip(m, flat, strict=True)), dict(zip(m, up, strict=True))
        return {q: pack(W, Z, q) for q in self.charges()}

    def density(self, at: tuple[np.ndarray, np.ndarray], load: dict[int, np.ndarray]) -> np.ndarray:
        """Density (n, 3), pN/um^2, from the charges of a load."""
        hats, powers = at
        W, Z = unpack(load, *self.sizes())
        flat = np.sum(powers * (np.array([W[m] for m in sorted(W)]) @ hats.T), axis=0)
        # Z_m and Z_-m are conjugate; charges hold m <= 0.
        weight = np.where(np.arange(-self.orders, 1) < 0, 2.0, 1.0)[:, None]
        held = weight * np.array([Z[m] for m in range(-self.orders, 1)])
        up = np.sum(powers[: self.orders + 1] * (held @ hats.T), axis=0).real
        return np.stack([flat.real, flat.imag, up], axis=-1)

    def uniform(self, velocity: np.ndarray) -> dict[int, np.ndarray]:
        """Charges y of one velocity (3,) everywhere under the port: int h_k e^{-i m phi} v."""
        none = np.zeros(self.n_hats, complex)
        orders = range(-self.orders, self.orders + 1)
        W = {m: none for m in orders} | {0: self._integrals * (velocity[0] + 1j * velocity[1])}
        Z = {m: none for m in orders} | {0: self._integrals * complex(velocity[2])}
        return {q: pack(W, Z, q) for q in (0, 1)}

    def total(self, load: dict[int, np.ndarray]) -> np.ndarray:
        """Integral (3,) of the density of a load, pN."""
        W, Z = unpack({q: load[q] for q in (0, 1)}, *self.sizes())
        flat = self._integrals @ W[0]
        return np.array([flat.real, flat.imag, (self._integrals @ Z[0]).real])


@dataclass(frozen=True, eq=False)
class PortSites:
    """Matrix nodes that ports act on: their places and the area each stands for.

    Parameters
    ----------
    nodes : int array (n,)
        Rows among all matrix nodes.
    place : (n, 2)
        um.
    area : (n,)
        um^2.
    """

    nodes: np.ndarray
    place: np.ndarray
    area: np.ndarray

    @classmethod
    def of(cls, rest: np.ndarray, surface: np.ndarray) -> PortSites:
        """Areas of the nodes nearest to each point of a fine grid over the disc."""
        surface = np.asarray(surface, dtype=int)
        place = np.asarray(rest, dtype=float)[surface, :2]
        radius = float(np.hypot(*np.asarray(rest)[:, :2].T).max())
        step = radius / 240.0
        axis = np.arange(-radius, radius + step, step)
        grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
        grid = grid[np.hypot(*grid.T) <= radius]
        owner = cKDTree(place).query(grid)[1]
        area = np.bincount(owner, minlength=len(place)) * (np.pi * radius**2 / len(grid))
        return cls(surface, place, area)

    def under(self, centre: np.ndarray, port: PolarPort) -> Footprint:
        """The sites within reach of a port at `centre`."""
        offset = self.place - np.asarray(centre)[:2]
        inside = np.flatnonzero((offset**2).sum(axis=1) < port.reach**2)
        weight = self.area[inside] * (1.0 - (offset[inside] ** 2).sum(axis=1) / port.reach**2)
        return Footprint(
            port=port,
            nodes=self.nodes[inside],
            area=self.area[inside],
            weight=weight / weight.sum(),
            at=port.at(offset[inside]),
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Footprint:
    """A port at one place: the nodes under it and the port's functions there.

    On irregular nodes a radial pull would leave a net force of some per cent; it is taken off
    again, spread by `weight` (n,), so that the total is that of the density. `gather` is the
    exact transpose: what two footprints exchange is power-conjugate.
    """

    port: PolarPort
    nodes: np.ndarray
    area: np.ndarray
    weight: np.ndarray
    at: tuple[np.ndarray, np.ndarray]

    def load(self, forces: np.ndarray) -> dict[int, np.ndarray]:
        """Charges of the density behind node forces (n_matrix, 3), pN."""
        return self.port.analyse(self.at, np.asarray(forces)[self.nodes])

    def scatter(self, load: dict[int, np.ndarray]) -> np.ndarray:
        """Forces (n, 3), pN, on the nodes under the port."""
        force = self.area[:, None] * self.port.density(self.at, load)
        return force - self.weight[:, None] * (force.sum(axis=0) - self.port.total(load))

    def gather(self, velocity: np.ndarray) -> dict[int, np.ndarray]:
        """Charges y of velocities (n, 3) of the nodes under the port.

        sum over q of Re conj(f_q).y_q is the power of the scattered load.
        """
        mean = self.weight @ velocity
        y = self.port.analyse(self.at, self.area[:, None] * (velocity - mean))
        for q, moved in self.port.uniform(mean).items():
            y[q] = y[q] + moved
        return y
