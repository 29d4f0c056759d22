"""Margins of a scalar loop with a pure delay, L(s) exp(-s tau), exactly: no Pade form.

A delay turns L and does not change its size, so that the gain crossings are those of L. From the
number of closed-loop poles in the right half-plane without delay, those with it follow: at the
delay theta/w of a gain crossing w a pair passes the axis, to the right where |L| falls through 1
there and to the left where it rises [Walton and Marshall, IEE Proceedings D 134 (1987) 101].
"""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise

import numpy as np

from cellsys.errors import DataError, ParameterError
from cellsys.response import grid
from cellsys.response.brackets import find_roots
from cellsys.response.disk import climbed, size_of_values
from cellsys.response.eigenvalue_loci import Loci
from cellsys.spectra.realization import EPS, Realization
from cellsys.spectra.resolvent import s_plane

_TURN = 0.35  # rad that the delay turns L at most from point to point
_SAFE = 1.5  # |L| between points of a grid over that at its points: what it is refined to
_SECTION = 20  # points of the grid of L looked at together


class DelayedLoci:
    """L(j omega) exp(-j omega tau) of one channel in continuous time, as far as it matters.

    Phase crossings are infinitely many; the grid ends where |L| has come to stay below that of
    the crossing nearest to 1 from below, so that no later one can be the gain margin.

    Parameters
    ----------
    loci : Loci
        Of L.
    delay : float
        tau > 0, s.
    gain : array (b, 2)
        Gain crossings of L and their phases above -180 deg, without delay.

    Attributes
    ----------
    omega : array (k,), rad/s
    raw, values : complex array (1, k)
    phase_crossings : array (a, 2)
        Frequencies where the delayed loop is real and negative, and 1/|L| there.

    Raises
    ------
    ParameterError
        Where the delay turns L by more than `grid.MOST` points can follow, or |L| is 1 or more at
        infinity: no delay, however short, is survived.
    """

    complete = True

    def __init__(self, loci: Loci, delay: float, gain: np.ndarray) -> None:
        self.system, self.delay, self.ends = loci.system, delay, loci.ends
        self._loci, self._gain = loci, gain
        through = abs(float(self.system.D[0, 0]))
        if through >= 1 - 4 * EPS:
            raise ParameterError(
                f"|L| goes to {through:g} at high frequency, and with any delay a loop that does "
                "not roll off below 1 has infinitely many poles on or right of the axis; give L "
                "its roll-off"
            )
        self.omega, self.phase_crossings = self._followed()
        self.raw = self.values = self(self.omega)[None, :]

    def __call__(self, omega: np.ndarray) -> np.ndarray:
        """The delayed loop at frequencies (k,)."""
        L = self._loci.evaluate(s_plane(omega, 0.0))[0, 0]
        return L * np.exp(-1j * omega * self.delay)

    @cached_property
    def phase(self) -> np.ndarray:
        """rad (1, k), from the low-frequency asymptote on."""
        inner = np.clip(self.omega, self._loci.omega[0], self._loci.omega[-1])
        known = np.interp(np.log(inner), np.log(self._loci.omega), self._loci.phase[0])
        near = known - self.omega * self.delay
        angle = np.angle(self.raw[0])
        return (angle + 2 * np.pi * np.round((near - angle) / (2 * np.pi)))[None, :]

    def gain_crossings(self) -> np.ndarray:
        """Rows (frequency, phase above -180 deg in (-180, 180]) with the delay."""
        rows = self._gain.copy()
        inner = np.isfinite(rows[:, 0])
        rows[inner, 1] -= np.degrees(rows[inner, 0] * self.delay)
        rows[:, 1] = 180.0 - (180.0 - rows[:, 1]) % 360.0
        return rows

    def unstable(self, without: int) -> int:
        """Closed-loop poles in the right half-plane, from their number without delay."""
        count = without
        for omega, above in self._gain[self._gain[:, 0] > 0]:
            moved = self._moved(omega)
            turns = (self.delay * omega - np.radians(above % 360.0)) / (2 * np.pi)
            passed = int(np.floor(turns + 1e-12)) + 1 if turns >= 0 else 0
            if above == 0.0 and moved < 0:
                passed -= 1  # on the axis without delay: counted on neither side
            count += 2 * passed * moved
        return count

    def on_the_axis(self) -> int:
        """Pairs that this delay puts on the axis, to rounding."""
        return int(np.count_nonzero(np.abs(self.gain_crossings()[:, 1]) < 1e-10))

    def disk(self) -> tuple[float, float]:
        """2 over the largest |(1 - L)/(1 + L)|, climbed from the grid, and where."""
        omega, peak = climbed(
            lambda w: size_of_values(self(w)[None, None, :]), self.omega,
            size_of_values(self.raw[None]),
        )  # fmt: skip
        return (2.0 / peak if peak > 0 else np.inf), omega

    def _moved(self, omega: float) -> int:
        """+1 where |L| falls through 1, -1 where it rises, 0 where it touches."""
        a, b = np.abs(self(omega * (1 + np.array([-1e-5, 1e-5]))))
        return int(np.sign(a - b)) if abs(a - b) > 1e-12 else 0

    def _followed(self) -> tuple[np.ndarray, np.ndarray]:
        """The grid, and the phase crossings on it."""
        own = self._loci.omega
        if not len(own):
            raise DataError("L is nowhere finite on the imaginary axis: no margins")
        size = np.abs(self._loci.raw[0])
        first = min(own[0], 0.1 * _TURN / self.delay)
        below = np.geomspace(first, own[0], max(2, int(4 * np.log2(own[0] / first)) + 2))[:-1]
        starts = np.concatenate([below, own]) if first < own[0] else own
        beyond = own[-1] * 2.0 ** np.arange(1, 60)
        ends = np.concatenate([starts[:-1:_SECTION], starts[-1:], beyond])
        grids, rows, nearest, room = [], [], 0.0, grid.MOST
        through = abs(float(self.system.D[0, 0]))
        for lo, hi in pairwise(ends):
            here = float(np.abs(self(np.array([lo])))[0])
            later = max(size[own >= lo].max(initial=0.0) * _SAFE, here * _SAFE, through)
            if lo >= own[0] and (later < nearest or later == 0.0):
                break
            inside = starts[(starts > lo) & (starts < hi)]
            points = _divided(np.concatenate([[lo], inside, [hi]]), self.delay)
            room -= len(points)
            if room < 0:
                raise ParameterError(
                    f"a delay of {self.delay:g} s turns this loop too often up to {hi:.3g} rad/s, "
                    f"where |L| is still {here:.3g}: more than {grid.MOST} points; shorten the "
                    "delay or give the loop its roll-off"
                )
            grids.append(points)
            rows.append(self._crossed(points))
            nearest = max(nearest, (1 / rows[-1][rows[-1][:, 1] >= 1, 1]).max(initial=0.0))
        return np.unique(np.concatenate(grids)), np.concatenate(rows)

    def _crossed(self, omega: np.ndarray) -> np.ndarray:
        """Rows (frequency, 1/|L|) of changes of sign of sin arg where L is negative."""

        def sine(w: np.ndarray, _: np.ndarray) -> np.ndarray:
            values = self(w)
            return np.asarray(values.imag / np.abs(values))

        with np.errstate(divide="ignore", invalid="ignore"):
            values = self(omega)
            f = values.imag / np.abs(values)
            turn = np.abs(np.angle(values[1:] * values[:-1].conj()))
        negative = values.real < 0
        # Neighbours turn by less than a half: one on the negative side at least.
        flip = np.flatnonzero((f[:-1] * f[1:] < 0) & (negative[:-1] | negative[1:]) & (turn < 2.0))
        a, b = omega[flip], omega[flip + 1]
        roots = find_roots(sine, a, b, f[flip], f[flip + 1], 0.5 * (a + b), np.zeros(len(a)))
        roots = np.concatenate([roots, omega[:-1][(f[:-1] == 0) & negative[:-1]]])
        found = self(roots)
        found, roots = found[found.real < 0], roots[found.real < 0]
        rank = np.argsort(roots, kind="stable")
        return np.column_stack([roots[rank], 1 / np.abs(found[rank])])


