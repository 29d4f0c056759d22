"""Figures of the response room: Bode, Nyquist, pole map, singular values, pseudospectra, ..."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np


def _axes(ax: Any) -> Any:
    return plt.subplots()[1] if ax is None else ax


def _names(response: Any) -> list[tuple[int, int, str]]:
    p, m = response.response.shape[:2]
    one = p * m == 1
    return [
        (i, j, "" if one else f"{response.inputs[j]} to {response.outputs[i]}")
        for i in range(p)
        for j in range(m)
    ]


def bode(response: Any, ax: Any = None) -> Any:
    """Magnitude (dB) and phase (deg) of a `FrequencyResponse`.

    Parameters
    ----------
    response : FrequencyResponse
    ax : pair of matplotlib Axes, or one Axes, optional
        Two: magnitude and phase. One: magnitude only. None: a new figure with both.

    Returns
    -------
    tuple of Axes, or Axes when one was given
    """
    single = ax is not None and np.ndim(ax) == 0
    if ax is None:
        _, ax = plt.subplots(2, 1, sharex=True, layout="constrained")
    upper, lower = (ax, None) if single else ax
    for i, j, label in _names(response):
        size = response.magnitude[i, j]
        shown = size > 0
        decibel = 20 * np.log10(size[shown])
        upper.semilogx(response.omega[shown], decibel, label=label or None)
        if lower is not None:
            phase = np.rad2deg(response.phase[i, j][shown])
            if phase.size:
                phase = phase - 360 * np.round((phase[0] + 90) / 360)  # start in (-270, 90]
            lower.semilogx(response.omega[shown], phase)
    upper.set_ylabel("|G| (dB)")
    upper.grid(True, which="both", alpha=0.3)
    if any(label for _, _, label in _names(response)) and response.omega.size:
        upper.legend(fontsize="small")
    bottom = upper if lower is None else lower
    bottom.set_xlabel("frequency (rad/s)")
    if lower is not None:
        lower.set_ylabel("phase (deg)")
        lower.yaxis.set_major_locator(plt.MultipleLocator(_phase_step(lower)))
        lower.grid(True, which="both", alpha=0.3)
    return upper if single else (upper, lower)


def _phase_step(ax: Any) -> float:
    low, high = ax.get_ylim()
    return next((s for s in (15, 45, 90, 180, 360) if (high - low) / s <= 8), 720.0)


def nyquist(result: Any, ax: Any = None) -> Any:
    """Nyquist plot of `Margins` (eigenvalue loci) or of a `FrequencyResponse` (its channels).

    The part for negative frequencies is dashed; -1 is marked. Values beyond 4 are drawn pulled in
    to the circle of radius 4 to 5, so that integrators do not flatten the rest.

    Parameters
    ----------
    result : Margins or FrequencyResponse
    ax : matplotlib Axes, optional

    Returns
    -------
    Axes
    """
    ax = _axes(ax)
    margins = hasattr(result, "loci")
    values = result.loci.values if margins else result.response.reshape(-1, len(result.omega))
    for number, value in enumerate(values):
        shown = _pull_in(value)
        (line,) = ax.plot(shown.real, shown.imag, lw=1.5, label=f"locus {number + 1}")
        ax.plot(shown.real, -shown.imag, "--", lw=1, color=line.get_color())
        if len(shown) > 3:
            at = int(np.argmin(np.abs(np.abs(shown) - np.median(np.abs(shown)))))
            at = min(max(at, 1), len(shown) - 2)
            ax.annotate(
                "", xy=(shown.real[at + 1], shown.imag[at + 1]),
                xytext=(shown.real[at - 1], shown.imag[at - 1]),
                arrowprops={"arrowstyle": "->", "color": line.get_color()},
            )
    turn = np.linspace(0, 2 * np.pi, 200)
    ax.plot(np.cos(turn), np.sin(turn), ":", color="0.6", lw=1)
    ax.plot(-1, 0, "+", color="C3", ms=12, mew=2)
    if margins:
        ax.set_title(
            f"gain margin {result.gain_margin:.4g}, phase margin {result.phase_margin:.4g} deg",
            fontsize="medium",
        )
    if len(values) > 1:
        ax.legend(fontsize="small")
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("Re L")
    ax.set_ylabel("Im L")
    ax.grid(True, alpha=0.3)
    return ax


def _pull_in(value: np.ndarray, radius: float = 4.0) -> np.ndarray:
    size = np.abs(value)
    far = size > radius
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(far, value / size * (radius + 1 - radius / np.maximum(size, radius)), value)


def pole_zero_map(result: Any, ax: Any = None) -> Any:
    """Poles as crosses or zeros as circles, coloured by condition number when it exceeds 100.

    Parameters
    ----------
    result : RootSet or DampingTable
    ax : matplotlib Axes, optional
        Draw poles and zeros into the same axes by two calls.

    Returns
    -------
    Axes
    """
    ax = _axes(ax)
    roots = getattr(result, "poles", result)
    zero = roots.kind == "zero"
    z = np.asarray(roots)
    size = roots.cluster_size
    if zero:
        ax.plot(z.real, z.imag, "o", mfc="none", mec="C0", ms=7, label="zeros")
    else:
        ax.plot(z.real, z.imag, "x", color="C3", ms=7, mew=1.5, label="poles")
    for label in np.unique(roots.cluster[size > 1]):
        members = z[roots.cluster == label]
        if np.ptp(np.abs(members - members[0])) < 0.02 * max(np.abs(z).max(), 1e-300):
            where = members.mean()
            ax.annotate(f"{len(members)}", (where.real, where.imag), xytext=(5, 4),
                        textcoords="offset points", fontsize="small")
    if roots.dt > 0:
        turn = np.linspace(0, 2 * np.pi, 200)
        ax.plot(np.cos(turn), np.sin(turn), "-", color="0.6", lw=1)
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_xlabel("Re z")
        ax.set_ylabel("Im z")
    else:
        ax.axvline(0, color="0.6", lw=1)
        ax.set_xlabel("real part (1/s)")
        ax.set_ylabel("imaginary part (rad/s)")
    ax.axhline(0, color="0.8", lw=0.8, zorder=0)
    ax.grid(True, alpha=0.3)
    return ax


def singular_values(response: Any, ax: Any = None) -> Any:
    """Singular values (dB) of a `FrequencyResponse` over frequency.

    Parameters
    ----------
    response : FrequencyResponse
    ax : matplotlib Axes, optional

    Returns
    -------
    Axes
    """
    ax = _axes(ax)
    for value in response.singular_values:
        shown = value > 0
        ax.semilogx(response.omega[shown], 20 * np.log10(value[shown]))
    ax.set_xlabel("frequency (rad/s)")
    ax.set_ylabel("singular values (dB)")
    ax.grid(True, which="both", alpha=0.3)
    return ax


def pseudospectra(result: Any, ax: Any = None) -> Any:
    """Level lines of log10 sigma_min(z I - A) with the poles on top.

    Parameters
    ----------
    result : Pseudospectra
    ax : matplotlib Axes, optional

    Returns
    -------
    Axes
    """
    ax = _axes(ax)
    level = np.log10(np.maximum(result.sigma, 1e-300))
    low, high = max(np.floor(level.min()), -20.0), np.ceil(level.max())
    lines = np.linspace(low, high, 13) if high - low < 4 else np.arange(low, high + 1)
    drawn = ax.contour(result.x, result.y, level, levels=lines, cmap="viridis", linewidths=1)
    ax.figure.colorbar(drawn, ax=ax, label="log10 of the perturbation size")
    z = np.asarray(result.poles)
    ax.plot(z.real, z.imag, "x", color="C3", ms=6, mew=1.5)
    if result.dt > 0:
        turn = np.linspace(0, 2 * np.pi, 200)
        ax.plot(np.cos(turn), np.sin(turn), "-", color="0.4", lw=1)
    else:
        ax.axvline(0, color="0.4", lw=1)
    ax.set_xlim(result.x[0], result.x[-1])
    ax.set_ylim(result.y[0], result.y[-1])
    ax.set_xlabel("Re z")
    ax.set_ylabel("Im z")
    return ax


def stability(report: Any, ax: Any = None) -> Any:
    """Pseudospectra of a `StabilityReport` over its poles, the verdict above.

    Parameters
    ----------
    report : StabilityReport
    ax : matplotlib Axes, optional

    Returns
    -------
    Axes
    """
    ax = pseudospectra(report.pseudospectra, ax=ax) if len(report.A) else _axes(ax)
    ax.set_title(f"{report.verdict}; distance to instability {report.distance:.3g}",
                 fontsize="medium")
    return ax
