"""Figures of coupled cells: pole maps with multiplicities, poles against the number of cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from cellsys.figures.axes import axes_of

if TYPE_CHECKING:
    from cellsys.population.poleset import PoleSet
    from cellsys.population.ported.linear_cells import PortedCells
    from cellsys.population.printed.cells import CoupledCells
    from cellsys.population.printed.closed import CoupledLoop
    from cellsys.population.verdict import CoupledStability


def coupled_poles(poles: PoleSet, ax: Axes | None = None) -> Axes:
    """Pole map of a `PoleSet`: area by multiplicity, hollow where the data do not decide."""
    ax = axes_of(ax)

    def scatter(found: PoleSet, **style: Any) -> None:
        size = 25 + 40 * np.log10(found.multiplicity)
        ax.scatter(found.values.real, found.values.imag, s=size, **style)

    scatter(poles, color="C0", alpha=0.6, lw=0, label=f"{poles.count} poles")
    if poles.alternative is not None:
        scatter(
            poles.alternative,
            facecolors="none",
            edgecolors="C3",
            label="other set the data allow",
        )
    ax.axvline(0.0, color="0.5", lw=1)
    ax.set(xlabel="Re (1/s)", ylabel="Im (rad/s)")
    ax.legend(fontsize="small")
    ax.grid(alpha=0.3)
    return ax


def coupled_stability(report: CoupledStability, ax: Axes | None = None) -> Axes:
    """Pole map with the verdict as its title."""
    ax = coupled_poles(report.poles, ax)
    ax.set_title(report.verdict, fontsize="medium")
    return ax


def coupled_cells(cells: CoupledCells | PortedCells, ax: Axes | None = None) -> Axes:
    """Pole map of `CoupledCells`."""
    ax = coupled_poles(cells.pole_set(), ax)
    ax.set_title(f"{cells.n_cells} cells, {cells.coupling.name}", fontsize="medium")
    return ax


def coupled_loop(loop: CoupledLoop, ax: Axes | None = None) -> Axes:
    """Closed-loop poles of K cells, with those of the plant as crosses."""
    ax = coupled_poles(loop.poles, ax)
    plant = loop.plant_poles.values
    ax.plot(plant.real, plant.imag, "k+", label="plant")
    ax.set_title(f"{loop.n_cells} closed loops", fontsize="medium")
    ax.legend(fontsize="small")
    return ax


def poles_against_cells(
    numbers: Sequence[int],
    sets: Sequence[PoleSet],
    ax: Axes | None = None,
    *,
    limit: np.ndarray | None = None,
) -> Axes:
    """Pole sets of growing numbers of cells in one map, light to dark; crosses: the limit."""
    ax = axes_of(ax)
    shades = plt.get_cmap("viridis_r")(np.linspace(0.05, 0.95, len(numbers)))
    for K, found, shade in zip(numbers, sets, shades, strict=True):
        ax.plot(found.values.real, found.values.imag, "o", ms=4, color=shade, label=f"K = {K:g}")
    if limit is not None:
        ax.plot(limit.real, limit.imag, "kx", ms=7, label="K to infinity")
    ax.axvline(0.0, color="0.5", lw=1)
    ax.set(xlabel="Re (1/s)", ylabel="Im (rad/s)")
    ax.legend(fontsize="x-small")
    ax.grid(alpha=0.3)
    return ax
