"""`Recording`: headings and places of cells at evenly spaced times, what a loop is fitted to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.shown import Shown
from cellsys.trajectory import Trajectory
from cellsys.units import real_array, real_number


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Recording(Shown):
    """Headings, places or both of K cells; NaN where nothing was seen.

    Parameters
    ----------
    t : (T,)
        s since contact, evenly spaced.
    headings : (T,) or (T, K), optional
        rad; whole turns do not matter.
    positions : (T, 2) or (T, K, 2), optional
        um.
    heading_noise, position_noise : float, optional
        Standard deviation of a sample, rad and um. Left out it is estimated from what the fit
        leaves over; to weigh headings against places both must be given.

    Raises
    ------
    DimensionError, DataError, ParameterError
        Neither headings nor positions, sizes that do not fit, times that are not evenly spaced.
    """

    t: np.ndarray
    headings: np.ndarray | None = None
    positions: np.ndarray | None = None
    heading_noise: float | None = None
    position_noise: float | None = None

    def __post_init__(self) -> None:
        t = real_array(self.t, "t").copy()
        if t.ndim != 1 or len(t) < 3 or not np.all(np.isfinite(t)):
            raise DimensionError(f"t must be at least 3 finite times (T,), got shape {t.shape}")
        h = (t[-1] - t[0]) / (len(t) - 1)
        if not h > 0 or np.abs(np.diff(t) - h).max() > 1e-6 * h:
            raise DataError("t must be evenly spaced and increase; resample the recording first")
        object.__setattr__(self, "t", t)
        if self.headings is None and self.positions is None:
            raise DataError("a recording needs headings or positions")
        if self.headings is not None:
            found = real_array(self.headings, "headings").copy()
            found = found[:, None] if found.ndim == 1 else found
            self._keep("headings", found, (len(t), found.shape[-1]))
        if self.positions is not None:
            found = real_array(self.positions, "positions").copy()
            found = found[:, None] if found.ndim == 2 else found
            self._keep("positions", found, (len(t), *found.shape[1:-1], 2))
        if self.headings is not None and self.positions is not None:
            if self.headings.shape[1] != self.positions.shape[1]:
                raise DimensionError(
                    f"headings are of {self.headings.shape[1]} cells and positions of "
                    f"{self.positions.shape[1]}"
                )
            if self.heading_noise is None or self.position_noise is None:
                raise ParameterError(
                    "heading_noise and position_noise must both be given to weigh headings (rad) "
                    "against positions (um)"
                )
        for name in ("heading_noise", "position_noise"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(real_number(value, name)) and value > 0):
                raise ParameterError(f"{name} must be finite and > 0, got {value!r}")

    def _keep(self, name: str, found: np.ndarray, shape: tuple[int, ...]) -> None:
        if found.shape != shape or not found.shape[1]:
            raise DimensionError(f"{name} must have a row per time, got shape {found.shape}")
        if np.any(np.isinf(found)):
            raise DataError(f"{name} holds inf; NaN marks what was not seen")
        if np.isfinite(found).sum() < 3:
            raise DataError(f"{name} has less than 3 samples that are not NaN")
        object.__setattr__(self, name, found)

    @classmethod
    def of(cls, run: Trajectory, *, heading_noise: float | None = None) -> Recording:
        """The headings of a run."""
        if run.p is None:
            raise DataError("the run recorded no polarity: give Recording(t=..., headings=...)")
        p = np.asarray(run.p)
        return cls(
            t=np.asarray(run.t),
            headings=np.arctan2(p[..., 1], p[..., 0]),
            heading_noise=heading_noise,
        )

    @property
    def n_cells(self) -> int:
        """K."""
        given = self.positions if self.headings is None else self.headings
        return 0 if given is None else given.shape[1]

    @property
    def step(self) -> float:
        """Time between samples, s."""
        return float((self.t[-1] - self.t[0]) / (len(self.t) - 1))

    @property
    def known_noise(self) -> bool:
        """Whether every kind of sample has its noise."""
        kinds = ((self.headings, self.heading_noise), (self.positions, self.position_noise))
        return all(noise is not None for given, noise in kinds if given is not None)

    def __str__(self) -> str:
        what = [
            name
            for name, given in (("headings", self.headings), ("positions", self.positions))
            if given is not None
        ]
        return (
            f"recording: {' and '.join(what)} of {self.n_cells} cells, {len(self.t)} samples every "
            f"{self.step:g} s"
        )
