"""`Target`: where cells are to be brought, and `Obstacle`: what they are to go around."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DimensionError, ParameterError
from cellsys.shown import Shown
from cellsys.units import real_array, real_number


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Target(Shown):
    """What holds at the end: places, headings or the gap of two cells.

    Parameters
    ----------
    place : (2,) or (K, 2), optional
        Centroids, um; NaN where a coordinate is free.
    heading : float or (K,), optional
        rad.
    gap : float, optional
        Distance of the centroids of two cells along the line between their places at the start,
        um.
    within, turned_within : float
        What counts as reached: um, and rad.
    """

    place: np.ndarray | None = None
    heading: float | np.ndarray | None = None
    gap: float | None = None
    within: float = 1.0
    turned_within: float = float(np.radians(5.0))

    def __post_init__(self) -> None:
        if self.place is None and self.heading is None and self.gap is None:
            raise ParameterError("a target needs place, heading or gap")
        if self.place is not None:
            place = np.atleast_2d(real_array(self.place, "place").astype(float))
            if place.ndim != 2 or place.shape[1] != 2 or np.any(np.isinf(place)):
                raise DimensionError(f"place must be (2,) or (K, 2), um, got {place.shape}")
            object.__setattr__(self, "place", place)
        if self.heading is not None:
            heading = np.atleast_1d(real_array(self.heading, "heading").astype(float))
            if heading.ndim != 1 or not np.all(np.isfinite(heading)):
                raise DimensionError("heading must be one finite number per cell, rad")
            object.__setattr__(self, "heading", heading)
        for name in ("gap", "within", "turned_within"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(real_number(value, name)) and value > 0):
                raise ParameterError(f"{name} must be finite and > 0, got {value!r}")

    def __str__(self) -> str:
        parts = []
        if self.place is not None:
            each = (f"({x:.1f}, {y:.1f})" for x, y in self.place)
            parts.append(f"place {', '.join(each)} um")
        if self.heading is not None:
            parts.append(f"heading {np.degrees(np.atleast_1d(self.heading)).round(0)} deg")
        if self.gap is not None:
            parts.append(f"gap {self.gap:g} um")
        return "; ".join(parts)


@checked
@dataclass(frozen=True, kw_only=True)
class Obstacle:
    """A round place that no centroid is to come closer to, such as a stiff spot.

    Parameters
    ----------
    center : (float, float)
        um.
    radius : float
        um.
    """

    center: tuple[float, float]
    radius: float

    def __post_init__(self) -> None:
        if not np.all(np.isfinite([*self.center, self.radius])) or not self.radius > 0:
            raise ParameterError(
                f"an obstacle needs a finite center and radius > 0, got {self.center!r} and "
                f"{self.radius!r}"
            )
