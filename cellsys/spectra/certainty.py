"""What the data leave open of a pole, and the one rule for calling it growing or stable.

A pole is said to grow (to decay) where its real part lies beyond (inside) the boundary by more
than the larger of two bounds: rounding [`Spectrum`], and how far it moves when a part of the data
behind the model is left out [jackknife; Efron and Tibshirani 1993, section 11].
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.optimize import linear_sum_assignment

from cellsys.arguments import checked
from cellsys.drawable import Drawable
from cellsys.errors import DimensionError, ParameterError
from cellsys.spectra.spectrum import Spectrum

_SAME = 1e-6  # poles further apart than this share of the largest are not the same pole


@checked
@dataclass(frozen=True, eq=False)
class PoleCertainty(Drawable):
    """Poles of a model, and how far each moves when a part of the data is left out.

    Attributes
    ----------
    poles : complex array (m,)
        1/s, or numbers of the z plane where `dt` > 0.
    spread : array (m,)
        Largest distance to the matched pole over all refits.
    left_out : str
        What a refit goes without: ``"run"``, ``"group of runs"`` or ``"stretch"`` (an eighth of
        a single run).
    dt : float
        0: the s plane; else the step, s.
    """

    poles: np.ndarray
    spread: np.ndarray
    left_out: str = "run"
    dt: float = 0.0

    _figure: ClassVar[str] = "pole_certainty"

    def __post_init__(self) -> None:
        if np.shape(self.poles) != np.shape(self.spread) or np.ndim(self.poles) != 1:
            raise DimensionError(
                f"poles and spread must both be (m,), got {np.shape(self.poles)} and "
                f"{np.shape(self.spread)}"
            )

    def of(self, values: np.ndarray, dt: float, bound: np.ndarray | float = 0.0) -> np.ndarray:
        """Spread (n,) of the poles `values` (n,), which are some of this model's, in any order.

        `bound` (n,) is what is known of their errors.

        Raises
        ------
        ParameterError
            Where they are not.
        """
        values = np.asarray(values)
        if (dt > 0) != (self.dt > 0):
            raise ParameterError(
                "the certainty is of poles in the "
                + ("z plane (a step model's)" if self.dt > 0 else "s plane (1/s)")
                + " and the system's are not; ask the model for the other kind"
            )
        if len(values) > len(self.poles):
            raise ParameterError(
                f"the certainty is of {len(self.poles)} poles and the system has {len(values)}; "
                "give that of this system's own model"
            )
        if not len(values):
            return np.zeros(0)
        mine, theirs, distance = matched(values, self.poles)
        size = float(np.abs(self.poles[np.isfinite(self.poles)]).max(initial=0.0))
        bound = np.broadcast_to(bound, values.shape)[mine]
        off = np.max(distance - self.spread[theirs] - bound)
        if off > max(_SAME * size, 1e-9):
            raise ParameterError(
                f"the certainty belongs to other poles: one lies {off:.2g} from the nearest; "
                "give that of this system's own model"
            )
        out = np.empty(len(values))
        out[mine] = self.spread[theirs]
        return out

    def __str__(self) -> str:
        order = np.lexsort((self.poles.imag, -self.poles.real))
        lines = [f"{len(self.poles)} poles; +- : moved when a {self.left_out} is left out"]
        lines += [f"  {complex(self.poles[k]):.6g}  +- {self.spread[k]:.1e}" for k in order[:20]]
        if len(order) > 20:
            lines.append(f"  ... and {len(order) - 20} more")
        return "\n".join(lines)


def matched(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of a and b with the least total distance: rows of a, of b, and their distances."""
    a, b = np.asarray(a)[:, None], np.asarray(b)[None, :]
    with np.errstate(invalid="ignore"):
        distance = np.abs(a - b)
    distance = np.where(a == b, 0.0, np.where(np.isfinite(distance), distance, 1e300))
    rows, cols = linear_sum_assignment(np.minimum(distance, 1e150))
    return rows, cols, distance[rows, cols]


def spread_of(poles: np.ndarray, refits: list[np.ndarray]) -> np.ndarray:
    """Largest distance (m,) from each pole to the matched one of each refit."""
    spread = np.zeros(len(poles))
    if not len(poles):
        return spread
    for other in refits:
        rows, _, distance = matched(poles, other)
        spread[rows] = np.maximum(spread[rows], distance)
    # A pair that turns into two real poles is matched either way round: both get the larger.
    with np.errstate(invalid="ignore"):
        gap = np.abs(poles[:, None] - poles.conj()[None, :])
    partner = np.argmin(np.where(np.isfinite(gap), gap, np.inf), axis=1)
    return np.maximum(spread, spread[partner])


def data_note(certainty: PoleCertainty) -> str:
    """What a bound means, in words."""
    return f"+-: the larger of rounding and leaving a {certainty.left_out} out"


def widened(found: Spectrum, certainty: PoleCertainty | None, dt: float) -> Spectrum:
    """The larger of each pole's bounds: rounding, and data."""
    if certainty is None:
        return found
    data = certainty.of(found.values, dt, found.bound)
    return replace(found, bound=np.maximum(found.bound, data))


def fastest(rates: np.ndarray, bounds: np.ndarray) -> tuple[float, float]:
    """(rate, bound) of the entry that is most certainly above 0: the largest ``rate - bound``."""
    if not len(rates):
        return -np.inf, 0.0
    i = int(np.argmax(np.asarray(rates) - np.asarray(bounds)))
    return float(rates[i]), float(bounds[i])


def side(excess: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """+1 beyond the boundary by more than the bound, -1 inside by more, 0 not decided."""
    return (np.asarray(excess) > bound).astype(int) - (np.asarray(excess) < -bound).astype(int)
