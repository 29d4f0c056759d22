"""The clock of a spreading cell: hat functions of s = 1 - exp(-t/tau)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import ParameterError


@checked
@dataclass(frozen=True)
class Clock:
    """Vertices of the schedule, evenly spread over s in [0, 1]; one vertex is no schedule.

    The clock is stable by itself and does not look at the cell: a schedule read from the state
    has false equilibria (a cell that stays round) [notes: measurements, clock].

    Parameters
    ----------
    tau : float
        s.
    vertices : int
    """

    tau: float = 250.0
    vertices: int = 6

    def __post_init__(self) -> None:
        if not (np.isfinite(self.tau) and self.tau > 0):
            raise ParameterError(f"tau must be > 0 s, got {self.tau!r}")
        if self.vertices < 1:
            raise ParameterError(f"vertices must be >= 1, got {self.vertices!r}")

    def weights(self, t: np.ndarray | float) -> np.ndarray:
        """w_h(t) (..., vertices): not negative, sum 1; t in s since contact."""
        t = np.asarray(t, dtype=float)
        if self.vertices == 1:
            return np.ones((*t.shape, 1))
        s = -np.expm1(-np.maximum(t, 0.0) / self.tau) * (self.vertices - 1)
        return np.clip(1.0 - np.abs(s[..., None] - np.arange(self.vertices)), 0.0, None)
