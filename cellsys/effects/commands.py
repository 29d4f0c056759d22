"""Prescribed histories: heading and amplitude of the lamellipodium, external loads."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import ParameterError


@checked
@dataclass(frozen=True)
class History:
    """Piecewise linear function of time, constant before the first and after the last knot.

    Parameters
    ----------
    times : sequence of float
        Increasing, s.
    values : sequence of float
        One per time.
    """

    times: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", tuple(float(t) for t in self.times))
        object.__setattr__(self, "values", tuple(float(v) for v in self.values))
        if len(self.times) != len(self.values) or not self.times:
            raise ParameterError(
                f"a history needs as many values as times, and at least one; "
                f"got {len(self.times)} times and {len(self.values)} values"
            )
        if not np.all(np.isfinite([*self.times, *self.values])):
            raise ParameterError("a history must be finite")
        if any(b <= a for a, b in zip(self.times, self.times[1:], strict=False)):
            raise ParameterError(f"times of a history must increase, got {list(self.times)}")

    def __call__(self, t: float) -> float:
        """Value at time t."""
        k = bisect_right(self.times, t)
        if k == 0 or k == len(self.times):
            return self.values[max(k - 1, 0)]
        a, b = self.values[k - 1], self.values[k]
        # The share first: a slope overflows where two knots all but coincide.
        share = (t - self.times[k - 1]) / (self.times[k] - self.times[k - 1])
        return min(max((1.0 - share) * a + share * b, min(a, b)), max(a, b))

    def means(self, t: np.ndarray) -> np.ndarray:
        """Mean over every interval of the increasing times t (T,): (T - 1,), exact."""
        inside = [k for k in self.times if t[0] < k < t[-1]]
        knots = np.unique(np.concatenate([t, inside]))
        values = np.array([self(k) for k in knots])
        area = np.append(0.0, np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(knots)))
        return np.diff(area[np.searchsorted(knots, t)]) / np.diff(t)


@checked
@dataclass(frozen=True)
class Commands:
    """What is prescribed to a cell instead of, or on top of, its polarity loop.

    Parameters
    ----------
    heading : History, optional
        Angle of the polarity in the substrate plane, rad; replaces the polarity law.
    amplitude : History, optional
        Factor on the lamellipodium force; 1 when left out.
    """

    heading: History | None = None
    amplitude: History | None = None

    def stop_points(self) -> tuple[float, ...]:
        """Knots of all histories, s."""
        parts: Sequence[History | None] = (self.heading, self.amplitude)
        return tuple(t for h in parts if h is not None for t in h.times)
