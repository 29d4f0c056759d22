"""Drawing of what accuracy costs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
from matplotlib.artist import Artist
from matplotlib.axes import Axes

if TYPE_CHECKING:
    from cellsys.accuracy import WorkPrecision


def work_precision(result: WorkPrecision, ax: Axes | None = None) -> list[Artist]:
    """Error against time of every setup, log-log, with the Pareto front in grey behind."""
    if ax is None:
        _, ax = plt.subplots(figsize=(7.5, 5.5), layout="constrained")
    drawn: list[Artist] = []
    front = result.front()
    drawn += ax.loglog(
        [p.error for p in front],
        [1e3 * p.seconds for p in front],
        color="0.8",
        lw=6,
        solid_capstyle="round",
        label="Pareto front",
        zorder=0,
    )
    measured = result.measured()
    for name in dict.fromkeys(p.setup for p in measured):
        points = [p for p in measured if p.setup == name]
        own = points[0].own
        drawn += ax.loglog(
            [p.error for p in points],
            [1e3 * p.seconds for p in points],
            "o-" if own else "s--",
            lw=2 if own else 1,
            ms=5,
            label=name,
        )
    gaps = [p for p in result.points if p.reason]
    title = f"{result.problem}: error against time"
    if gaps:
        title += f" ({len(gaps)} settings failed, see the table)"
    ax.set_title(title, fontsize=10)
    ax.set_xlabel(f"error ({result.measure})")
    ax.set_ylabel("time, ms")
    ax.invert_xaxis()
    ax.grid(True, which="major", color="0.9")
    ax.legend(fontsize=8, loc="upper left")
    note = ", ".join(f"{k} {v}" for k, v in result.footer.items())
    drawn.append(ax.annotate(note, (0.0, -0.16), xycoords="axes fraction", fontsize=6))
    return drawn
