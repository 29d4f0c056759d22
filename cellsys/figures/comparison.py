"""Figures of how a model was chosen: reductors side by side, selection, learning curve."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from cellsys.figures.axes import axes_of

if TYPE_CHECKING:
    from cellsys.reduction.comparison import Comparison
    from cellsys.reduction.selection import LearningCurve, Selection


def comparison(result: Comparison, ax: Axes | None = None) -> Axes:
    """Held-out error against order, a line a method, with floor and baselines; x: diverges."""
    ax = axes_of(ax)
    top = 1.5 * max([1.0, *(r.error for r in result.rows if r.error < 10.0)])
    for k, name in enumerate(dict.fromkeys(r.settings for r in result.rows)):
        rows = [r for r in result.rows if r.settings == name]
        rows.sort(key=lambda r: r.order)
        orders = np.array([r.order for r in rows])
        error = np.array([r.error for r in rows])
        shown = error <= top
        ax.plot(orders[shown], error[shown], "o-", color=f"C{k}", label=rows[0].method)
        if (~shown).any():
            where = np.full((~shown).sum(), top) * 0.97**k
            ax.plot(orders[~shown], where, "x", color=f"C{k}", ms=8)
    floor = {r.order: r.floor for r in result.rows if np.isfinite(r.floor)}
    known = sorted({r.order for r in result.rows if r.settings == result.rows[0].settings})
    ax.plot(known, [floor.get(m, np.nan) for m in known], "k:", label="projection floor")
    styles = ("-", "--", "-.", (0, (1, 1)), (0, (5, 1, 1, 1, 1, 1)))
    for k, (name, value) in enumerate(result.baselines.items()):
        ax.axhline(value, color="0.5", ls=styles[k % len(styles)], lw=1, label=name)
    ticks = sorted({r.order for r in result.rows})
    ax.set(
        xscale="log",
        yscale="log",
        xlabel="order m",
        ylabel=f"held-out error on {result.block} / their motion",
        title=f"x: beyond {top:.2g} or diverges",
    )
    ax.set_xticks(ticks, [str(m) for m in ticks])
    ax.minorticks_off()
    ax.legend(fontsize="x-small", ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.15))
    ax.grid(alpha=0.3)
    return ax


def selection(result: Selection, ax: Axes | None = None) -> Axes:
    """Validation error of every candidate with its spread over folds; the chosen one filled."""
    ax = axes_of(ax)
    rows = sorted(result.rows, key=lambda r: r.error)[:20]
    for k, r in enumerate(rows):
        chosen = (r.settings, r.order) == (result.settings, result.order)
        spread = r.spread if np.isfinite(r.spread) else 0.0
        ax.errorbar(
            r.error,
            -k,
            xerr=spread,
            fmt="o",
            color="C3" if chosen else "C0",
            mfc="C3" if chosen else "white",
        )
    ax.set_yticks(-np.arange(len(rows)), [f"{r.method} {r.order}" for r in rows], fontsize="small")
    ax.axvline(result.error, color="k", lw=1, label="nested: what the choice is worth")
    ax.set(xscale="log", xlabel="roll-out error on validation runs / motion")
    ax.legend(fontsize="small")
    ax.grid(alpha=0.3)
    return ax


def learning_curve(result: LearningCurve, ax: Axes | None = None) -> Axes:
    """Held-out and training error against the number of training runs."""
    ax = axes_of(ax)
    for name, mean, spread, colour in (
        ("held out", result.held_out, result.held_out_spread, "C0"),
        ("training", result.training, result.training_spread, "0.6"),
    ):
        ax.errorbar(result.counts, mean, yerr=spread, fmt="o-", color=colour, label=name, capsize=3)
    ax.set(xlabel="training runs", ylabel="error / motion", yscale="log")
    ax.set_xticks(result.counts, [str(c) for c in result.counts])
    ax.legend(fontsize="small")
    ax.grid(alpha=0.3)
    return ax
