"""`pair_attraction`: do cells head for their neighbour beyond chance?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellsys.arguments import checked
from cellsys.design.track_headings import bearings_of, headings_of
from cellsys.errors import DataError, ParameterError
from cellsys.kinds import Count, Seed
from cellsys.shown import Shown
from cellsys.tracks import Tracks
from cellsys.units import real_number


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Attraction(Shown):
    """Whether cells head for their neighbour beyond chance.

    Parameters
    ----------
    mean_cosine : float
        Of the angle between movement and the way to the nearest cell, over time and cells: 1 all
        towards, 0 indifferent, -1 all away.
    interval : (float, float)
        At `level`, by resampling cells.
    null : array (shuffles,)
        The same where every cell is given the neighbour of another one.
    p_value : float
        Share of the null, and itself, at least as large.
    level : float
    cells : int
    """

    mean_cosine: float
    interval: tuple[float, float]
    null: np.ndarray
    p_value: float
    level: float
    cells: int

    def __str__(self) -> str:
        return (
            f"Attraction: mean cosine {self.mean_cosine:.3f} ({100 * self.level:g} %: "
            f"{self.interval[0]:.3f} to {self.interval[1]:.3f}) of {self.cells} cells; shuffled "
            f"{self.null.mean():.3f} +- {self.null.std():.3f}, p = {self.p_value:.3g}"
        )


@checked
def pair_attraction(
    tracks: Tracks | Sequence[Tracks],
    *,
    shuffles: Count = 500,
    level: float = 0.95,
    seed: Seed = 0,
) -> Attraction:
    """Mean heading towards the nearest cell, against shuffled neighbours.

    In the null every cell keeps its movement and is given the directions to a neighbour of
    another cell, from a random moment on: what is left is what a common drift would show.

    Parameters
    ----------
    tracks : Tracks, or a list of them
        One movie each.
    shuffles : int
    level : float
    seed : int

    Raises
    ------
    DataError
        Fewer than four cells that move beside another one.
    """
    if not 0.0 < real_number(level, "level") < 1.0:
        raise ParameterError(f"level must be in (0, 1), got {level!r}")
    pairs: list[tuple[np.ndarray, np.ndarray]] = []
    for movie in [tracks] if isinstance(tracks, Tracks) else tracks:
        bearing = bearings_of(movie)
        for name, theta in headings_of(movie).items():
            phi = bearing[movie.cells[name]]
            good = np.isfinite(theta) & np.isfinite(phi)
            if good.sum() >= 2:
                pairs.append((theta[good], phi[good]))
    if len(pairs) < 4:
        raise DataError(f"{len(pairs)} cells move beside another one; at least four are needed")
    rng = np.random.default_rng(seed)
    own = np.array([np.cos(theta - phi).mean() for theta, phi in pairs])
    null = np.empty(shuffles)
    for k in range(shuffles):
        order = rng.permutation(len(pairs))
        values = []
        for i, j in zip(range(len(pairs)), order, strict=True):
            theta, phi = pairs[i][0], pairs[j][1]
            start = int(rng.integers(len(phi)))
            values.append(np.cos(theta - np.resize(np.roll(phi, start), len(theta))).mean())
        null[k] = np.mean(values)
    picks = rng.integers(len(own), size=(shuffles, len(own)))
    low, high = np.quantile(own[picks].mean(axis=1), [0.5 - 0.5 * level, 0.5 + 0.5 * level])
    mean = float(own.mean())
    return Attraction(
        mean_cosine=mean,
        interval=(float(low), float(high)),
        null=null,
        p_value=float((1 + np.sum(null >= mean)) / (1 + shuffles)),
        level=level,
        cells=len(pairs),
    )
