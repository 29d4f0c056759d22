"""Measured data as they are: jittered stamps, uneven sampling, missing samples, delays."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.samples.snapshots import RunData
from cellsys.system import Block, Layout
from cellsys.units import real_number

MISSING = ("refuse", "split", "fill")
JITTER = 1e-3  # of the interval: how far a stamp may lie off the even grid that fits all of them


def off_grid(t: np.ndarray) -> tuple[float, float, int]:
    """Interval of the even grid through the first and last time, how far the worst stamp lies off
    it, and which stamp that is."""
    step = float(t[-1] - t[0]) / (len(t) - 1)
    off = np.abs(t - (t[0] + step * np.arange(len(t))))
    return step, float(off.max()), int(off.argmax())


def even(t: np.ndarray) -> float | None:
    """Interval of times on an even grid, to `JITTER` of it (float32 stamps, rounded ones)."""
    if len(t) < 3 or not np.all(np.diff(t) > 0):
        return None
    step, off, _ = off_grid(t)
    return step if off <= JITTER * step else None


def resampled(t: np.ndarray, x: np.ndarray, dt: float, name: str) -> tuple[np.ndarray, float]:
    """Samples at even times, linear between the given ones, and the error that this adds.

    The error is the largest |x''| h^2/8 over the intervals h that are bridged, from differences
    of second order, over the rms of the column about its mean: 0 for what runs straight.

    Raises
    ------
    DataError
        Times that do not rise, or an interval of which fewer than three fit.
    """
    if not np.all(np.diff(t) > 0):
        k = int(np.argmin(np.diff(t)))
        raise DataError(
            f"{name}: times must rise, but from sample {k} to {k + 1} they go from {t[k]:.9g} s "
            f"to {t[k + 1]:.9g} s; sort them, and leave one of equal ones"
        )
    count = int(np.floor((t[-1] - t[0]) / dt * (1 + 1e-12))) + 1
    if count < 3:
        raise DataError(
            f"{name}: resample = {dt:.6g} s leaves {count} samples of {t[-1] - t[0]:.6g} s; three "
            "are the least"
        )
    grid = t[0] + dt * np.arange(count)
    made = np.column_stack([np.interp(grid, t, column) for column in x.T])
    h = np.diff(t)
    slope = np.diff(x, axis=0) / h[:, None]
    bend = np.abs(np.diff(slope, axis=0)) / (0.5 * (h[1:] + h[:-1]))[:, None]
    worst = bend * (np.maximum(h[1:], h[:-1])[:, None] ** 2) / 8.0
    size = np.maximum(x.std(axis=0), 1e-300)
    return made, float((worst.max(axis=0, initial=0.0) / size).max(initial=0.0))


def without_missing(run: RunData, missing: str) -> tuple[list[RunData], int]:
    """A run of states without NaN: split where samples are missing, or filled between them.

    Returns
    -------
    runs, samples
        And how many samples were missing.
    """
    x = np.asarray(run.x, dtype=float)
    lost = ~np.isfinite(x).all(axis=1)
    if not lost.any() or missing == "refuse":
        return [run], 0
    if run.eta is not None or run.u is not None or run.commands is not None:
        raise ParameterError(
            f"missing = {missing!r} is for runs of states alone; {run.label} has loads or commands"
        )
    if missing == "split":
        kept = np.flatnonzero(~lost)
        pieces = np.split(kept, np.flatnonzero(np.diff(kept) > 1) + 1)
        runs = [
            dataclasses.replace(run, x=x[piece], label=f"{run.label} from sample {piece[0]}")
            for piece in pieces
            if len(piece) >= 3
        ]
        return runs, int(lost.sum())
    good = np.isfinite(x)
    if not good.any(axis=0).all():
        column = int(np.flatnonzero(~good.any(axis=0))[0])
        raise DataError(f"{run.label}: column {column} has no finite value to fill from")
    k = np.arange(len(x))
    filled = np.column_stack(
        [np.interp(k, k[g], column[g]) for g, column in zip(good.T, x.T, strict=True)]
    )
    return [dataclasses.replace(run, x=filled)], int(lost.sum())


def delayed(runs: Sequence[RunData], states: Layout, delays: int) -> tuple[list[RunData], Layout]:
    """Runs whose samples hold their last `delays` samples too: rows of a Hankel matrix.

    x_k becomes [x_k, x_k-1, ..., x_k-delays], so that a linear model of few measured quantities can
    hold what they do not show (Arbabi & Mezic, SIAM J. Appl. Dyn. Syst. 16, 2096, 2017). The
    blocks of the past are called ``NAME.delay1``, ...; the first `delays` samples go.
    """
    out = []
    for run in runs:
        if run.eta is not None or run.u is not None:
            raise ParameterError("delays are for runs of states alone; leave eta and u out")
        x = np.asarray(run.x, dtype=float)
        rows = len(x) - delays
        if rows < 3:
            raise DataError(
                f"{run.label or 'a run'} has {len(x)} samples; with {delays} delays it needs "
                f"{delays + 3}"
            )
        wide = np.hstack([x[delays - j : delays - j + rows] for j in range(delays + 1)])
        commands = None if run.commands is None else np.asarray(run.commands)[delays:]
        out.append(dataclasses.replace(run, x=wide, commands=commands))
    blocks = list(states)
    for j in range(1, delays + 1):
        blocks += [
            Block(f"{b.name}.delay{j}", b.shape, b.unit, role=b.role, kind=b.kind) for b in states
        ]
    return out, Layout(blocks)


def looks_transposed(x: np.ndarray) -> bool:
    """Whether rows follow each other far more roughly than columns do, and there are few rows.

    Samples in time change little from one to the next; an array (states, samples) changes little
    along its rows instead.
    """
    if x.ndim != 2 or not (3 <= x.shape[0] < x.shape[1]) or not np.isfinite(x).all():
        return False
    spread = float(x.var())
    if not spread > 0:
        return False
    down = float(np.mean(np.diff(x, axis=0) ** 2)) / spread
    along = float(np.mean(np.diff(x, axis=1) ** 2)) / spread
    return down > 0.5 and along < 0.01


def check_choices(resample: float | None, missing: str, delays: int) -> None:
    """Refuse choices out of their bounds.

    Raises
    ------
    ParameterError
    """
    if resample is not None and not real_number(resample, "resample") > 0:
        raise ParameterError(f"resample must be > 0 s, got {resample!r}")
    if missing not in MISSING:
        raise ParameterError(f"missing must be one of {', '.join(MISSING)}, got {missing!r}")
    if delays < 0:
        raise DimensionError(f"delays must be 0 or more, got {delays}")
