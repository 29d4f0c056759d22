"""Error measures of a run against a reference on the same samples."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DimensionError, ParameterError


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
