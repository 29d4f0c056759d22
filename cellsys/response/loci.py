"""Eigenvalue loci of a return ratio L(j omega), with all crossings bracketed and polished.

One locus for a scalar L; for a square L (q x q) its q eigenvalues at every frequency (MacFarlane
and Postlethwaite, Int. J. Control 25 (1977) 81): det(I + k L) = 0 where k times a locus passes -1.

Crossings are changes of sign of *sorted* values (of log |lambda|, or of sin arg lambda): the
largest, the second largest and so on are continuous in the frequency whichever locus they belong
to, so that nothing depends on telling close loci apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations

import numpy as np
from scipy.optimize import linear_sum_assignment

from cellsys.response import grid, pencils
from cellsys.response.brackets import find_roots
from cellsys.response.phase import anchored, continuous_phase
from cellsys.response.realization import Realization
from cellsys.response.resolvent import Resolvent, s_plane

_DECADES = 40  # that a grid may be extended by at either end
_UNKNOWN = 0.05  # relative error beyond which a value says nothing: a pole or zero on the boundary


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


def log_size(values: np.ndarray) -> np.ndarray:
    """log |lambda|: 0 on the unit circle."""
    with np.errstate(divide="ignore"):
        return np.maximum(np.log(np.abs(values)), -800.0)


def sine(values: np.ndarray) -> np.ndarray:
    """Im lambda / |lambda|: 0 on the real axis."""
    with np.errstate(divide="ignore", invalid="ignore"):
        turned = values.imag / np.abs(values)
    return np.where(np.isfinite(turned), turned, 1.0)


def left_sine(values: np.ndarray) -> np.ndarray:
    """The same where Re lambda < 0, else +-1: jumps on the positive real axis."""
    return np.where(values.real < 0, sine(values), np.where(values.imag >= 0, 1.0, -1.0))


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
        self.raw, self.noise = _with_noise(L, bound)

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

    def _eigenvalues(self, omega: np.ndarray, floor: float = 0.0) -> np.ndarray:
        """Eigenvalues (q, k); 0 where they are below `floor` |L|."""
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
        return self._eigenvalues(omega, floor=1e-10)

    def _at_the_ends(self) -> Points:
        """0 and pi/dt, where L is real, or 0 and infinity, where it is D."""
        system = self.system
        top = np.pi / system.dt if system.is_discrete else np.inf
        points = np.array([1.0, -1.0] if system.is_discrete else [0.0], complex)
        L, bound = self.evaluate.with_accuracy(points)
        # Where A is singular to working precision, nothing is known of L(0): no end.
        size = np.abs(L).max(axis=(0, 1))
        known = np.isfinite(size) & (bound.max(axis=(0, 1)) <= np.maximum(0.1 * size, 1e-3))
        values, noise = _with_noise(L[:, :, known].real.astype(complex), bound[:, :, known])
        omega = np.array([0.0, top])[: len(points)][known]
        if not system.is_discrete:
            D = system.D[:, :, None].astype(complex)
            high, error = _with_noise(D, 1e-15 * np.abs(D))
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
        size = np.abs(self._eigenvalues(np.append(omega[:2], omega[-1])))
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
            size = np.abs(self._eigenvalues(omega[:2]))
        for _ in range(_DECADES):
            if high is None or np.count_nonzero(top > 1) == high:
                break
            omega = np.concatenate([omega, edge[1:] * omega[-1] * 10, [omega[-1] * 10]])
            top = np.abs(self._eigenvalues(omega[-1:]))
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

    def crossings(self) -> tuple[Points, Points]:
        """All frequencies inside the grid where a locus is real and negative, and where it has
        modulus one: each with the locus there (k,).
        """
        none = Points(np.zeros(0), np.zeros(0, complex), np.zeros(0))
        if not self.omega.size:
            return none, none
        # On a bare grid one locus may pass the negative axis while another passes the positive
        # one the other way: seen from the left half-plane alone, that shows.
        kinds = (log_size, sine) if self.complete else (log_size, sine, left_sine)
        parts = [self._brackets(kind) for kind in kinds]
        which = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
        a, b, fa, fb, near, row, floor = (np.concatenate(p) for p in zip(*parts, strict=True))
        if not len(a):
            return none, none

        def picked(values: np.ndarray, i: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """The sorted value of each bracket, and the place of its locus."""
            g = log_size(values)
            for k, kind in enumerate(kinds[1:], 1):
                g = np.where(which[i] == k, _apart(kind, values, floor[i]), g)
            at = np.argsort(g, axis=0)[row[i], np.arange(len(i))]
            return g[at, np.arange(len(i))], at

        omega = find_roots(lambda w, i: picked(self._eigenvalues(w), i)[0], a, b, fa, fb, near)
        L, bound = self.evaluate.with_accuracy(s_plane(omega, self.system.dt))
        L = np.where(np.isfinite(L), L, 1e300)
        values, noise = _with_noise(L, np.where(np.isfinite(bound), bound, np.inf))
        left, at = picked(values, np.arange(len(a)))
        values, noise = values[at, np.arange(len(a))], noise[at, np.arange(len(a))]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            share = np.where(values != 0, noise / np.abs(values), np.inf)
        # A change of sign that is no crossing: a pole or a zero on the boundary.
        kept = (share < _UNKNOWN) & (np.abs(left) <= np.maximum(1e-6, 2 * share))
        kept &= (which == 0) | (values.real < 0)
        if len(kinds) > 2:
            kept &= ~((which == 2) & _seen(omega, values, kept & (which == 1)))
        rank = np.argsort(omega, kind="stable")
        sides = (rank[(kept & (which > 0))[rank]], rank[(kept & (which == 0))[rank]])
        return tuple(Points(omega[s], values[s], noise[s]) for s in sides)

    def _brackets(self, kind: Callable) -> tuple[np.ndarray, ...]:
        """Of each change of sign of a sorted value: its ends, the values there, a point between
        that is nearest to zero, the row, and the size that counts as zero.
        """
        omega = self.omega
        f, clear = self._signs(kind, self.raw, self.noise)
        if not self.complete:
            omega, f, clear = self._dipped(kind, omega, f, clear)
        rows, left, right = [], [], []
        for m in range(len(f)):
            at = np.flatnonzero(clear[m])
            i, j = at[:-1], at[1:]
            # Over a stretch without a sign the locus runs along the line, and passes it somewhere.
            flip = f[m, i] * f[m, j] < 0
            left.append(i[flip])
            right.append(j[flip])
            rows.append(np.full(flip.sum(), m))
        i, j = np.concatenate(left), np.concatenate(right)
        near = np.clip(np.searchsorted(self.omega, omega[i]), 0, len(self.omega) - 1)
        floor = 2 * self.noise[:, near].max(axis=0) if len(i) else np.zeros(0)
        m = np.concatenate(rows)
        # A candidate of a pencil, as a rule: |f| there is rounding, and has no sign.
        best = [a + int(np.argmin(np.abs(f[r, a : b + 1]))) for r, a, b in zip(m, i, j, strict=True)]
        between = omega[np.array(best, dtype=int)]
        return omega[i], omega[j], f[m, i], f[m, j], between, m, floor

    def _signs(
        self, kind: Callable, values: np.ndarray, noise: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """`kind` sorted by size at each frequency, and where it has a sign."""
        f = _apart(kind, values, 2 * noise)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            room = np.where(np.abs(values) <= 2 * noise, 0.0, 2 * noise / np.abs(values))
        clear = (np.abs(f) > room) & np.isfinite(noise)
        order = np.argsort(f, axis=0)
        return np.take_along_axis(f, order, 0), np.take_along_axis(clear, order, 0)

    def _dipped(
        self, kind: Callable, omega: np.ndarray, f: np.ndarray, clear: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Without a pencil: follow near misses to their bottom, where two crossings may hide."""
        for _ in range(20):
            here, size = f[:, 1:-1], np.abs(f)
            dip = (size[:, 1:-1] <= size[:, :-2]) & (size[:, 1:-1] <= size[:, 2:])
            dip &= (size[:, 1:-1] < 0.3) & clear[:, 1:-1]
            dip &= (f[:, :-2] * here > 0) & (f[:, 2:] * here > 0)
            # A smooth bottom lies below the middle by less than its neighbours lie above.
            dip &= size[:, 1:-1] < 4 * (np.maximum(size[:, :-2], size[:, 2:]) - size[:, 1:-1])
            at = np.flatnonzero(dip.any(axis=0)) + 1
            at = at[omega[at + 1] > omega[at - 1] * (1 + 1e-7)]
            if not at.size or len(omega) + 2 * at.size > 2 * grid.MOST:
                break
            new = np.unique(np.sqrt(omega[np.r_[at, at]] * omega[np.r_[at - 1, at + 1]]))
            L, bound = self.evaluate.with_accuracy(s_plane(new, self.system.dt))
            g, sure = self._signs(kind, *_with_noise(L, bound))
            where = np.searchsorted(omega, new)
            omega = np.insert(omega, where, new)
            f, clear = np.insert(f, where, g, axis=1), np.insert(clear, where, sure, axis=1)
        return omega, f, clear


