"""Headings of cells in the plane: turned through along a run, and off one another."""

from __future__ import annotations

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DimensionError
from cellsys.units import real_array


@checked
def heading_deg(p: np.ndarray) -> np.ndarray:
    """Heading of polarities p (T, ..., 3), deg, unwrapped along time.

    A cell that turns on from 179 to 182 degrees does not jump to -178. Samples must be close
    enough that no cell turns by more than 180 degrees between two of them.
    """
    p = _vectors(p, "p")
    return np.degrees(np.unwrap(np.arctan2(p[..., 1], p[..., 0]), axis=0))


@checked
def heading_change_deg(p: np.ndarray) -> np.ndarray:
    """How far each cell turned from the first to the last sample of p (T, ..., 3), deg, signed.

    Turns count in full: one and a half turns to the left are 540 degrees.
    """
    angle = np.atleast_1d(heading_deg(p))
    return angle[-1] - angle[0]


@checked
def heading_error_deg(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Angle of p from q (..., 3), deg, in (-180, 180]: whole turns are no difference."""
    p, q = _vectors(p, "p"), _vectors(q, "q")
    along = p[..., 0] * q[..., 0] + p[..., 1] * q[..., 1]
    across = p[..., 1] * q[..., 0] - p[..., 0] * q[..., 1]
    return np.degrees(np.arctan2(across, along))


def _vectors(value: np.ndarray, name: str) -> np.ndarray:
    vectors = real_array(value, name)
    if not vectors.ndim or vectors.shape[-1] != 3:
        raise DimensionError(f"{name} must have shape (..., 3), got {vectors.shape}")
    return vectors
