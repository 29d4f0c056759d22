"""Figures of the polarity loop."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from cellsys.figures.axes import axes_of
from cellsys.figures.reduction import pole_map

if TYPE_CHECKING:
    from cellsys.loop import Linearisation
    from cellsys.trajectory import Trajectory


def headings(runs: dict[str, Trajectory], ax: Axes | None = None) -> Axes:
    """Polarity (line) and sensed direction (dots) of the first cell against time, deg."""
    ax = axes_of(ax)
    for k, (label, run) in enumerate(runs.items()):
        for values, style in ((run.p, "-"), (run.d, ":")):
            if values is None:
                continue
            v = np.asarray(values)[:, 0]
            angle = np.degrees(np.arctan2(v[:, 1], v[:, 0]))
            # A jump from 180 to -180 is no motion: break the line there.
            angle[1:][np.abs(np.diff(angle)) > 180.0] = np.nan
            name = "polarity p" if style == "-" else "sensed d"
            ax.plot(run.t, angle, style, color=f"C{k}", label=f"{label}: {name}")
    ax.set(xlabel="time (s)", ylabel="angle (deg)", ylim=(-185, 185))
    ax.set_yticks(range(-180, 181, 60))
    ax.legend(fontsize="small")
    ax.grid(alpha=0.3)
    return ax


def linearisation(point: Linearisation, ax: Axes | None = None) -> Axes:
    """Closed-loop poles of a `Linearisation`."""
    ax = pole_map(point.poles, ax)
    ax.set_title("closed loop", fontsize="medium")
    return ax
