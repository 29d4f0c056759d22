"""Measures of closed contours in the plane: area, centroid, perimeter, axis of elongation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DataError
from cellsys.units import shaped_array

ROUND = 1e-9  # of the sum of the second moments: a difference below it is no elongation


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class ShapeOfContour:
    """Measures of a contour, lengths in its unit.

    `axis_deg` is the principal axis of elongation in [0, 180), NaN for a round contour, and
    `aspect_ratio` the ratio of the axes of the ellipse with the same second moments.
    """

    area: float
    perimeter: float
    centroid: np.ndarray  # (2,)
    axis_deg: float
    aspect_ratio: float


@checked
def contour_shape(points: np.ndarray) -> ShapeOfContour:
    """Area, perimeter, centroid and axis of the polygon with these corners.

    By Green's theorem, about the mean of the corners, with c_i = x_i y_i+1 - x_i+1 y_i:

        A = 1/2 sum c_i,   centroid = 1/(6 A) sum (x_i + x_i+1) c_i,
        S = integral of r r^T about the centroid

    The eigenvector of the greater eigenvalue of S is the axis, and the square root of their ratio
    the aspect ratio.

    Parameters
    ----------
    points : (n, 2)
        Corners in order, either way round.

    Raises
    ------
    DimensionError, DataError
        Other shapes, NaN, or no area.
    """
    corners = shaped_array(points, "points", (None, 2))
    if len(corners) < 3:
        raise DataError(f"a contour needs at least three corners, got {len(corners)}")
    middle = corners.mean(axis=0)
    p = corners - middle
    q = np.roll(p, -1, axis=0)
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    area = 0.5 * float(cross.sum())
    size = float(np.abs(p).max())
    if not abs(area) > 1e-12 * size**2:
        raise DataError("the corners of a contour lie on a line: it has no area")
    centre = (cross @ (p + q)) / (6.0 * area)
    p, q = p - centre, q - centre
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    sums = p + q
    # of p p^T + q q^T + (p + q)(p + q)^T over each triangle with the centre, times its area / 12
    moments = (
        np.einsum("i,ij,ik->jk", cross, p, p)
        + np.einsum("i,ij,ik->jk", cross, q, q)
        + np.einsum("i,ij,ik->jk", cross, sums, sums)
    ) / 24.0
    moments = moments * np.sign(area)
    perimeter = float(np.hypot(*(q - p).T).sum())
    total = float(np.trace(moments))
    difference = np.array([moments[0, 0] - moments[1, 1], 2.0 * moments[0, 1]])
    spread = float(np.hypot(*difference))
    axis = float("nan")
    if spread > ROUND * total:
        axis = float(np.degrees(0.5 * np.arctan2(difference[1], difference[0]))) % 180.0
    least = total - spread
    ratio = float(np.sqrt((total + spread) / least)) if least > 0 else float("inf")
    return ShapeOfContour(
        area=abs(area),
        perimeter=perimeter,
        centroid=middle + centre,
        axis_deg=axis,
        aspect_ratio=ratio,
    )


@checked
def axis_difference_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle between two axes, deg, in [0, 90]: an axis has no sense."""
    off = np.abs(np.asarray(a) - np.asarray(b)) % 180.0
    return np.asarray(np.minimum(off, 180.0 - off))


@checked
def directionality_deg(axis_deg: np.ndarray, movement_deg: np.ndarray) -> np.ndarray:
    """Mean direction of the axis of elongation and of the movement, deg in (-180, 180] [B.2].

    The axis is taken in the sense that is nearer to the movement; NaN without either of them.
    """
    axis, movement = np.asarray(axis_deg, dtype=float), np.asarray(movement_deg, dtype=float)
    off = (axis - movement + 90.0) % 180.0 - 90.0
    mean = movement + 0.5 * off
    return np.asarray(180.0 - (180.0 - mean) % 360.0)
