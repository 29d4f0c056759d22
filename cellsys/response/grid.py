"""Frequency grids: from poles and zeros, so dense that no root turns far unseen, then refined."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg as sla

from cellsys.errors import MemoryBudgetError
from cellsys.spectra.realization import EPS, Realization, balancing
from cellsys.spectra.zeros import zero_values

PER_DECADE = 40
MOST = 20_000  # points of one grid
_ZERO_LIMIT = 300  # above this order the zeros are left to the refinement: they cost more
_TURN = 0.35  # rad that a value may turn between neighbours
_TOGETHER = 2.0  # rad that all roots together may: below a half turn, what is seen is what is there
_SPREAD = np.concatenate([[0.25, 0.5, 1.0, 2.0], 4.0 * 3.0 ** np.arange(10)])
_CHUNK = 2_000_000  # angles at a time


def features(system: Realization) -> tuple[np.ndarray, float]:
    """Poles and finite zeros, in the s plane or the z plane, and the size that counts as 0.

    Raises
    ------
    MemoryBudgetError
        For a sparse A too large to make dense: give the frequencies.
    """
    if system.is_sparse and system.n_states > 1000:
        raise MemoryBudgetError(
            f"an automatic frequency grid needs the poles of a dense {system.n_states} x "
            f"{system.n_states} matrix; pass omega"
        )
    system = system.dense()
    if system.n_states == 0:
        return np.zeros(0, complex), 0.0
    A = balancing(system.A)[0]
    roots = np.linalg.eigvals(A).astype(complex)
    if system.n_states <= _ZERO_LIMIT:
        roots = np.concatenate([roots, zero_values(system)[0]])
    return roots, 10 * system.n_states * EPS * float(sla.norm(A))


def automatic(system: Realization) -> np.ndarray:
    """Grid (k,) in rad/s, rising: until all poles and zeros together turn L by less than 0.1 rad.

    40 points per decade; more on both sides of every resonance whose damping ratio is below 0.5,
    in distances from a quarter of its half-width upwards; and as many more as keep the turns of
    all poles and zeros together below 2 rad from point to point. Each root turns by less than
    180 deg over an interval, so that nothing is hidden by whole turns. Discrete systems end at
    the Nyquist frequency pi/dt: z^-d turns on to there.
    """
    roots, floor = features(system)
    dt = system.dt
    if system.is_discrete:
        inner = np.abs(roots) <= floor
        with np.errstate(divide="ignore"):
            plane = np.log(roots[~inner]) / dt
        # z^-d turns by d dt per rad/s, and so does, at most, a pole near z = 0.
        size = np.concatenate([np.minimum(np.abs(plane), 1 / dt), np.full(inner.sum(), 1 / dt)])
        floor, top = max(floor, 1e-13) / dt, np.pi / dt
    else:
        plane, size, top = roots, np.abs(roots), np.inf
    size = size[size > floor]
    # Many roots of one size turn the phase far below (above) it: by up to w sum 1/|p| (sum |p|/w).
    with np.errstate(over="ignore"):
        lo = 10.0 ** np.floor(-1 - np.log10(np.sum(1 / size))) if size.size else 1e-2
        hi = 10.0 ** np.ceil(1 + np.log10(np.sum(size))) if size.size else 1e2
    hi = top if system.is_discrete else hi
    lo = min(lo, hi / 100)
    count = int(np.clip(PER_DECADE * np.log10(hi / lo), 50, 4000))
    sharp = plane[(plane.imag > floor) & (np.abs(plane.real) < 0.5 * np.abs(plane))]
    width = np.maximum(np.abs(sharp.real), 1e-6 * sharp.imag)[:, None] * _SPREAD
    width = np.where(width < np.maximum(0.1 * sharp.imag[:, None], 5 * width[:, :1]), width, 0.0)
    extra = (sharp.imag[:, None, None] + width[:, :, None] * np.array([-1.0, 1.0])).ravel()
    extra = extra[(extra > lo) & (extra < hi)]
    omega = np.unique(np.concatenate([np.geomspace(lo, hi, count), [hi], extra]))
    return _divided(omega, roots, dt)


def _divided(omega: np.ndarray, roots: np.ndarray, dt: float) -> np.ndarray:
    """Cut every interval into equal parts over which all roots together turn little."""
    s = np.exp(1j * omega * dt) if dt > 0 else 1j * omega
    turn = np.zeros(len(omega) - 1)
    step = max(1, _CHUNK // max(len(omega), 1))
    for lo in range(0, len(roots), step):
        away = s[:, None] - roots[lo : lo + step]
        turn += np.abs(np.angle(away[1:] * away[:-1].conj())).sum(axis=1)
    parts = np.maximum(np.ceil(turn / _TOGETHER).astype(int), 1)
    if parts.sum() > MOST:
        parts = np.maximum((parts * (MOST / parts.sum())).astype(int), 1)
    if parts.sum() == len(parts):
        return omega
    start = np.repeat(omega[:-1], parts)
    step_of = np.repeat(np.diff(omega) / parts, parts)
    within = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.append(start + within * step_of, omega[-1])


def refine(
    values: Callable[[np.ndarray], np.ndarray],
    omega: np.ndarray,
    *,
    match: Callable[[np.ndarray], np.ndarray] | None = None,
    about: tuple[float, ...] = (0.0,),
    turn: float = _TURN,
    ratio: float = 1.5,
    rounds: int = 12,
    limit: int = MOST,
) -> tuple[np.ndarray, np.ndarray]:
    """Halve intervals (geometrically) until neighbours differ little.

    Parameters
    ----------
    values : callable
        omega (k,) -> complex (c, k).
    omega : array (k,), rising, > 0
    match : callable, optional
        Puts the rows of (c, k) in such an order that each is one path.
    about : tuple of float
        Points that sizes and directions are seen from.
    turn : float
        Largest change of direction between neighbours, rad.
    ratio : float
        Largest ratio of sizes between neighbours.
    rounds, limit : int
        Most rounds, most points.

    Returns
    -------
    omega : array (K,)
    v : complex array (c, K)
    """
    v = values(omega)
    for _ in range(rounds):
        v = v if match is None else match(v)
        rough = np.zeros(len(omega) - 1, bool)
        for centre in about:
            a, b = v[:, :-1] - centre, v[:, 1:] - centre
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                rough |= (
                    (np.abs(np.angle(b * a.conj())) > turn)
                    | (np.abs(np.log(np.abs(b) / np.abs(a))) > np.log(ratio))
                ).any(axis=0)
        wide = omega[1:] > omega[:-1] * (1 + 1e-9)
        where = np.flatnonzero(rough & wide)
        if not where.size or len(omega) + where.size > limit:
            break
        new = np.sqrt(omega[where] * omega[where + 1])
        v = np.insert(v, where + 1, values(new), axis=1)
        omega = np.insert(omega, where + 1, new)
    return omega, v