def _divided(omega: np.ndarray, delay: float) -> np.ndarray:
    """Points between which the delay turns by less than `_TURN`; too many: as many as are."""
    parts = np.maximum(np.ceil(np.diff(omega) * delay / _TURN), 1.0)
    if parts.sum() > grid.MOST:
        return np.zeros(grid.MOST + 1)
    parts = parts.astype(int)
    start = np.repeat(omega[:-1], parts)
    within = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.append(start + within * np.repeat(np.diff(omega) / parts, parts), omega[-1])


def with_samples_of_delay(system: Realization, delay: float) -> Realization:
    """A discrete loop behind z^-d, d = delay/dt: d states more.

    Raises
    ------
    ParameterError
        When the delay is no whole number of samples, or of more than 2000.
    """
    count = delay / system.dt
    d = int(np.rint(count))
    if abs(count - d) > 1e-9 * max(count, 1.0) or d > 2000:
        raise ParameterError(
            f"delay = {delay:g} s must be a whole number (up to 2000) of the sampling time "
            f"{system.dt:g} s of a discrete loop; sample the delayed continuous loop instead"
        )
    n = system.n_states
    A, B = np.zeros((n + d, n + d)), np.zeros((n + d, 1))
    A[:n, :n], A[:n, n] = system.A, system.B[:, 0]
    A[n:, n:] = np.eye(d, k=1)
    B[-1] = 1.0
    C = np.zeros((1, n + d))
    C[:, :n], C[:, n] = system.C, system.D[0]
    return Realization(A, B, C, np.zeros((1, 1)), dt=system.dt)
