"""Error measures of a run against a reference on the same samples."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DimensionError, ParameterError
from cellsys.observe import node_speed
from cellsys.system import Layout
from cellsys.trajectory import Trajectory

THRESHOLD = 1.6e-3  # um/s: node speed above which the thesis calls a membrane node moving


def mse(x: np.ndarray, reference: np.ndarray) -> float:
    """(1/T) sum_k |x_k - r_k|^2                                       [thesis eq. 86]"""
    return float(np.mean(np.sum((x - reference) ** 2, axis=1)))


def relative(x: np.ndarray, reference: np.ndarray) -> float:
    """Root of the summed squares of the error over that of the reference."""
    size = float(np.linalg.norm(reference))
    return float(np.linalg.norm(x - reference)) / size if size else float(np.linalg.norm(x))


def end(x: np.ndarray, reference: np.ndarray) -> float:
    """Relative error of the last sample, Euclidean."""
    return relative(x[-1:], reference[-1:])


def maximum(x: np.ndarray, reference: np.ndarray) -> float:
    """Largest error of any state at any sample over the largest |state| of the reference."""
    size = float(np.abs(reference).max(initial=0.0))
    worst = float(np.abs(x - reference).max(initial=0.0))
    return worst / size if size else worst


def motion(x: np.ndarray, reference: np.ndarray) -> float:
    """`relative` of what has changed since the first sample: the share of the motion missed."""
    return relative(x - x[:1], reference - reference[:1])


MEASURES: dict[str, Callable[[np.ndarray, np.ndarray], float]] = {
    "mse": mse,
    "relative": relative,
    "end": end,
    "maximum": maximum,
    "motion": motion,
}


@checked
def measure(name: str, x: np.ndarray, reference: np.ndarray) -> float:
    """One of `MEASURES` of states x against a reference, both (T, n).

    Raises
    ------
    ParameterError, DimensionError
        For an unknown name, or shapes that differ.
    """
    if name not in MEASURES:
        raise ParameterError(f"measure must be one of {sorted(MEASURES)}, got {name!r}")
    x, reference = np.asarray(x), np.asarray(reference)
    if x.shape != reference.shape or x.ndim != 2:
        raise DimensionError(
            f"states and reference must both be (T, n), got {x.shape}, {reference.shape}"
        )
    return MEASURES[name](x, reference)


def by_block(x: np.ndarray, reference: np.ndarray, states: Layout) -> dict[str, float]:
    """`relative` for each state block by itself."""
    return {
        b.name: relative(x[:, states.slice(b.name)], reference[:, states.slice(b.name)])
        for b in states
    }


def polarity_angle(p: np.ndarray, reference: np.ndarray) -> float:
    """Largest angle, degrees, between polarities (T, cells, 3) and the reference's."""
    across = np.linalg.norm(np.cross(p, reference), axis=-1)
    along = np.sum(p * reference, axis=-1)
    return float(np.degrees(np.arctan2(across, along)).max(initial=0.0))


def moving_share(
    run: Trajectory, reference: Trajectory, block: str, threshold: float = THRESHOLD
) -> float:
    """Share of (node, interval) pairs of a position block on the wrong side of a speed, um/s."""
    return float(
        np.mean((node_speed(run, block) > threshold) != (node_speed(reference, block) > threshold))
    )
