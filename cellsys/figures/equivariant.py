"""Figures of equivariant models: poles by charge, forecasts with their bands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from cellsys.figures.axes import Pair, axes_of

if TYPE_CHECKING:
    from cellsys.cell import EquivariantModel
    from cellsys.cell.forecast import Forecast
    from cellsys.response.margins import Margins

MEANING = {
    0: "0 spreading, contraction",
    1: "1 translation, polarity",
    2: "2 elongation",
}


def equivariant_model(
    model: EquivariantModel, ax: Axes | None = None, *, t: float | None = None
) -> Axes:
    """Pole map coloured by charge, frozen at time t (default: end of the training runs)."""
    ax = axes_of(ax)
    poles = [p for p in model.labelled_poles(t) if np.isfinite(p.value)]
    for q in sorted({p.charge for p in poles}):
        of = np.array([p.value for p in poles if p.charge == q])
        label = f"charge {MEANING.get(q, q)}"
        ax.plot(of.real, of.imag, "x", color=f"C{q}", label=label, mew=1.6, ms=7)
    ax.axvline(0.0, color="0.5", lw=1)
    values = np.array([p.value for p in poles])
    height = 1.15 * max(np.abs(values.imag).max(initial=0.0), 0.02)
    ax.set_xscale("symlog", linthresh=1e-3)
    ax.set(
        xlabel="Re (1/s)",
        ylabel="Im (rad/s)",
        ylim=(-height, height),
        xlim=(1.6 * values.real.min(), 5e-4),
        title=f"order {model.order}, t = {model.horizon if t is None else t:g} s",
    )
    ax.legend(fontsize="small", loc="best")
    ax.grid(alpha=0.3)
    return ax


def forecast(result: Forecast, ax: Axes | None = None) -> Axes:
    """Centroid of a `Forecast` in the plane over time, with the band of any node."""
    ax = axes_of(ax)
    path = result.nodes.mean(axis=1)
    for k, name in enumerate("xy"):
        ax.fill_between(
            result.t,
            path[:, k] - result.half_width[:, k],
            path[:, k] + result.half_width[:, k],
            color=f"C{k}",
            alpha=0.2,
            lw=0,
        )
        ax.plot(result.t, path[:, k], color=f"C{k}", label=f"{name} of the centroid")
    for flag in result.flags:
        ax.axvline(flag.time, color="C3", lw=0.8, alpha=0.6)
    ax.set(xlabel="t (s)", ylabel="um", title=f"band: {100 * result.level:g} % of any node")
    ax.legend(fontsize="small")
    ax.grid(alpha=0.3)
    return ax


def bode_family(found: Mapping[float, Margins], axes: Pair | None = None) -> Pair:
    """Magnitude (dB) and phase (deg) of return ratios frozen at several times.

    Parameters
    ----------
    found : mapping of float to Margins
        From `ScheduledLoop.margins_along`; the first locus of each is drawn.
    axes : pair of matplotlib Axes, optional

    Returns
    -------
    pair of Axes
    """
    if axes is None:
        _, axes = plt.subplots(2, 1, sharex=True, layout="constrained")
    upper, lower = axes
    for k, (t, margins) in enumerate(found.items()):
        color = plt.get_cmap("viridis")(k / max(len(found) - 1, 1) * 0.9)
        value = margins.loci.values[0]
        shown = np.abs(value) > 0
        omega, value = margins.loci.omega[shown], value[shown]
        upper.semilogx(omega, 20 * np.log10(np.abs(value)), color=color, label=f"t = {t:g} s")
        lower.semilogx(omega, np.rad2deg(margins.loci.phase[0, shown]), color=color)
    upper.set(ylabel="|L| (dB)")
    lower.set(ylabel="phase (deg)", xlabel="frequency (rad/s)")
    upper.legend(fontsize="small")
    for ax in axes:
        ax.grid(alpha=0.3)
    return axes
