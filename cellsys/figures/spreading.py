"""Figures of the full-order model: cell and matrix from above and from the side, fields."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import LineCollection, PolyCollection

CELL, FIBRE = "#c0504d", "0.75"


def _axes(ax: Any) -> Any:
    return plt.subplots(layout="constrained")[1] if ax is None else ax


def cell_from_above(
    position: np.ndarray,
    triangles: np.ndarray,
    nodes: np.ndarray,
    fibres: np.ndarray,
    ax: Any = None,
) -> Any:
    """Membrane (n, 3) over the matrix nodes (N, 3) with its fibres, um, seen from above."""
    ax = _axes(ax)
    top = fibres[nodes[fibres].mean(axis=1)[:, 2] > -0.7]
    ax.add_collection(LineCollection(nodes[top][:, :, :2], colors=FIBRE, linewidths=0.4))
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
    reach = 1.02 * np.abs(nodes[:, :2]).max()
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel="x (um)", ylabel="y (um)")
    ax.set_aspect("equal")
    return ax


def cell_from_side(position: np.ndarray, triangles: np.ndarray, ax: Any = None) -> Any:
    """Membrane (n, 3), um, seen along y, on the plane z = 0."""
    ax = _axes(ax)
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


def displacement_field(rest: np.ndarray, u: np.ndarray, ax: Any = None) -> Any:
    """Horizontal displacement (N, 3) of the surface of the matrix, arrows over colour, um."""
    ax = _axes(ax)
    top = rest[:, 2] > -0.7
    x, v = rest[top], u[top]
    size = np.hypot(v[:, 0], v[:, 1])
    dots = ax.scatter(x[:, 0], x[:, 1], c=size, s=18, cmap="viridis")
    ax.quiver(x[:, 0], x[:, 1], v[:, 0], v[:, 1], angles="xy", color="k", width=0.0025)
    ax.figure.colorbar(dots, ax=ax, label="displacement (um)", shrink=0.85)
    ax.set(xlabel="x (um)", ylabel="y (um)")
    ax.set_aspect("equal")
    return ax


def trajectory(run: Any, ax: Any = None) -> Any:
    """Centres of the cells against time (um), or the first states when there is no cell."""
    ax = _axes(ax)
    cells = [b.name for b in run.states if b.name.endswith(".position")]
    if cells:
        for name in cells:
            path = run.block(name).mean(axis=1)
            for k, axis in enumerate("xyz"):
                ax.plot(run.t, path[:, k], label=f"{name.split('.')[0]} {axis}")
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
