"""Figures without a display: a sheet of axes, and a PNG written whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cellsys.store import atomic_path

DPI = 110


def sheet(
    size: tuple[float, float],
    rows: int = 1,
    columns: int = 1,
    *,
    heights: tuple[float, ...] | None = None,
    sharex: bool = False,
) -> tuple[Figure, Any]:
    """A new figure of `size` inches and its axes; pyplot and its state are not involved."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, height_ratios=heights, sharex=sharex)


def not_drawn(ax: Axes, error: float) -> Axes:
    """Axes that say why they hold no field: it is nowhere beyond its own error, um."""
    text = f"not drawn: no node moved\nby more than the error of {error:.2g} um"
    ax.text(0.5, 0.5, text, ha="center", va="center", transform=ax.transAxes)
    return ax


def save_png(figure: Figure, path: str | Path) -> Path:
    """Write a figure as PNG, atomically; returns the path."""
    target = Path(path)
    figure.set_dpi(DPI)
    engine = figure.get_layout_engine()
    if engine is not None:
        # `savefig` would lay the sheet out, and draw it, twice.
        engine.execute(figure)
        figure.set_layout_engine("none")
    with atomic_path(target) as temporary:
        figure.savefig(temporary, dpi=DPI, format="png")
    return target