def _apart(kind: Callable, values: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """`kind`, with loci that are 0 to rounding on one side for good: they have no direction."""
    f = kind(values)
    return f if kind is log_size else np.where(np.abs(values) <= floor, 1.0, f)


def _seen(omega: np.ndarray, values: np.ndarray, those: np.ndarray) -> np.ndarray:
    """Which crossings are among `those`."""
    near = np.isclose(omega[:, None], omega[None, those], rtol=1e-9, atol=0.0)
    gap = np.abs(values[:, None] - values[None, those])
    return (near & (gap <= 1e-6 * np.abs(values[:, None]))).any(axis=1)


def _with_noise(L: np.ndarray, bound: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (q, k) of L (q, q, k) and bounds of their errors.

    |d lambda| <= cond(V) |dL|_F [Bauer and Fike 1960], and for nearly defective L at most
    (2 |L| + |dL|)^(1 - 1/q) |dL|^(1/q) [Elsner; Stewart and Sun 1990, theorem IV.1.3].
    """
    q = L.shape[0]
    if q == 1:
        return L[0], bound[0]
    if not L.shape[2]:
        return np.zeros((q, 0), complex), np.zeros((q, 0))
    matrices = np.moveaxis(L, -1, 0)
    values, vectors = np.linalg.eig(np.where(np.isfinite(matrices), matrices, 1e300))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        size = np.sqrt((bound**2).sum(axis=(0, 1)))
        if q == 2:  # unit columns at an angle of cosine c
            c = np.abs((vectors[:, :, 0].conj() * vectors[:, :, 1]).sum(axis=1))
            skew = np.sqrt((1 + c) / np.maximum(1 - c, 1e-32))
        else:
            s = np.linalg.svd(vectors, compute_uv=False)
            skew = np.where(s[:, -1] > 0, s[:, 0] / s[:, -1], np.inf)
        norm = np.sqrt((np.abs(L) ** 2).sum(axis=(0, 1)))
        elsner = (2 * norm + size) ** (1 - 1 / q) * size ** (1 / q)
        noise = np.fmin(size * skew, elsner)
    return values.T, np.tile(noise, (q, 1))


def track(values: np.ndarray) -> np.ndarray:
    """Reorder columns of (q, k) so that each row is a continuous path (nearest assignment)."""
    values = np.array(values)
    q, k = values.shape
    if q < 2 or k < 2:
        return values
    if q <= 4:
        every = np.array(list(permutations(range(q))))
        with np.errstate(over="ignore", invalid="ignore"):
            gaps = np.abs(values[:, None, :-1] - values[None, :, 1:])
            costs = sum(gaps[i, every[:, i]] for i in range(q))  # (q!, k - 1)
        best = every[np.argmin(np.where(np.isnan(costs), np.inf, costs), axis=0)]
        place = np.arange(q)
        places = np.empty((k, q), int)
        places[0] = place
        for i in range(k - 1):  # compose the steps
            place = best[i][place]
            places[i + 1] = place
        return np.take_along_axis(values, places.T, axis=0)
    for i in range(1, k):
        cost = np.abs(values[:, i - 1][:, None] - values[:, i][None])
        cost = np.where(np.isfinite(cost), cost, 1e300)
        values[:, i] = values[linear_sum_assignment(cost)[1], i]
    return values
