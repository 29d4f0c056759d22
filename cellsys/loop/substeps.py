"""The heading followed inside a step of a plant that has a step of its own.

Runs of such plants hold one heading over each step. Their error estimate is the difference to a
run in which the heading turns in sub-steps, after a sensed direction that is taken quadratic in
time, and drives the plant by the mean of its harmonics.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

SUBSTEPS = 8


def headings_inside(
    turn: Callable[[np.ndarray, np.ndarray, float], np.ndarray],
    p: np.ndarray,
    directions: tuple[np.ndarray | None, np.ndarray, np.ndarray],
    dt: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Headings (SUBSTEPS, ...) rad in the middles of the sub-steps, and p at the end.

    Parameters
    ----------
    turn : callable
        ``turn(p, d, h)``: exact step of the polarity law with d held.
    p : (..., 3)
    directions : tuple of (..., 3)
        Sensed a step before (None in the first step), now and a step later.
    dt : float
        s.
    """
    last, now, ahead = directions
    slope = ahead - now if last is None else 0.5 * (ahead - last)
    bend = ahead - now - slope
    sizes = [np.linalg.norm(d, axis=-1, keepdims=True) for d in (now, ahead)]
    h, angles = dt / SUBSTEPS, []
    for i in range(SUBSTEPS):
        s = (i + 0.5) / SUBSTEPS
        d = now + s * (slope + s * bend)
        length = np.linalg.norm(d, axis=-1, keepdims=True)
        # As long as the ends: a normalised direction stays one.
        d = d * (((1.0 - s) * sizes[0] + s * sizes[1]) / np.where(length > 0, length, 1.0))
        p = turn(p, d, 0.5 * h)
        angles.append(np.arctan2(p[..., 1], p[..., 0]))
        p = turn(p, d, 0.5 * h)
    return np.array(angles), p
