"""Figures of the full-order model: cell and matrix from above and from the side, fields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection

from cellsys.figures.axes import Pair, axes_of
from cellsys.figures.sheet import not_drawn
from cellsys.trajectory import cell_names

if TYPE_CHECKING:
    from cellsys.observe.pairs import PairReadout
    from cellsys.trajectory import Trajectory

CELL, FIBRE = "#c0504d", "0.75"


def cell_from_above(
    position: np.ndarray,
    triangles: np.ndarray,
    nodes: np.ndarray,
    fibres: np.ndarray,
    ax: Axes | None = None,
) -> Axes:
    """Membrane (n, 3) over the matrix nodes (N, 3) with its fibres, um, seen from above."""
    return cells_from_above([(position, triangles)], nodes, fibres, ax)


def cells_from_above(
    cells: Sequence[tuple[np.ndarray, np.ndarray]],
    nodes: np.ndarray | None = None,
    fibres: np.ndarray | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Membranes, each (positions (n, 3), triangles), over the matrix if there is one, um."""
    ax = axes_of(ax)
    for position, triangles in cells:
        _membrane(position, triangles, ax)
    ax.set(xlabel="x (um)", ylabel="y (um)")
    ax.set_aspect("equal")
    if nodes is None or fibres is None:
        ax.autoscale_view()
        return ax
    top = fibres[nodes[fibres].mean(axis=1)[:, 2] > -0.7]
    ax.add_collection(LineCollection(nodes[top][:, :, :2], colors=FIBRE, linewidths=0.4, zorder=0))
    reach = 1.02 * np.abs(nodes[:, :2]).max()
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach))
    return ax


def _membrane(position: np.ndarray, triangles: np.ndarray, ax: Axes) -> None:
    order = np.argsort(position[triangles].mean(axis=1)[:, 2])
    ax.add_collection(
        PolyCollection(
            position[triangles[order]][:, :, :2],
            facecolors=CELL,
            edgecolors="white",
            linewidths=0.3,
            alpha=0.55,
        )
    )


def cell_from_side(position: np.ndarray, triangles: np.ndarray, ax: Axes | None = None) -> Axes:
    """Membrane (n, 3), um, seen along y, on the plane z = 0."""
    ax = axes_of(ax)
    order = np.argsort(-position[triangles].mean(axis=1)[:, 1])
    ax.add_collection(
        PolyCollection(
            position[triangles[order]][:, :, [0, 2]],
            facecolors=CELL,
            edgecolors="white",
            linewidths=0.3,
            alpha=0.55,
        )
    )
    ax.axhline(0.0, color="0.4", lw=1)
    x = position[:, 0]
    ax.set(xlim=(x.mean() - 18, x.mean() + 18), ylim=(-1.5, 17.5), xlabel="x (um)", ylabel="z (um)")
    ax.set_aspect("equal")
    return ax


def displacement_field(
    rest: np.ndarray, u: np.ndarray, ax: Axes | None = None, *, error: float = 0.0
) -> Axes:
    """Horizontal displacement (N, 3) of the surface of the matrix, arrows over colour, um.

    A field that nowhere exceeds its own `error` (um, `Trajectory.error_of`) is not drawn, and the
    axes say so: arrows are scaled to the largest, and would show rounding as a pattern.
    """
    ax = axes_of(ax)
    top = rest[:, 2] > -0.7
    x, v = rest[top], u[top]
    size = np.hypot(v[:, 0], v[:, 1])
    reach = 1.02 * float(np.abs(x[:, :2]).max(initial=0.0)) or 1.0
    ax.set(xlabel="x (um)", ylabel="y (um)", xlim=(-reach, reach), ylim=(-reach, reach))
    ax.set_aspect("equal")
    if not size.max(initial=0.0) > error:
        return not_drawn(ax, error)
    dots = ax.scatter(x[:, 0], x[:, 1], c=size, s=18, cmap="viridis")
    ax.quiver(x[:, 0], x[:, 1], v[:, 0], v[:, 1], angles="xy", color="k", width=0.0025)
    ax.figure.colorbar(dots, ax=ax, label="horizontal displacement (um)", shrink=0.85)
    return ax


def trajectory(run: Trajectory, ax: Axes | None = None) -> Axes:
    """Centres of the cells against time (um), or the first states when there is no cell."""
    ax = axes_of(ax)
    cells = cell_names(run.states)
    if cells:
        for name in cells:
            path = run.block(f"{name}.position").mean(axis=1)
            for k, axis in enumerate("xyz"):
                ax.plot(run.t, path[:, k], label=f"{name} {axis}")
        ax.set_ylabel("centre (um)")
    else:
        names = run.states.names[:8]
        for k, name in enumerate(names):
            ax.plot(run.t, np.asarray(run.x)[:, k], label=name)
        ax.set_ylabel("state")
    ax.set_xlabel("time (s)")
    ax.legend(fontsize="small", ncols=2)
    ax.grid(alpha=0.3)
    return ax


def pair_gaps(pairs: Mapping[tuple[int, int], PairReadout], axes: Pair | None = None) -> Pair:
    """Gaps of the nearest six pairs (um), and speed of the matrix in each, together and alone."""
    if axes is None:
        axes = plt.subplots(1, 2, layout="constrained")[1]
    gaps, speeds = axes
    near = sorted(pairs.items(), key=lambda item: item[1].gap[0])[:6]
    for c, ((i, j), pair) in enumerate(near):
        name = f"cells {i + 1} and {j + 1}"
        gaps.plot(np.append(pair.t, 2 * pair.t[-1] - pair.t[-2] if len(pair.t) > 1 else pair.t[-1]),
                  pair.gap, color=f"C{c}", label=name)  # fmt: skip
        speeds.plot(pair.t, pair.gap_speed, color=f"C{c}", label=name)
        speeds.plot(pair.t, pair.gap_alone, ":", color=f"C{c}", label="one of them alone")
    gaps.set(xlabel="time (s)", ylabel="gap between the edges (um)")
    speeds.set(xlabel="time (s)", ylabel="speed of the matrix in the gap (nm/s)", yscale="log")
    for ax in (gaps, speeds):
        ax.grid(alpha=0.3)
        ax.legend(fontsize="x-small")
    return axes
