"""Figures of cells in a gel: from the side, a section, thickness along the axis and over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection

from cellsys.figures.axes import axes_of, labelled
from cellsys.figures.sheet import not_drawn
from cellsys.figures.spreading import CELL, FIBRE
from cellsys.observe.gel import gel_contraction, lateral_boundary, local_volumes
from cellsys.trajectory import cell_names

if TYPE_CHECKING:
    from cellsys.observe.gel import GelContraction
    from cellsys.trajectory import Trajectory

_MATRIX = "matrix.displacement"


def gel_side(run: Trajectory, ax: Axes | None = None, *, k: int = -1) -> Axes:
    """Cells and gel seen along y at sample k, um: nodes, membranes, outline now and at rest."""
    ax = axes_of(ax)
    _, _, rest = lateral_boundary(run)
    now = rest + run.block(_MATRIX)[k]
    order = np.argsort(-now[:, 1])
    shade = now[order, 1]
    ax.scatter(now[order, 0], now[order, 2], c=-shade, s=2, cmap="Greys", vmin=-2 * shade.max())
    for name in cell_names(run.states):
        x, triangles = run.block(f"{name}.position")[k], run.geometry[f"{name}.triangles"]
        front = np.argsort(-x[triangles].mean(axis=1)[:, 1])
        ax.add_collection(
            PolyCollection(
                x[triangles[front]][:, :, [0, 2]], facecolors=CELL, edgecolors="white",
                linewidths=0.3, alpha=0.8,
            )
        )  # fmt: skip
    found, half = gel_contraction(run), 0.5 * float(run.geometry["matrix.size"][2])
    for values, style in ((np.ones(len(found.x)), "k:"), (found.thickness[k], "k-")):
        for side in (1.0, -1.0):
            ax.plot(found.x, side * half * values, style, lw=1.2)
    ax.set(xlabel="x (um)", ylabel="z (um)", title=f"t = {run.t[k]:g} s")
    ax.set_aspect("equal")
    return ax


def gel_section(
    run: Trajectory, k: int = -1, ax: Axes | None = None, *, error: float = 0.0
) -> Axes:
    """Section |y| < 1.5 spacings at sample k: arrows of displacement over local volume, um."""
    ax = axes_of(ax)
    _, _, rest = lateral_boundary(run)
    u = run.block(_MATRIX)[k]
    ax.set(xlabel="x (um)", ylabel="z (um)")
    ax.set_aspect("equal")
    if not np.linalg.norm(u, axis=1).max(initial=0.0) > error:
        return not_drawn(ax, error)
    volume = local_volumes(rest, u)
    size = run.geometry["matrix.size"]
    thin = np.abs(rest[:, 1]) < 1.5 * np.cbrt(np.prod(size) / len(rest))
    now = rest[thin] + u[thin]
    dots = ax.scatter(now[:, 0], now[:, 2], c=volume[thin], s=24, cmap="RdBu", vmin=0.5, vmax=1.5)
    ax.quiver(
        rest[thin, 0], rest[thin, 2], u[thin, 0], u[thin, 2],
        angles="xy", scale_units="xy", scale=0.5, width=0.0018, color="k",
    )  # fmt: skip
    for name in cell_names(run.states):
        x, triangles = run.block(f"{name}.position")[k], run.geometry[f"{name}.triangles"]
        sides = x[triangles[:, [0, 1, 2, 0]]][:, :, [0, 2]]
        ax.add_collection(LineCollection(list(sides), colors=FIBRE, linewidths=0.3, zorder=0))
    ax.figure.colorbar(dots, ax=ax, label="volume / volume at rest", shrink=0.8)
    return ax


def gel_thickness(
    found: GelContraction,
    ax: Axes | None = None,
    *,
    times: Sequence[float] = (0.0, 500.0, 1500.0),
    controls: Mapping[str, GelContraction] | None = None,
) -> Axes:
    """Thickness ratio along the axis at the samples nearest to `times` (s), controls dashed."""
    ax = axes_of(ax)
    for c, time in enumerate(times):
        for name, one in {"": found, **(controls or {})}.items():
            k = int(np.abs(one.t - time).argmin())
            told = f"{one.t[k]:g} s" + (f", {name}" if name else "")
            ax.plot(one.x, one.thickness[k], "--" if name else "-", color=f"C{c}", label=told)
    labelled(ax, "x at rest (um)", "thickness / thickness at rest")
    ax.legend(fontsize="small")
    return ax


def gel_course(courses: Mapping[str, GelContraction], ax: Axes | None = None) -> Axes:
    """Greatest contraction over time of several runs."""
    ax = axes_of(ax)
    for name, one in courses.items():
        ax.plot(one.t, one.course(), label=name)
    labelled(ax, "time (s)", "greatest contraction")
    ax.legend(fontsize="small")
    return ax
