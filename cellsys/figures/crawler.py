"""Figures of the 1-D crawler: edges against time, predictions beside the full-order run."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from cellsys.figures.axes import axes_of
from cellsys.figures.sheet import not_drawn

if TYPE_CHECKING:
    from cellsys.mechanics.crawler_run import CrawlRun


def crawler_run(run: CrawlRun, ax: Axes | None = None) -> Axes:
    """Lead and trail of every cell of a `CrawlRun`, with a tick at every switch."""
    ax = axes_of(ax)
    ax.set(
        xlabel="time (s)",
        ylabel="position (um)",
        title=fill(f"{run.outcome}: {run.reason}".rstrip(": "), 90),
    )
    if run.trajectory is None:
        return ax
    for k in range(len(run.system.cells)):
        name = f"cell{k + 1}"
        for end, style in (("lead", "-"), ("trail", "--")):
            ax.plot(
                run.trajectory.t,
                run.trajectory.block(f"{name}.{end}"),
                style,
                color=f"C{k}",
                label=f"{name} {end}",
            )
        times = run.switches(name)
        ax.plot(times, np.full(len(times), k), "|", color=f"C{k}", alpha=0.5)
    ax.legend(fontsize="small")
    ax.grid(alpha=0.3)
    return ax


def chain_displacement(run: CrawlRun, ax: Axes | None = None, *, error: float = 0.0) -> Axes:
    """Displacement of every node of a `CrawlRun`'s chain against time, um.

    One that nowhere exceeds its own `error` (um, `Trajectory.error_of`) is not drawn.
    """
    if run.trajectory is None:
        return _row_axes(ax)
    u = run.trajectory.block("chain.displacement")
    return row_displacement(run.trajectory.t, run.system.chain.rest, u, ax, error=error)


def row_displacement(
    t: np.ndarray, rest: np.ndarray, u: np.ndarray, ax: Axes | None = None, *, error: float = 0.0
) -> Axes:
    """Displacement (T, N) of nodes in a row at rest (N,) against time (T,), um; see above."""
    ax = _row_axes(ax)
    every = -(-len(t) // 2000)  # more columns than pixels only take time
    top = float(np.abs(u).max())
    if not top > error:
        return not_drawn(ax, error)
    drawn = ax.pcolormesh(t[::every], rest, u[::every].T, cmap="RdBu_r", vmin=-top, vmax=top)
    ax.figure.colorbar(drawn, ax=ax, label="displacement (um)")
    return ax


def _row_axes(ax: Axes | None) -> Axes:
    ax = axes_of(ax)
    ax.set(xlabel="time (s)", ylabel="node at rest (um)")
    return ax


def crawler_predictions(
    t: np.ndarray, true: np.ndarray, predicted: Mapping[str, np.ndarray], ax: Axes | None = None
) -> Axes:
    """Thesis Fig. 7, 8: edges (T, k) of the full-order run (thick) and of each prediction."""
    ax = axes_of(ax)
    ax.plot(t, true, color="C2", lw=3, alpha=0.5)
    ax.plot([], [], color="C2", lw=3, alpha=0.5, label="full-order")
    colours = ["C3", "C0", "C1", "C4", "C5", "C6", "C7"]
    low, high = float(np.min(true)), float(np.max(true))
    for (label, values), colour in zip(predicted.items(), colours, strict=False):
        # What leaves the picture would only flatten the rest.
        inside = np.where(np.abs(values) < 1e3, values, np.nan)
        ax.plot(t, inside, color=colour, lw=1)
        ax.plot([], [], color=colour, lw=1, label=label)
    margin = 0.3 * (high - low)
    ax.set(xlabel="time (s)", ylabel="position (um)", ylim=(low - margin, high + margin))
    ax.legend(fontsize="small")
    ax.grid(alpha=0.3)
    return ax


def error_against_amplitude(
    amplitude: np.ndarray, errors: Mapping[str, np.ndarray], ax: Axes | None = None
) -> Axes:
    """Relative roll-out error of each model against the amplitude of its runs, both logarithmic."""
    ax = axes_of(ax)
    for label, values in errors.items():
        ax.loglog(amplitude, values, "o-", label=label)
    ax.set(xlabel="amplitude", ylabel="relative roll-out error, held out")
    ax.legend(fontsize="small")
    ax.grid(alpha=0.3, which="both")
    return ax
