"""Bode and Nyquist plots of responses, of margins, and of samples with theirs."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from cellsys.figures.axes import Pair, axes_of, labelled, unit_circle
from cellsys.response.frequency import FrequencyResponse
from cellsys.response.margins import Margins
from cellsys.response.measured import MeasuredMargins

Drawn = FrequencyResponse | Margins | MeasuredMargins
_STEPS = (0.1, 0.5, 1, 5, 15, 45, 90, 180, 360)  # deg between the marks of a phase axis


def _lines(found: Drawn) -> tuple[list[tuple[np.ndarray, str]], np.ndarray, np.ndarray]:
    """Curves with their names, frequencies (k,), phases in rad (c, k)."""
    if isinstance(found, MeasuredMargins):
        return [(found.values, "")], found.omega, np.unwrap(np.angle(found.values))[None, :]
    if isinstance(found, Margins):
        return [(v, "") for v in found.loci.values], found.loci.omega, found.loci.phase
    p, m = found.response.shape[:2]
    channels = [
        (found.response[i, j], f"{found.inputs[j]} to {found.outputs[i]}" * (p * m > 1))
        for i, j in np.ndindex(p, m)
    ]
    return channels, found.omega, found.phase


def _told(result: Margins | MeasuredMargins) -> str:
    """The margins in a line; that of an unstable loop says so."""
    text = f"gain margin {result.gain_margin:.4g}, phase margin {result.phase_margin:.4g} deg"
    if isinstance(result, Margins) and not result.closed_loop_stable:
        return f"closed loop NOT stable: {text}"
    return text


def bode(
    result: Drawn,
    ax: Axes | Pair | None = None,
    *,
    label: str | None = None,
    color: str | None = None,
) -> Axes | Pair:
    """Magnitude (dB) and phase (deg) of a response, or of margins with their crossovers.

    Parameters
    ----------
    result : FrequencyResponse, Margins or MeasuredMargins
        Of margins: the loci of L; lines at 0 dB and -180 deg, and stems from them to the curves
        where |L| = 1 (phase) and where L < 0 (magnitude).
    ax : pair of matplotlib Axes, or one Axes, optional
        Two: magnitude and phase. One: magnitude only. None: a new figure with both. Several
        results may be drawn into the same axes.
    label, color : str, optional
        Of the curves.

    Returns
    -------
    tuple of Axes, or Axes when one was given
    """
    lower: Axes | None = None
    if isinstance(ax, Axes):
        upper = ax
    else:
        pair = plt.subplots(2, 1, sharex=True, layout="constrained")[1] if ax is None else ax
        upper, lower = pair
    margins = None if isinstance(result, FrequencyResponse) else result
    lines, omega, phase = _lines(result)
    # From the low-frequency asymptote on: 1/s^3 starts at -270 deg.
    phases = np.rad2deg(phase).reshape(-1, len(omega))
    for (value, name), turned in zip(lines, phases, strict=True):
        shown = np.abs(value) > 0
        w, size = omega[shown], 20 * np.log10(np.abs(value[shown]))
        named = " ".join(part for part in (label or "", name) if part)
        upper.semilogx(w, size, label=named or None, color=color)
        if lower is not None and len(w):
            lower.semilogx(w, turned[shown], color=color)
            if margins is not None and len(lines) == 1:
                _phase_stems(lower, margins, w, turned[shown])
    if margins is not None:
        upper.axhline(0.0, color="0.4", lw=0.8)
        for at, factor in margins.phase_crossings:
            if omega[0] <= at <= omega[-1]:
                upper.plot([at, at], [0.0, -20 * np.log10(factor)], "-", color="C3", lw=1)
                upper.plot(at, -20 * np.log10(factor), "o", color="C3", ms=5)
        upper.set_title(_told(margins), fontsize="medium")
    if any(str(line.get_label())[:1] != "_" for line in upper.lines):
        upper.legend(fontsize="small")
    symbol = "|G| (dB)" if margins is None else "|L| (dB)"
    labelled(upper, "frequency (rad/s)" if lower is None else "", symbol)
    if lower is not None:
        low, high = lower.get_ylim()
        step = next((s for s in _STEPS if (high - low) / s <= 8), 720.0)
        lower.yaxis.set_major_locator(plt.MultipleLocator(step))
        labelled(lower, "frequency (rad/s)", "phase (deg)")
    return upper if lower is None else (upper, lower)


def _phase_stems(
    ax: Axes, margins: Margins | MeasuredMargins, omega: np.ndarray, phase: np.ndarray
) -> None:
    """-180 deg (or that by whole turns) where it matters, and the phase margins from there."""
    for at, above in margins.gain_crossings:
        if not omega[0] <= at <= omega[-1]:
            continue
        reached = float(np.interp(np.log(at), np.log(omega), phase))
        # From the line that the margin is counted from; a margin near 180 deg leaves it outside.
        ax.plot([at, at], [reached - above, reached], "-", color="C3", lw=1)
        ax.plot(at, reached, "o", color="C3", ms=5)
        ax.axhline(reached - above, color="0.4", lw=0.8)


def nyquist(
    result: Drawn,
    ax: Axes | None = None,
    *,
    label: str | None = None,
    color: str | None = None,
) -> Axes:
    """Nyquist plot of margins (eigenvalue loci) or of a `FrequencyResponse` (its channels).

    The part for negative frequencies is dashed; -1 is marked. Values beyond 4 are drawn pulled in
    to the circle of radius 4 to 5, so that integrators do not flatten the rest.

    Parameters
    ----------
    result : Margins, MeasuredMargins or FrequencyResponse
    ax : matplotlib Axes, optional
    label, color : str, optional
        Of the curves.

    Returns
    -------
    Axes
    """
    ax = axes_of(ax, None)
    lines, _, _ = _lines(result)
    for number, (value, channel) in enumerate(lines):
        shown, name = _pull_in(value), label or channel or f"locus {number + 1}"
        (line,) = ax.plot(shown.real, shown.imag, lw=1.5, label=name, color=color)
        ax.plot(shown.real, -shown.imag, "--", lw=1, color=line.get_color())
        if len(shown) > 3:
            at = int(np.argmin(np.abs(np.abs(shown) - np.median(np.abs(shown)))))
            at = min(max(at, 1), len(shown) - 2)
            ax.annotate(
                "",
                xy=(shown.real[at + 1], shown.imag[at + 1]),
                xytext=(shown.real[at - 1], shown.imag[at - 1]),
                arrowprops={"arrowstyle": "->", "color": line.get_color()},
            )
    unit_circle(ax, ":")
    ax.plot(-1, 0, "+", color="C3", ms=12, mew=2)
    if not isinstance(result, FrequencyResponse):
        ax.set_title(_told(result), fontsize="medium")
    if any(np.abs(value).max(initial=0.0) > 4.0 for value, _ in lines):
        ax.text(0.01, 0.01, "beyond 4: pulled in", transform=ax.transAxes, fontsize="x-small")
    if len(lines) > 1 or label:
        ax.legend(fontsize="small")
    ax.set_aspect("equal", adjustable="datalim")
    return labelled(ax, "Re L", "Im L")


def _pull_in(value: np.ndarray, radius: float = 4.0) -> np.ndarray:
    size = np.abs(value)
    far = size > radius
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(far, value / size * (radius + 1 - radius / np.maximum(size, radius)), value)
