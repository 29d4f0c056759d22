"""Eigenvalue loci of a return ratio L(j omega) on a grid that leaves nothing out.

One locus for a scalar L; for a square L (q x q) its q eigenvalues at every frequency (MacFarlane
and Postlethwaite, Int. J. Control 25 (1977) 81): det(I + k L) = 0 where k times a locus passes -1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cellsys.response import grid, pencils
from cellsys.response.phase import anchored, continuous_phase
from cellsys.spectra.eigenvalues import eigenvalues_with_bounds, track
from cellsys.spectra.realization import Realization
from cellsys.spectra.resolvent import Resolvent, s_plane

_DECADES = 40  # that a grid may be extended by at either end


@dataclass(frozen=True)
class Points:
    """Eigenvalues of L at some frequencies.

    Attributes
    ----------
    omega : array (k,)
        rad/s; 0, and inf or pi/dt, at the ends.
    values : complex array (q, k), or (k,) for single crossings
    noise : array, same shape
        Bound of the error of each.
    """

    omega: np.ndarray
    values: np.ndarray
    noise: np.ndarray


class Loci:
    """L of a system on an extended, refined grid.

    Attributes
    ----------
    omega : array (k,)
    L : complex array (q, q, k)
    raw : complex array (q, k)
        Eigenvalues of L, each column in any order; see `values`.
    noise : array (q, k)
        Error bound of each value of `raw`.
    ends : Points
        The loci at 0 and at inf (pi/dt), where they are finite.
    fitting : pencils.Fitting or None
        The system in scales that fit where crossings were also sought as eigenvalues of a pencil
        (`pencils`), off the grid; None where it is too large for that, or omega was given.
    evaluate : Resolvent
    """

    def __init__(self, system: Realization, omega: np.ndarray | None = None) -> None:
        self.system = system
        self.evaluate = Resolvent(system)
        self.fitting: pencils.Fitting | None = None
        q = system.n_inputs
        if q == 0:
            self.omega, self.L = np.zeros(0), np.zeros((0, 0, 0), complex)
            self.raw, self.noise = np.zeros((0, 0), complex), np.zeros((0, 0))
            self.ends = Points(self.omega, self.raw, self.noise)
            return
        self.ends = self._at_the_ends()
        if omega is None:
            start = self._extended(grid.automatic(system))
            self.omega, _ = grid.refine(
                self._sizeable, start, match=track if q > 1 else None, about=(0.0, -1.0)
            )
            self._complete()
        else:
            self.omega = np.unique(omega)
        L, bound = self.evaluate.with_accuracy(s_plane(self.omega, system.dt))
        usable = np.isfinite(L).all(axis=(0, 1))
        if not usable.all():
            self.omega, L, bound = self.omega[usable], L[:, :, usable], bound[:, :, usable]
        self.L = L
        self.raw, self.noise = eigenvalues_with_bounds(L, bound)

    @property
    def complete(self) -> bool:
        """No crossing can hide between the points of the grid."""
        return self.fitting is not None or not self.omega.size

    @cached_property
    def values(self) -> np.ndarray:
        """The loci (q, k), each row one continuous path: for drawing."""
        return track(self.raw)

    @cached_property
    def phase(self) -> np.ndarray:
        """Phase in rad (q, k) of `values`, from the low-frequency asymptote on."""
        if len(self.raw) == 1:
            return continuous_phase(self.system, self.omega, self.L)[0]
        if not self.raw.size:
            return np.zeros(self.raw.shape)
        size = np.abs(self.values[:, [0, min(1, len(self.omega) - 1)]])
        with np.errstate(divide="ignore", invalid="ignore"):
            power = -np.log(size[:, 1] / size[:, 0]) / np.log(self.omega[1:2] / self.omega[0])
        order = np.where(np.isfinite(power), np.round(power), 0.0)
        return anchored(np.unwrap(np.angle(self.values), axis=-1), order)

    def eigenvalues(self, omega: np.ndarray, floor: float = 0.0) -> np.ndarray:
        """Eigenvalues (q, k) of L, in any order; 0 where they are below `floor` |L|."""
        L = self.evaluate(s_plane(omega, self.system.dt))
        L = np.where(np.isfinite(L), L, 1e300)
        if L.shape[0] == 1:
            return L[0]
        values = np.linalg.eigvals(np.moveaxis(L, -1, 0)).T
        if floor == 0:
            return values
        size = np.abs(L).max(axis=(0, 1))
        return np.where(np.abs(values) > floor * size, values, 0.0)

    def _sizeable(self, omega: np.ndarray) -> np.ndarray:
        """What the refinement looks at: no rounding of a matrix L of a lower rank."""
        return self.eigenvalues(omega, floor=1e-10)

    def _at_the_ends(self) -> Points:
        """0 and pi/dt, where L is real, or 0 and infinity, where it is D."""
        system = self.system
        top = np.pi / system.dt if system.is_discrete else np.inf
        points = np.array([1.0, -1.0] if system.is_discrete else [0.0], complex)
        L, bound = self.evaluate.with_accuracy(points)
        # Where A is singular to working precision, nothing is known of L(0): no end.
        size = np.abs(L).max(axis=(0, 1))
        known = np.isfinite(size) & (bound.max(axis=(0, 1)) <= np.maximum(0.1 * size, 1e-3))
        L, bound = L[:, :, known].real.astype(complex), bound[:, :, known]
        values, noise = eigenvalues_with_bounds(L, bound)
        omega = np.array([0.0, top])[: len(points)][known]
        if not system.is_discrete:
            D = system.D[:, :, None].astype(complex)
            high, error = eigenvalues_with_bounds(D, 1e-15 * np.abs(D))
            omega = np.append(omega, np.inf)
            values, noise = np.hstack([values, high]), np.hstack([noise, error])
        return Points(omega, values, noise)

    def _extended(self, omega: np.ndarray) -> np.ndarray:
        """Add decades at the ends until as many loci lie outside the unit circle as at the end.

        Where L(0) is not finite: while a locus below 2 still rises towards 0.
        """
        edge = np.geomspace(0.1, 1.0, grid.PER_DECADE, endpoint=False)

        def outside(at: float) -> int | None:
            column = np.flatnonzero(self.ends.omega == at)
            if not column.size:
                return None
            size, noise = np.abs(self.ends.values[:, column]), self.ends.noise[:, column]
            if np.any(np.abs(size - 1) <= 2 * noise):
                return None  # on the circle: no number of decades would tell
            return int(np.count_nonzero(size > 1))

        low, high = outside(0.0), outside(np.inf)
        size = np.abs(self.eigenvalues(np.append(omega[:2], omega[-1])))
        top = size[:, -1]
        for _ in range(_DECADES):
            if 0.0 in self.ends.omega:
                more = low is not None and np.count_nonzero(size[:, 0] > 1) != low
            else:
                size = np.sort(size[:, :2], axis=0)
                steep = size[:, 0] > size[:, 1] * (1 + 0.1 * (1 - omega[0] / omega[1]))
                more = bool(np.any(steep & (size[:, 0] < 2)))
            if not more:
                break
            omega = np.concatenate([edge * omega[0], omega])
            size = np.abs(self.eigenvalues(omega[:2]))
        for _ in range(_DECADES):
            if high is None or np.count_nonzero(top > 1) == high:
                break
            omega = np.concatenate([omega, edge[1:] * omega[-1] * 10, [omega[-1] * 10]])
            top = np.abs(self.eigenvalues(omega[-1:]))
        return omega

    def _complete(self) -> None:
        """Put the candidates of the pencils and points between them onto the grid."""
        if pencils.rows(self.system) > pencils.MOST_ROWS:
            return
        self.fitting = pencils.fitting(self.system)
        found = np.concatenate(
            [pencils.unit_modulus(self.fitting), pencils.real_axis(self.fitting)]
        )
        lo, hi = self.omega[[0, -1]]
        found = np.unique(found[(found > 1e-12 * lo) & (found < 1e12 * hi)])
        between = np.sqrt(found[1:] * found[:-1])
        outer = np.concatenate([found[:1] / 2, found[-1:] * 2])
        if self.system.is_discrete:
            outer = outer[outer < hi]
        self.omega = np.unique(np.concatenate([self.omega, found, between, outer]))
