"""Figures of the polarity loop."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from cellsys.figures.reduction import pole_map


def headings(runs: dict[str, Any], ax: Any = None) -> Any:
    """Polarity (line) and sensed direction (dots) of the first cell against time, deg."""
    if ax is None:
        ax = plt.subplots(layout="constrained")[1]
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


def linearisation(point: Any, ax: Any = None) -> Any:
    """Closed-loop poles of a `Linearisation`."""
    ax = pole_map(point.poles, ax)
    ax.set_title("closed loop", fontsize="medium")
    return ax
