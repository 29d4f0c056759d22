"""Frequency grids: from poles and zeros, dense at resonances, then refined."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg as sla

from cellsys.errors import BudgetError
from cellsys.response.realization import EPS, Realization, balancing
from cellsys.response.zeros import zeros

PER_DECADE = 40
_ZERO_LIMIT = 300  # above this order the zeros are left to the refinement: they cost more
_SPREAD = np.array([0.0, 0.25, -0.25, 0.5, -0.5, 1.0, -1.0, 2.0, -2.0, 4.0, -4.0])


def features(system: Realization) -> tuple[np.ndarray, float]:
    """Poles and finite zeros in the s plane, and the size below which one counts as 0.

    Discrete roots are read through log(z)/dt.

    Raises
    ------
    BudgetError
        For a sparse A too large to make dense: give the frequencies.
    """
    if system.is_sparse and system.n_states > 1000:
        raise BudgetError(
            f"an automatic frequency grid needs the poles of a dense {system.n_states} x "
            f"{system.n_states} matrix; pass omega"
        )
    system = system.dense()
    if system.n_states == 0:
        return np.zeros(0, complex), 0.0
    A = balancing(system.A)[0]
    roots = sla.eigvals(A)
    if system.n_states <= _ZERO_LIMIT:
        roots = np.concatenate([roots, np.asarray(zeros(system))])
    floor = 10 * system.n_states * EPS * float(sla.norm(A))
    if system.is_discrete:
        roots = roots[np.abs(roots) > floor]
        roots, floor = np.log(roots) / system.dt, max(floor, 1e-13) / system.dt
    return roots, floor


def automatic(system: Realization) -> np.ndarray:
    """Grid (k,) in rad/s, rising: until all poles and zeros together turn L by less than 0.1 rad.

    40 points per decade, and eleven within four half-widths of every resonance whose damping
    ratio is below 0.5. Discrete systems end at the Nyquist frequency pi/dt.
    """
    roots, floor = features(system)
    size = np.abs(roots)
    size = size[size > floor]
    top = np.pi / system.dt if system.is_discrete else np.inf
    # Many roots of one size turn the phase far below (above) it: by up to w sum 1/|p| (sum |p|/w).
    with np.errstate(over="ignore"):
        lo = 10.0 ** np.floor(-1 - np.log10(np.sum(1 / size))) if size.size else 1e-2
        hi = 10.0 ** np.ceil(1 + np.log10(np.sum(size))) if size.size else 1e2
    hi = min(hi, top)
    lo = min(lo, hi / 100)
    count = int(np.clip(PER_DECADE * np.log10(hi / lo), 50, 4000))
    sharp = roots[(roots.imag > floor) & (np.abs(roots.real) < 0.5 * np.abs(roots))]
    width = np.maximum(np.abs(sharp.real), 1e-6 * sharp.imag)
    extra = (sharp.imag[:, None] + width[:, None] * _SPREAD).ravel()
    extra = extra[(extra > lo) & (extra < hi)]
    return np.unique(np.concatenate([np.geomspace(lo, hi, count), [hi], extra]))


def refine(
    values: Callable[[np.ndarray], np.ndarray],
    omega: np.ndarray,
    *,
    turn: float = 0.35,
    ratio: float = 1.5,
    rounds: int = 12,
    limit: int = 20_000,
) -> tuple[np.ndarray, np.ndarray]:
    """Halve intervals (geometrically) until neighbours differ little.

    Parameters
    ----------
    values : callable
        omega (k,) -> complex (c, k).
    omega : array (k,), rising, > 0
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
        a, b = v[:, :-1], v[:, 1:]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            rough = (np.abs(np.angle(b * a.conj())) > turn) | (
                np.abs(np.log(np.abs(b) / np.abs(a))) > np.log(ratio)
            )
        wide = omega[1:] > omega[:-1] * (1 + 1e-9)
        where = np.flatnonzero(rough.any(axis=0) & wide)
        if not where.size or len(omega) + where.size > limit:
            break
        new = np.sqrt(omega[where] * omega[where + 1])
        omega = np.concatenate([omega, new])
        v = np.concatenate([v, values(new)], axis=1)
        rank = np.argsort(omega, kind="stable")
        omega, v = omega[rank], v[:, rank]
    return omega, v
