"""How cells move: direction, speed, persistence, mean squared displacement with error bars."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DataError
from cellsys.shown import Shown
from cellsys.units import shaped_array


class Movement(NamedTuple):
    """Of every step of a path: direction, deg in (-180, 180], NaN where it rests; and speed."""

    direction_deg: np.ndarray
    speed: np.ndarray


@checked
def movement(t: np.ndarray, place: np.ndarray) -> Movement:
    """Direction and speed from each sample to the next; NaN at the last.

    Parameters
    ----------
    t : (T,)
    place : (T, 2) or (T, 3)
        Directions are those in the plane, speeds those in space.
    """
    times = shaped_array(t, "t", (None,))
    x = shaped_array(place, "place", (len(times), None))
    step = np.diff(x, axis=0)
    direction, speed = np.full(len(x), np.nan), np.full(len(x), np.nan)
    if len(step):
        size = np.linalg.norm(step, axis=1)
        speed[:-1] = size / np.diff(times)
        plane = np.hypot(step[:, 0], step[:, 1])
        # A step within the rounding of the places has no direction.
        seen = plane > 8.0 * np.finfo(float).eps * np.abs(x).max()
        direction[:-1][seen] = np.degrees(np.arctan2(step[seen, 1], step[seen, 0]))
    return Movement(direction, speed)


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class MeanSquares(Shown):
    """Mean squared displacement of cells against lag.

    Parameters
    ----------
    lag : (L,)
        In the unit of time.
    msd : (L,)
        Mean over the steps of a cell, then over the cells, in the square of the unit of length.
    error : (L,)
        Its standard error: between cells, which are independent; of a single cell by Qian, Sheetz
        & Elson (1991), for a diffusing one.
    cells : int array (L,)
        How many cells live that long.
    """

    lag: np.ndarray
    msd: np.ndarray
    error: np.ndarray
    cells: np.ndarray

    def __str__(self) -> str:
        if not self.lag.size:
            return "mean squared displacement: no cell has two samples"
        return (
            f"mean squared displacement at lag {self.lag[0]:.4g}: {self.msd[0]:.4g} +- "
            f"{self.error[0]:.2g} ({self.cells[0]} cells)"
        )


@checked
def mean_squares(paths: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> MeanSquares:
    """`MeanSquares` of paths {cell: (t (T,), place (T, dim))}.

    Lags are multiples of the shortest step; displacements over gaps count at their own lag. Every
    pair of samples of a cell counts, up to half its length, beyond which few pairs are left.

    Raises
    ------
    DataError
        Times that do not lie on one grid of steps, to 10 % of the step.
    """
    steps = [np.diff(t) for t, _ in paths.values() if len(t) > 1]
    if not steps:
        return MeanSquares(lag=np.zeros(0), msd=np.zeros(0), error=np.zeros(0),
                           cells=np.zeros(0, int))  # fmt: skip
    step = float(np.percentile(np.concatenate(steps), 10.0, method="lower"))
    sums: dict[int, list[tuple[float, int, int]]] = {}
    for name, (t, place) in paths.items():
        n = len(t)
        if n < 2:
            continue
        at = (np.asarray(t) - t[0]) / step
        frame = np.round(at).astype(int)
        if np.abs(at - frame).max() > 0.1:
            k = int(np.abs(at - frame).argmax())
            raise DataError(
                f"cell {name}: time {t[k]:.6g} is no multiple of the step {step:.6g} after the "
                "first; sample the path again at equal steps"
            )
        whole = np.full((frame[-1] + 1, np.shape(place)[1]), np.nan)
        whole[frame] = place
        for lag in range(1, max(1, frame[-1] // 2) + 1):
            squares = np.sum((whole[lag:] - whole[:-lag]) ** 2, axis=1)
            squares = squares[np.isfinite(squares)]
            if squares.size:
                sums.setdefault(lag, []).append((float(squares.mean()), len(squares), n))
    lags = np.array(sorted(sums))
    msd = np.array([np.mean([m for m, _, _ in sums[lag]]) for lag in lags])
    error = np.array([_error(sums[lag], int(lag)) for lag in lags])
    return MeanSquares(
        lag=step * lags, msd=msd, error=error, cells=np.array([len(sums[lag]) for lag in lags])
    )


def _error(found: list[tuple[float, int, int]], lag: int) -> float:
    values = np.array([m for m, _, _ in found])
    if len(values) > 1:
        return float(values.std(ddof=1) / np.sqrt(len(values)))
    mean, K, _ = found[0]
    n = lag
    if n <= K:
        share = (4.0 * n**2 * K + 2.0 * K + n - n**3) / (6.0 * n * K**2)
    else:
        share = 1.0 + (K**3 - 4.0 * n * K**2 + 4.0 * n - K) / (6.0 * n**2 * K)
    return float(mean * np.sqrt(share))


class Persistence(NamedTuple):
    """`ratio`: net displacement over length of the path; `time`: -dt / ln of the mean cosine of
    the turn from step to step (NaN where the mean cosine is not between 0 and 1)."""

    ratio: float
    time: float


@checked
def persistence(t: np.ndarray, place: np.ndarray) -> Persistence:
    """`Persistence` of one path (T, dim); NaN for fewer than two (three) samples."""
    step = np.diff(shaped_array(place, "place", (None, None)), axis=0)
    size = np.linalg.norm(step, axis=1)
    length = float(size.sum())
    ratio = float(np.linalg.norm(step.sum(axis=0)) / length) if length > 0 else float("nan")
    both = size[1:] * size[:-1]
    turns = both > 0
    time = float("nan")
    if turns.any():
        cosine = float(np.mean(np.sum(step[1:] * step[:-1], axis=1)[turns] / both[turns]))
        if 0.0 < cosine < 1.0:
            time = -float(np.median(np.diff(t))) / float(np.log(cosine))
    return Persistence(ratio, time)
