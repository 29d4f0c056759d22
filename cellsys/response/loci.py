"""Eigenvalue loci of a return ratio L(j omega), with all crossings bracketed and polished.

One locus for a scalar L; for a square L (q x q) the q eigenvalues, tracked along the frequencies
(MacFarlane and Postlethwaite, Int. J. Control 25 (1977) 81): det(I + k L) = 0 where k times a
locus passes -1.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq, linear_sum_assignment, minimize_scalar

from cellsys.response import grid
from cellsys.response.realization import EPS, Realization
from cellsys.response.resolvent import Resolvent, s_plane


class Loci:
    """L of a system on an extended, refined grid.

    Attributes
    ----------
    omega : array (k,)
    values : complex array (q, k)
        Tracked eigenvalues of L.
    noise : array (q, k)
        Error bound of each value.
    L : complex array (q, q, k)
    evaluate : Resolvent
    """

    def __init__(self, system: Realization, omega: np.ndarray | None = None) -> None:
        self.system = system
        self.evaluate = Resolvent(system)
        if system.n_inputs == 0:
            self.omega, self.L = np.zeros(0), np.zeros((0, 0, 0), complex)
            self.values, self.noise = np.zeros((0, 0), complex), np.zeros((0, 0))
            return
        if omega is None:
            start = self._extended(grid.automatic(system))
            self.omega, _ = grid.refine(self._raw, start)
        else:
            self.omega = np.unique(omega)
        L, bound = self.evaluate.with_accuracy(s_plane(self.omega, system.dt))
        usable = np.isfinite(L).all(axis=(0, 1))
        self.omega, L, bound = self.omega[usable], L[:, :, usable], bound[:, :, usable]
        self.L = L
        q = L.shape[0]
        if q == 1:
            self.values, self.noise = L[0], bound[0]
            return
        matrices, size = np.moveaxis(L, -1, 0), np.sqrt((bound**2).sum(axis=(0, 1)))
        values, vectors = np.linalg.eig(matrices)
        skew = np.array([np.linalg.cond(V) for V in vectors])
        self.values = track(values.T)
        self.noise = np.tile(size * skew, (q, 1))

    def _raw(self, omega: np.ndarray) -> np.ndarray:
        """What the refinement looks at: the loci, and 1 + them (passing -1 closely)."""
        L = self.evaluate(s_plane(omega, self.system.dt))
        L = np.where(np.isfinite(L), L, 1e300)
        values = L[0] if L.shape[0] == 1 else track(np.linalg.eigvals(np.moveaxis(L, -1, 0)).T)
        return np.concatenate([values, 1.0 + values])

    def _extended(self, omega: np.ndarray) -> np.ndarray:
        """Add decades at the ends while a locus may still cross the unit circle out there."""
        edge = np.geomspace(0.1, 1.0, grid.PER_DECADE, endpoint=False)
        D = self.system.D
        high = 0.0 if not D.size else float(np.abs(np.linalg.eigvals(D)).max(initial=0.0))
        for _ in range(40):
            size = np.abs(self._raw(omega[-2:])[: D.shape[0]])
            falling = np.all(size[:, 1] < size[:, 0])
            if self.system.is_discrete or high >= 1 or not falling or size[:, 1].max() <= 0.5:
                break
            omega = np.concatenate([omega, edge[1:] * omega[-1] * 10, [omega[-1] * 10]])
        for _ in range(40):
            size = np.abs(self._raw(omega[:2])[: D.shape[0]])
            steep = size[:, 0] > size[:, 1] * (1 + 0.1 * (1 - omega[0] / omega[1]))
            if not np.any(steep & (size[:, 0] < 2)):
                break
            omega = np.concatenate([edge * omega[0], omega])
        return omega

    def scalar(self, omega: float, near: complex) -> complex:
        """The locus value at `omega` that lies nearest to `near`."""
        L = self.evaluate.at(complex(s_plane(np.array([omega]), self.system.dt)[0]))
        if L.shape == (1, 1):
            return complex(L[0, 0])
        values = np.linalg.eigvals(L)
        return complex(values[np.argmin(np.abs(values - near))])

    def crossings(
        self,
        kind: Callable[[complex], float],
        noise: Callable[[np.ndarray, np.ndarray], np.ndarray],
    ) -> list[tuple[float, complex]]:
        """All frequencies where ``kind(locus) = 0``, each with the locus there.

        `noise` gives, from values and error bounds, the size below which `kind` has no sign.
        Brackets are changes of sign between neighbours on the grid; a near miss (a local minimum
        of the size of `kind`) is followed to its bottom, where two crossings may hide.
        """
        found: list[tuple[float, complex]] = []
        for value, bound in zip(self.values, self.noise, strict=True):
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                f = np.array([kind(v) for v in value])
                clear = np.abs(f) > noise(value, bound)
            clear &= np.isfinite(f)
            at = np.flatnonzero(clear)
            for i, j in pairwise(at):
                # A long stretch without a sign is a locus that runs along the line, no crossing.
                if f[i] * f[j] < 0 and (j - i <= 3 or self.omega[j] < 1.05 * self.omega[i]):
                    found.append(self._polish(kind, value, i, j))
            for i in at[(at > 0) & (at < len(f) - 1)]:
                left, here, right = f[i - 1], f[i], f[i + 1]
                dip = abs(here) <= abs(left) and abs(here) <= abs(right) and abs(here) < 0.3
                if dip and left * here > 0 and right * here > 0:
                    found.extend(self._dip(kind, value, i, np.sign(here)))
        return sorted(found, key=lambda pair: pair[0])

    def _between(self, value: np.ndarray, i: int, j: int) -> Callable[[float], complex]:
        a, b = np.log(self.omega[i]), np.log(self.omega[j])

        def at(x: float) -> complex:
            t = (x - a) / (b - a)
            return self.scalar(float(np.exp(x)), (1 - t) * value[i] + t * value[j])

        return at

    def _polish(
        self, kind: Callable[[complex], float], value: np.ndarray, i: int, j: int
    ) -> tuple[float, complex]:
        at = self._between(value, i, j)
        lo, hi = np.log(self.omega[i]), np.log(self.omega[j])
        f_lo, f_hi = kind(at(lo)), kind(at(hi))
        if f_lo * f_hi >= 0:  # the value at an end is the crossing itself
            x = lo if abs(f_lo) < abs(f_hi) else hi
        else:
            x = brentq(lambda x: kind(at(x)), lo, hi, xtol=4 * EPS, rtol=8 * EPS)
        return float(np.exp(x)), at(x)

    def _dip(
        self, kind: Callable[[complex], float], value: np.ndarray, i: int, sign: float
    ) -> list[tuple[float, complex]]:
        found = []
        lo, mid, hi = np.log(self.omega[i - 1 : i + 2])
        low, high = self._between(value, i - 1, i), self._between(value, i, i + 1)

        def at(x: float) -> complex:
            return low(x) if x < mid else high(x)

        best = minimize_scalar(
            lambda x: sign * kind(at(x)), bounds=(lo, hi), method="bounded",
            options={"xatol": 1e-10},
        )
        if best.fun < 0:
            for a, b in ((lo, best.x), (best.x, hi)):
                x = brentq(lambda x: kind(at(x)), a, b, xtol=4 * EPS, rtol=8 * EPS)
                found.append((float(np.exp(x)), at(x)))
        return found


def track(values: np.ndarray) -> np.ndarray:
    """Reorder columns of (q, k) so that each row is a continuous path (nearest assignment)."""
    values = np.array(values)
    for i in range(1, values.shape[1]):
        cost = np.abs(values[:, i - 1][:, None] - values[:, i][None])
        cost = np.where(np.isfinite(cost), cost, 1e300)
        values[:, i] = values[linear_sum_assignment(cost)[1], i]
    return values
