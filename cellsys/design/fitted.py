"""`Fitted`: parameters with their errors, profiles and the test of what is left over."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from cellsys.arguments import checked
from cellsys.errors import ParameterError, UnknownNameError
from cellsys.loop import ClosedLoop, ScheduledLoop
from cellsys.shown import Shown


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class ParameterProfile:
    """The sum of squares along one parameter, all others fitted anew.

    Attributes
    ----------
    values : (V,)
    rise : (V,)
        Of the sum of squares above its least, in units of the noise: z^2 of a normal law.
    low, high : float
        Where it reaches the quantile of the level asked for; inf where it does not.
    """

    values: np.ndarray
    rise: np.ndarray
    low: float
    high: float


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Fitted(Shown):
    """What `cs.fit` found.

    Attributes
    ----------
    names : tuple of str
        Of the parameters, then ``heading_0`` of each cell: the heading at the start, rad.
    estimates, standard_errors : (n,)
    covariance : (n, n)
    level : float
        Of the intervals.
    samples : int
        Measured numbers.
    residuals : (R,)
        In units of the noise, in order of time.
    noise : float
        Standard deviation of a sample, where it was not given: rad or um; else 1.
    rank, condition : int, float
        Directions of the parameters that the data determine to within their own size, and the
        ratio of the best to the least determined.
    whiteness : float
        p-value of the hypothesis that residuals do not remember each other (Ljung and Box,
        Biometrika 65, 1978).
    spread : float
        p-value of the hypothesis that they are as large as the noise given; NaN without one.
    profiles : mapping of str to ParameterProfile
    loop : ClosedLoop or ScheduledLoop or None
        The loop with these values, where it can hold them.
    spent : mapping of str to float
        Iterations of IPOPT, and s to build and to solve.
    """

    names: tuple[str, ...]
    estimates: np.ndarray
    standard_errors: np.ndarray
    covariance: np.ndarray
    level: float
    samples: int
    residuals: np.ndarray
    noise: float
    rank: int
    condition: float
    whiteness: float
    spread: float
    profiles: Mapping[str, ParameterProfile]
    loop: ClosedLoop | ScheduledLoop | None
    spent: Mapping[str, float]

    def _at(self, name: str) -> int:
        if name not in self.names:
            raise UnknownNameError(f"name must be one of {', '.join(self.names)}, got {name!r}")
        return self.names.index(name)

    def __getitem__(self, name: str) -> float:
        """The estimate of a parameter."""
        return float(self.estimates[self._at(name)])

    def interval(self, name: str, level: float | None = None) -> tuple[float, float]:
        """Bounds of a parameter at a level (default that of the fit), from its standard error."""
        share = self.level if level is None else level
        if not 0 < share < 1:
            raise ParameterError(f"level must be between 0 and 1, got {level!r}")
        k, free = self._at(name), max(self.samples - len(self.names), 1)
        law = stats.norm if np.isfinite(self.spread) else stats.t(free)
        half = float(law.ppf(0.5 + 0.5 * share)) * float(self.standard_errors[k])
        return float(self.estimates[k]) - half, float(self.estimates[k]) + half

    @property
    def adequate(self) -> bool:
        """Residuals are white, and as large as the noise, at 1 %; as far as either was tested."""
        return not (self.whiteness < 0.01 or self.spread < 0.01)

    def __str__(self) -> str:
        lines = [
            f"fit to {self.samples} samples: noise {self.noise:.3g}, rank {self.rank} of "
            f"{len(self.names)}, condition {self.condition:.2g}; residuals "
            f"{'pass' if self.adequate else 'FAIL'} (white p = {self.whiteness:.2g}"
            + (f", spread p = {self.spread:.2g})" if np.isfinite(self.spread) else ")")
        ]
        for k, name in enumerate(self.names):
            low, high = self.interval(name)
            lines.append(
                f"  {name:<12} {self.estimates[k]:.6g} +- {self.standard_errors[k]:.2g}   "
                f"{100 * self.level:g} %: {low:.6g} to {high:.6g}"
            )
        return "\n".join(lines)


def whiteness(residuals: np.ndarray, lags: int = 10) -> float:
    """p-value of Ljung and Box's test, channels (T, C) together; NaN entries are left out."""
    total, count = 0.0, 0
    for column in residuals.T:
        r = column[np.isfinite(column)]
        n = len(r)
        if n < 3 * lags or not np.any(r):
            continue
        r = r - r.mean()
        own = float(r @ r)
        total += n * (n + 2) * sum(float(r[k:] @ r[:-k] / own) ** 2 / (n - k)
                                   for k in range(1, lags + 1))  # fmt: skip
        count += lags
    return float(stats.chi2.sf(total, count)) if count else float("nan")
