"""Where eigenvalue loci cross the negative real axis and the unit circle.

Crossings are changes of sign of *sorted* values (of log |lambda|, or of sin arg lambda): the
largest, the second largest and so on are continuous in the frequency whichever locus they belong
to, so that nothing depends on telling close loci apart.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cellsys.response import grid
from cellsys.response.brackets import find_roots
from cellsys.response.eigenvalue_loci import Loci, Points
from cellsys.spectra.eigenvalues import eigenvalues_with_bounds
from cellsys.spectra.resolvent import s_plane

_UNKNOWN = 0.05  # relative error beyond which a value says nothing: a pole or zero on the boundary
_CUT = 1.83  # rad from the negative real axis, between 2 pi/4 and 2 pi/3: see `crossings`
Kind = Callable[[np.ndarray], np.ndarray]


def log_size(values: np.ndarray) -> np.ndarray:
    """log |lambda|: 0 on the unit circle."""
    with np.errstate(divide="ignore"):
        return np.maximum(np.log(np.abs(values)), -800.0)


def sine(values: np.ndarray) -> np.ndarray:
    """-Im lambda / |lambda|: 0 on the real axis. Continuous but where lambda is 0 or infinite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        turned = -values.imag / np.abs(values)
    return np.where(np.isfinite(turned), turned, 1.0)


def turn(values: np.ndarray) -> np.ndarray:
    """arg(-lambda), rad: 0 on the negative real axis alone; its jump of 2 pi lies at `_CUT`."""
    return np.angle(-values * np.exp(1j * (np.pi - _CUT))) - (np.pi - _CUT)


_KINDS = (log_size, sine, turn)


