"""Traction field of a cell: stress over colour, forces of the nodes as arrows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from cellsys.figures.axes import axes_of

if TYPE_CHECKING:
    from cellsys.observe.tractions import Tractions


def traction_field(found: Tractions, ax: Axes | None = None) -> Axes:
    """Smoothed traction stress (Pa) and nodal forces in the plane, from above, um."""
    ax = axes_of(ax)
    stress = found.map()
    size = np.hypot(stress.stress[..., 0], stress.stress[..., 1])
    mesh = ax.pcolormesh(stress.x, stress.y, size, cmap="magma", shading="nearest")
    ax.figure.colorbar(mesh, ax=ax, label="traction (Pa)", shrink=0.85)
    loaded = np.any(found.force[:, :2] != 0.0, axis=1)
    x, f = found.place[loaded], found.force[loaded]
    if len(x):
        ax.quiver(x[:, 0], x[:, 1], f[:, 0], f[:, 1], angles="xy", color="w", width=0.003)
    ax.plot(*found.centre[:2], "o", color="#c0504d", ms=4)
    ax.set(xlabel="x (um)", ylabel="y (um)")
    ax.set_aspect("equal")
    return ax
