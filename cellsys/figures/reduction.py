"""Figures of reduced models: singular values, pole maps, errors against order."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from cellsys.figures.axes import axes_of
from cellsys.model.card import DIVERGED

if TYPE_CHECKING:
    from cellsys.model.latent import LatentModel
    from cellsys.reduction.piecewise import PiecewiseModel
    from cellsys.spectra.certainty import PoleCertainty

COLOURS = {"PCR": "C0", "LeastSquares": "C1", "Equivariant": "C2"}


def pole_map(
    poles: np.ndarray, ax: Axes | None = None, *, spread: np.ndarray | None = None
) -> Axes:
    """Poles in the complex plane (1/s); circles of radius `spread` show how certain each is."""
    ax = axes_of(ax)
    shown = np.isfinite(poles)
    p = poles[shown]
    if spread is not None:
        for pole, radius in zip(p, spread[shown], strict=True):
            ax.add_patch(plt.Circle((pole.real, pole.imag), radius, color="C0", alpha=0.15, lw=0))
    right = p.real > 0
    ax.plot(p.real[~right], p.imag[~right], "x", color="C0", label="Re < 0")
    if right.any():
        ax.plot(p.real[right], p.imag[right], "x", color="C3", label=f"Re > 0 ({right.sum()})")
    ax.axvline(0.0, color="0.5", lw=1)
    span = max(np.abs(p.real).max(initial=0.0), 1e-6)
    ax.set_xscale("symlog", linthresh=max(1e-4, 1e-3 * span))
    ax.set_xlim(min(1.6 * p.real.min(initial=0.0), -1e-4), max(1.6 * p.real.max(initial=0.0), 1e-3))
    height = 1.15 * max(np.abs(p.imag).max(initial=0.0), 0.02)
    ax.set(xlabel="Re (1/s)", ylabel="Im (rad/s)", ylim=(-height, height))
    ax.legend(fontsize="small", loc="upper left")
    ax.grid(alpha=0.3)
    return ax


def latent_model(model: LatentModel | PiecewiseModel, ax: Axes | None = None) -> Axes:
    """Pole map of a `LatentModel`."""
    ax = pole_map(model.poles(), ax)
    ax.set_title(f"order {model.order}", fontsize="medium")
    return ax


def pole_certainty(result: PoleCertainty, ax: Axes | None = None) -> Axes:
    """Poles of a `PoleCertainty` with circles of their spread."""
    return pole_map(result.poles, ax, spread=result.spread)


def order_sweep(sweep: Any, ax: Axes | None = None) -> Axes:
    """Held-out error of the cells against order, with projection floor and baselines."""
    ax = axes_of(ax)
    for method in dict.fromkeys(r.method for r in sweep.rows):
        rows = [r for r in sweep.rows if r.method == method]
        m = [r.order for r in rows]
        error = np.array([r.error["cells"] for r in rows])
        fine = error < DIVERGED
        ax.plot(
            np.array(m)[fine],
            error[fine],
            "o-",
            color=COLOURS.get(method),
            label=f"{method}, held out",
        )
        for order in np.array(m)[~fine]:
            ax.annotate(
                f"{method} diverges", (order, 1.0), rotation=90, fontsize="small", va="bottom"
            )
    rows = [r for r in sweep.rows if r.method == sweep.rows[0].method]
    ax.plot(
        [r.order for r in rows],
        [r.floor["cells"] for r in rows],
        "k:",
        label="projection floor",
    )
    for (name, value), style in zip(
        rows[0].baselines["cells"].items(), ("-", "--", "-."), strict=True
    ):
        ax.axhline(value, color="0.5", ls=style, lw=1, label=name)
    ax.set(xscale="log", yscale="log", xlabel="order m", ylabel="error on cells / their motion")
    ax.set_xticks([r.order for r in rows], [str(r.order) for r in rows])
    ax.minorticks_off()
    ax.legend(fontsize="x-small", ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.18))
    ax.grid(alpha=0.3)
    return ax


def error_against_time(sweep: Any, ax: Axes | None = None) -> Axes:
    """Held-out error against wall time of one run: what accuracy costs."""
    ax = axes_of(ax)
    for method in dict.fromkeys(r.method for r in sweep.rows):
        rows = [r for r in sweep.rows if r.method == method and r.error["cells"] < DIVERGED]
        ax.plot(
            [1e-3 * r.roll_out_ms for r in rows],
            [r.error["cells"] for r in rows],
            "o-",
            lw=0.7,
            color=COLOURS.get(method),
            label=method,
        )
        # The orders between lie on the line: their labels would hide each other.
        for r, side in zip(rows[:1] + rows[1:][-1:], ("right", "left"), strict=False):
            place = (1e-3 * r.roll_out_ms, r.error["cells"])
            ax.annotate(f"  m = {r.order}  ", place, fontsize="small", ha=side, va="center",
                        color=COLOURS.get(method))  # fmt: skip
    ax.axvline(sweep.full_order_s, color="k", lw=1)
    ax.text(
        sweep.full_order_s,
        0.04,
        "full order ",
        rotation=90,
        fontsize="small",
        ha="right",
        transform=ax.get_xaxis_transform(),
    )
    ax.set(
        xscale="log",
        yscale="log",
        xlabel=f"wall time of {sweep.horizon_s:g} s (s)",
        ylabel="error on cells / their motion",
    )
    ax.margins(x=0.2)
    ax.legend(fontsize="small")
    ax.grid(alpha=0.3, which="both")
    return ax