def crossings(loci: Loci) -> tuple[Points, Points]:
    """All frequencies inside the grid where a locus is real and negative, and where it has modulus
    one: each with the locus there (k,).
    """
    none = Points(np.zeros(0), np.zeros(0, complex), np.zeros(0))
    if not loci.omega.size:
        return none, none
    # Sorted sines miss what a symmetric loop does: one locus upwards through -1 and another
    # downwards through +1 at one frequency. Sorted angles see that, but miss a crossing next to
    # which another locus passes the cut. What both see counts once.
    parts = [_brackets(loci, kind) for kind in _KINDS[: 2 if loci.raw.shape[0] == 1 else 3]]
    which = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    a, b, fa, fb, near, row, floor = (np.concatenate(p) for p in zip(*parts, strict=True))
    if not len(a):
        return none, none

    def picked(values: np.ndarray, i: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The sorted value of each bracket, and the place of its locus."""
        g = log_size(values)
        for k, kind in enumerate(_KINDS[1 : len(parts)], 1):
            g = np.where(which[i] == k, _apart(kind, values, floor[i]), g)
        at = np.argsort(g, axis=0)[row[i], np.arange(len(i))]
        return g[at, np.arange(len(i))], at

    omega = find_roots(
        lambda w, i: picked(loci.eigenvalues(w), i)[0], a, b, fa, fb, near,
        # Most changes of sign of an angle are jumps: halving them to the end costs most.
        width=np.where(which == 2, 1e-7, 0.0),
    )  # fmt: skip
    L, bound = loci.evaluate.with_accuracy(s_plane(omega, loci.system.dt))
    L = np.where(np.isfinite(L), L, 1e300)
    values, noise = eigenvalues_with_bounds(L, np.where(np.isfinite(bound), bound, np.inf))
    every = np.arange(len(a))
    left, at = picked(values, every)
    values, noise = values[at, every], noise[at, every]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        share = np.where(values != 0, noise / np.abs(values), np.inf)
    # A change of sign that is no crossing: a pole or a zero on the boundary.
    kept = (share < _UNKNOWN) & (np.abs(left) <= np.maximum(1e-6, 2 * share))
    kept &= (which == 0) | (values.real < 0)
    kept &= ~_seen_before(omega, values, which, kept)
    rank = np.argsort(omega, kind="stable")
    real, unit = (rank[(kept & ((which > 0) == side))[rank]] for side in (True, False))
    return (
        Points(omega[real], values[real], noise[real]),
        Points(omega[unit], values[unit], noise[unit]),
    )


def _brackets(loci: Loci, kind: Kind) -> tuple[np.ndarray, ...]:
    """Of each change of sign of a sorted value: its ends, the values there, a point between that
    is nearest to zero, the row, and the size that counts as zero.
    """
    omega = loci.omega
    f, clear = _signs(kind, loci.raw, loci.noise)
    if not loci.complete:
        omega, f, clear = _dipped(loci, kind, omega, f, clear)
    rows, left, right = [], [], []
    for row in range(len(f)):
        at = np.flatnonzero(clear[row])
        i, j = at[:-1], at[1:]
        # Over a stretch without a sign the locus runs along the line, and passes it somewhere.
        flip = f[row, i] * f[row, j] < 0
        left.append(i[flip])
        right.append(j[flip])
        rows.append(np.full(flip.sum(), row))
    i, j, m = np.concatenate(left), np.concatenate(right), np.concatenate(rows)
    if kind is turn and loci.complete and len(i):
        # Where the pencil has no candidate, no locus is real: a jump.
        still = np.append(0, np.cumsum((np.abs(sine(loci.raw)) < 1e-4).any(axis=0)))
        real = still[j + 1] > still[i]
        i, j, m = i[real], j[real], m[real]
    near = np.clip(np.searchsorted(loci.omega, omega[i]), 0, len(loci.omega) - 1)
    floor = 2 * loci.noise[:, near].min(axis=0) if len(i) else np.zeros(0)
    # A candidate of a pencil, as a rule: |f| there is rounding, and has no sign.
    best = [a + int(np.argmin(np.abs(f[r, a : b + 1]))) for r, a, b in zip(m, i, j, strict=True)]
    between = omega[np.array(best, dtype=int)]
    return omega[i], omega[j], f[m, i], f[m, j], between, m, floor


def _signs(kind: Kind, values: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`kind` sorted by size at each frequency, and where it has a sign."""
    f = _apart(kind, values, 2 * noise)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        room = np.where(np.abs(values) <= 2 * noise, 0.0, 2 * noise / np.abs(values))
    clear = (np.abs(f) > room) & np.isfinite(noise)
    order = np.argsort(f, axis=0)
    return np.take_along_axis(f, order, 0), np.take_along_axis(clear, order, 0)


def _dipped(
    loci: Loci, kind: Kind, omega: np.ndarray, f: np.ndarray, clear: np.ndarray
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
        L, bound = loci.evaluate.with_accuracy(s_plane(new, loci.system.dt))
        g, sure = _signs(kind, *eigenvalues_with_bounds(L, bound))
        where = np.searchsorted(omega, new)
        omega = np.insert(omega, where, new)
        f, clear = np.insert(f, where, g, axis=1), np.insert(clear, where, sure, axis=1)
    return omega, f, clear


def _seen_before(
    omega: np.ndarray, values: np.ndarray, which: np.ndarray, kept: np.ndarray
) -> np.ndarray:
    """Which crossings found by `turn` were found by `sine`, each of these counting once."""
    known = list(np.flatnonzero(kept & (which == 1)))
    seen = np.zeros(len(omega), bool)
    for i in np.flatnonzero(kept & (which == 2)):
        for j in known:
            near = abs(omega[i] - omega[j]) <= 1e-9 * omega[i]
            if near and abs(values[i] - values[j]) <= 1e-6 * abs(values[i]):
                seen[i] = True
                known.remove(j)
                break
    return seen


def _apart(kind: Kind, values: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """`kind`, with loci that are 0 to rounding on one side for good: they have no direction."""
    f = kind(values)
    return f if kind is log_size else np.where(np.abs(values) <= floor, 1.0, f)
