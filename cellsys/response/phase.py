"""Phase of a response as a continuous curve that starts from its low-frequency asymptote.

    G(s) -> K/s^m as s -> 0  (z - 1 for s in discrete time):  phase -> -90 m deg for K > 0,
                                                              -90 m - 180 deg for K < 0

so that m integrators start at -90 m deg and m zeros at the origin at +90 m deg. A pole on the
boundary turns by -180 deg, a zero by +180 deg: both are passed on their right.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellsys.errors import MemoryBudgetError
from cellsys.response import grid
from cellsys.spectra.realization import Realization
from cellsys.spectra.resolvent import Resolvent, s_plane
from cellsys.spectra.zeros import zero_values

_SHARP = 1e-7  # damping ratio below which a root counts as on the boundary
_DECADES = 4  # below the grid that the asymptote is looked for


def continuous_phase(system: Realization, omega: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Phase (p, m, k) in rad of `response` at `omega`, from the asymptote on.

    Between the asymptote and the frequencies asked for the response is followed on a grid of its
    own. A sparse system too large for one is followed along `omega` alone and starts in
    (-270, 90] deg.
    """
    try:
        own = grid.automatic(system)
    except MemoryBudgetError:
        return anchored(np.unwrap(np.angle(response), axis=-1), np.zeros(response.shape[:2]))
    p, m, k = response.shape
    if not (p and m and k):
        return np.zeros((p, m, k))
    evaluate = Resolvent(system)
    size = np.abs(omega)
    low, slope = _asymptote(evaluate, system.dt, min(own[0], size[size > 0].min(initial=np.inf)))
    inner = np.concatenate([[low.min()], own, size[size > 0]])
    inner = np.unique(np.append(inner, low.ravel()))
    inner = inner[inner <= max(size.max(), low.max())]
    path, values = grid.refine(lambda w: evaluate(s_plane(w, system.dt)).reshape(p * m, -1), inner)
    usable = np.isfinite(values).all(axis=0)
    path, values = path[usable], values[:, usable]
    below, bound = size < low.max(), np.zeros((p, m, k))
    if below.any():
        bound[..., below] = evaluate.with_accuracy(s_plane(omega[below], system.dt))[1]
    out = np.empty((p, m, k))
    for number, (i, j) in enumerate(np.ndindex(p, m)):
        from_ = int(np.searchsorted(path, low[i, j] * (1 - 1e-12)))
        w, turned = path[from_:], np.zeros(len(path) - from_)
        step = np.angle(values[number, from_ + 1 :] * values[number, from_:-1].conj())
        turned[1:] = np.cumsum(step + _jumps(system, i, j, w, step))
        start = np.angle(values[number, from_]) if len(w) else 0.0
        curve = anchored(start + turned, slope[i, j])
        near = np.interp(np.log(np.maximum(size, w[0])), np.log(w), curve)
        # The angle itself is that of the response given; the curve says which turn it is on.
        angle = np.where(omega < 0, -1.0, 1.0) * np.angle(response[i, j])
        shown = angle + 2 * np.pi * np.round((near - angle) / (2 * np.pi))
        # Where the response is rounding, the asymptote's own angle.
        lost = (response[i, j] == 0) | (below & (bound[i, j] > 0.3 * np.abs(response[i, j])))
        out[i, j] = np.where(omega < 0, -1.0, 1.0) * np.where(lost, near, shown)
    return out


def anchored(curve: np.ndarray, order: np.ndarray | float) -> np.ndarray:
    """Whole turns added so that the first value lies in (-90 m - 270, -90 m + 90] deg, m = order.

    Parameters
    ----------
    curve : array (..., k), rad
    order : array (...)
        Number m of poles at the origin, less that of zeros.
    """
    if not curve.shape[-1]:
        return curve
    middle = -np.pi / 2 * (np.asarray(order, dtype=float)[..., None] + 1)
    turns = np.ceil((curve[..., :1] - middle) / (2 * np.pi) - 0.5 - 1e-6)
    return curve - 2 * np.pi * turns


def _asymptote(evaluate: Resolvent, dt: float, low: float) -> tuple[np.ndarray, np.ndarray]:
    """Lowest frequency (p, m) at which each entry is known, and the power m it falls by there."""
    trial = low * 10.0 ** np.arange(-_DECADES, 3 * _DECADES)
    trial = trial[trial < 0.9 * np.pi / dt] if dt > 0 else trial
    count = len(trial)
    G, bound = evaluate.with_accuracy(s_plane(np.concatenate([trial, 1.1 * trial]), dt))
    with np.errstate(divide="ignore", invalid="ignore"):
        good = np.isfinite(G) & (bound <= 0.3 * np.abs(G))
        power = -np.log(np.abs(G[..., count:]) / np.abs(G[..., :count])) / np.log(1.1)
        good = good[..., :count] & good[..., count:] & np.isfinite(power)
        near = good & (np.abs(power - np.round(power)) < 0.1)  # a power of the frequency
    good = np.where(near.any(axis=-1, keepdims=True), near, good)
    at = np.argmax(good, axis=-1)
    slope = np.take_along_axis(power, at[..., None], axis=-1)[..., 0]
    return trial[at], np.where(good.any(axis=-1), np.round(slope), 0.0)


def _jumps(system: Realization, i: int, j: int, omega: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Whole turns to add to the steps that pass a pole or a zero on the boundary."""
    more = np.zeros(len(step))
    where = np.flatnonzero(np.abs(step) > np.pi / 2)
    if not where.size:
        return more
    part = replace(
        system.dense(), B=system.B[:, j : j + 1], C=system.C[i : i + 1],
        D=system.D[i : i + 1, j : j + 1], inputs=system.inputs[j : j + 1],
        outputs=system.outputs[i : i + 1],
    )  # fmt: skip
    poles, zeros = np.linalg.eigvals(part.A), zero_values(part)[0]
    lo, hi = omega[where, None] * (1 - _SHARP), omega[where + 1, None] * (1 + _SHARP)
    expected = np.zeros(len(where))
    for roots, sign in ((poles, -1.0), (zeros, 1.0)):
        if system.is_discrete:
            with np.errstate(divide="ignore"):
                roots = np.log(roots[roots != 0].astype(complex)) / system.dt
        roots = roots[(np.abs(roots.real) <= _SHARP * np.abs(roots)) & (roots.imag > 0)]
        expected += sign * np.pi * ((lo <= roots.imag) & (roots.imag <= hi)).sum(axis=1)
    wrapped = (step[where] - expected + np.pi) % (2 * np.pi) - np.pi
    more[where] = wrapped + expected - step[where]
    return more
