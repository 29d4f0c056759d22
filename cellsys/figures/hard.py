"""Figure of hard cases: error against hardness, of the naive route and of ours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes


def hard_sweep(
    hardness: Sequence[float],
    naive: Sequence[float],
    ours: Sequence[float],
    *,
    title: str,
    label: str,
    ax: Axes | None = None,
) -> Axes:
    """Two curves on logarithmic axes; a route that gave no number has a cross at the top.

    Errors below 1e-17 are drawn there.
    """
    if ax is None:
        from cellsys.figures.sheet import sheet

        _, ax = sheet((4.5, 3.5))
    x = np.asarray(hardness, float)
    for errors, style, name in ((naive, "s--", "naive"), (ours, "o-", "cellsys")):
        y = np.asarray(errors, float)
        known = np.isfinite(y)
        line = ax.plot(x[known], np.maximum(y[known], 1e-17), style, ms=4, label=name)[0]
        lost = x[~known]
        if len(lost):
            ax.plot(
                lost, np.full(len(lost), 0.97), "x", color=line.get_color(),
                transform=ax.get_xaxis_transform(), label=f"{name}: no number",
            )  # fmt: skip
    ax.set(xscale="log", yscale="log", xlabel=label, ylabel="error")
    if ax.get_xlim()[1] < 100 * ax.get_xlim()[0]:
        ax.tick_params(axis="x", which="minor", labelsize="x-small")
    ax.set_title(title, fontsize="medium")
    ax.legend(fontsize="small")
    return ax
