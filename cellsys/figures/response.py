"""Figures of the response room: Bode, Nyquist, pole map, singular values, pseudospectra, ..."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from cellsys.figures.axes import axes_of, labelled, unit_circle
from cellsys.response.frequency import FrequencyResponse
from cellsys.response.root_locus import RootLocus
from cellsys.response.sensitivity_functions import ErrorSystem, Sensitivity
from cellsys.response.timeresponse import TimeResponse
from cellsys.response.truncation import BalancedTruncation
from cellsys.spectra.damping import DampingTable
from cellsys.spectra.gramians import Gramian
from cellsys.spectra.participation import Participation
from cellsys.spectra.pseudospectra import Pseudospectra
from cellsys.spectra.roots import RootSet
from cellsys.spectra.stability import StabilityReport


def pole_zero_map(result: RootSet | DampingTable, ax: Axes | None = None) -> Axes:
    """Poles as crosses or zeros as circles, with the sizes of tight clusters.

    Parameters
    ----------
    result : RootSet or DampingTable
    ax : matplotlib Axes, optional
        Draw poles and zeros into the same axes by two calls.

    Returns
    -------
    Axes
    """
    ax = axes_of(ax, None)
    roots = result.poles if isinstance(result, DampingTable) else result
    zero = roots.kind == "zero"
    z = np.asarray(roots)
    size = roots.cluster_size
    if zero:
        ax.plot(z.real, z.imag, "o", mfc="none", mec="C0", ms=7, label="zeros")
    else:
        ax.plot(z.real, z.imag, "x", color="C3", ms=7, mew=1.5, label="poles")
    for label in np.unique(roots.cluster[size > 1]):
        members = z[roots.cluster == label]
        if np.ptp(np.abs(members - members[0])) < 0.02 * np.abs(z).max():
            at = (members.mean().real, members.mean().imag)
            ax.annotate(f"{len(members)}", at, (5, 4), textcoords="offset points", fontsize="small")
    if roots.dt > 0:
        unit_circle(ax)
        ax.set_aspect("equal", adjustable="datalim")
    else:
        ax.axvline(0, color="0.6", lw=1)
    ax.axhline(0, color="0.8", lw=0.8, zorder=0)
    if roots.dt > 0:
        return labelled(ax, "Re z", "Im z")
    return labelled(ax, "real part (1/s)", "imaginary part (rad/s)")


def singular_values(response: FrequencyResponse, ax: Axes | None = None) -> Axes:
    """Singular values (dB) of a `FrequencyResponse` over frequency.

    Parameters
    ----------
    response : FrequencyResponse
    ax : matplotlib Axes, optional

    Returns
    -------
    Axes
    """
    ax = axes_of(ax, None)
    for value in response.singular_values:
        shown = value > 0
        ax.semilogx(response.omega[shown], 20 * np.log10(value[shown]))
    return labelled(ax, "frequency (rad/s)", "singular values (dB)")


def pseudospectra(result: Pseudospectra, ax: Axes | None = None) -> Axes:
    """Level lines of log10 sigma_min(z I - A) with the poles on top.

    Parameters
    ----------
    result : Pseudospectra
    ax : matplotlib Axes, optional

    Returns
    -------
    Axes
    """
    ax = axes_of(ax, None)
    level = np.log10(np.maximum(result.sigma, 1e-300))
    low = np.floor(max(level.min(), level.max() - 17))  # below that is rounding
    high = np.ceil(level.max())
    lines = np.linspace(low, high, 13) if high - low < 4 else np.arange(low, high + 1)
    drawn = ax.contour(result.x, result.y, level, levels=lines, cmap="viridis", linewidths=1)
    ax.figure.colorbar(drawn, ax=ax, label="log10 of the perturbation size")
    z = np.asarray(result.poles)
    ax.plot(z.real, z.imag, "x", color="C3", ms=6, mew=1.5)
    if result.dt > 0:
        unit_circle(ax)
    else:
        ax.axvline(0, color="0.4", lw=1)
    ax.set_xlim(result.x[0], result.x[-1])
    ax.set_ylim(result.y[0], result.y[-1])
    ax.set_xlabel("Re z")
    ax.set_ylabel("Im z")
    return ax


def stability(report: StabilityReport, ax: Axes | None = None) -> Axes:
    """Pseudospectra of a `StabilityReport` over its poles, the verdict above.

    Parameters
    ----------
    report : StabilityReport
    ax : matplotlib Axes, optional

    Returns
    -------
    Axes
    """
    ax = pseudospectra(report.pseudospectra, ax=ax) if len(report.A) else axes_of(ax, None)
    text = f"{report.verdict}; distance to instability {report.distance:.3g}"
    ax.set_title(text, fontsize="medium")
    return ax


def root_locus(result: RootLocus, ax: Axes | None = None) -> Axes:
    """Branches of a `RootLocus`: crosses at the first value, circles at the open-loop zeros.

    Parameters
    ----------
    result : RootLocus
    ax : matplotlib Axes, optional

    Returns
    -------
    Axes
    """
    ax = axes_of(ax, None)
    start, ends = result.poles[0], result.zeros
    for branch in result.poles.T:
        ax.plot(branch.real, branch.imag, lw=1.2)
    ax.plot(start.real, start.imag, "x", color="C3", ms=7, mew=1.5)
    ax.plot(ends.real, ends.imag, "o", mfc="none", mec="C0", ms=7)
    if result.dt > 0:
        unit_circle(ax)
        ax.set_aspect("equal", adjustable="datalim")
    else:
        ax.axvline(0, color="0.6", lw=1)
    # Branches that run off may not decide the frame.
    near = np.concatenate([start, ends])
    reach = 3 * max(float(np.abs(near).max(initial=0.0)), 1e-12)
    ax.set_xlim(max(ax.get_xlim()[0], -reach), min(ax.get_xlim()[1], reach))
    ax.set_ylim(max(ax.get_ylim()[0], -reach), min(ax.get_ylim()[1], reach))
    if len(result.crossings):
        at = ", ".join(f"{c:.4g}" for c in result.crossings[:4])
        ax.set_title(f"crosses at {at}", fontsize="medium")
    return labelled(ax, "Re", "Im")


def time_response(result: TimeResponse, ax: Axes | None = None) -> Axes:
    """Outputs of a `TimeResponse` over time; stairs in discrete time.

    Parameters
    ----------
    result : TimeResponse
    ax : matplotlib Axes, optional

    Returns
    -------
    Axes
    """
    ax = axes_of(ax, None)
    y = result.y if result.y.ndim == 3 else result.y[:, :, None]
    style = "steps-post" if result.dt > 0 else "default"
    for i, name in enumerate(result.outputs):
        for j in range(y.shape[2]):
            label = name if y.shape[2] == 1 else f"{result.inputs[j]} to {name}"
            ax.plot(result.t, y[:, i, j], label=label, drawstyle=style)
    if y.shape[1] * y.shape[2] > 1:
        ax.legend(fontsize="small")
    return labelled(ax, "time (s)", f"{result.kind} response")


def sensitivity(result: Sensitivity, ax: Axes | None = None) -> Axes:
    """Largest singular values of S and T (dB) over frequency, peaks marked.

    Parameters
    ----------
    result : Sensitivity
    ax : matplotlib Axes, optional

    Returns
    -------
    Axes
    """
    ax = axes_of(ax, None)
    for name in "ST":
        response, peak = getattr(result, f"response_{name}"), getattr(result, f"peak_{name}")
        value = response.singular_values[0]
        shown = value > 0
        label = f"{name}, peak {peak.value:.3g}"
        (line,) = ax.semilogx(response.omega[shown], 20 * np.log10(value[shown]), label=label)
        inside = response.omega[0] <= peak.frequency <= response.omega[-1]
        if np.isfinite(peak.value) and inside:
            ax.plot(peak.frequency, 20 * np.log10(peak.value), "o", color=line.get_color(), ms=5)
    ax.axhline(0, color="0.6", lw=0.8)
    ax.legend(fontsize="small")
    return labelled(ax, "frequency (rad/s)", "largest singular value (dB)")


def error_system(result: ErrorSystem, ax: Axes | None = None) -> Axes:
    """Singular values (dB) of an `ErrorSystem` over frequency.

    Parameters
    ----------
    result : ErrorSystem
    ax : matplotlib Axes, optional

    Returns
    -------
    Axes
    """
    ax = singular_values(result.response, ax=ax)
    ax.set_ylabel("error (dB)")
    size = f"largest {result.hinf.value:.3g}, relative {result.relative_hinf:.2g}"
    ax.set_title(size, fontsize="medium")
    return ax


def hankel(result: BalancedTruncation | Gramian, ax: Axes | None = None) -> Axes:
    """Hankel singular values of a `BalancedTruncation`, or the eigenvalues of a `Gramian`.

    Parameters
    ----------
    result : BalancedTruncation or Gramian
    ax : matplotlib Axes, optional

    Returns
    -------
    Axes
    """
    ax = axes_of(ax, None)
    if isinstance(result, Gramian):
        value, kept = np.linalg.svd(result.factor, compute_uv=False) ** 2, np.inf
        label = f"eigenvalue of the {result.kind} Gramian"
    else:
        value, kept, label = result.hankel, result.order, "Hankel singular value"
        ax.set_title(f"filled: kept; error at most {result.error_bound:.3g}", fontsize="medium")
    number = np.arange(1, len(value) + 1)
    for shown, fill in ((number <= kept, "C0"), (number > kept, "none")):
        shown = shown & (value > 0)
        ax.semilogy(number[shown], value[shown], "o", mfc=fill, mec="C0", ms=5)
    return labelled(ax, "number", label)


def participation(result: Participation, ax: Axes | None = None) -> Axes:
    """Shares of the states in the modes as an image; at most 40 modes and 40 states.

    Parameters
    ----------
    result : Participation
    ax : matplotlib Axes, optional

    Returns
    -------
    Axes
    """
    ax = axes_of(ax, None)
    modes = min(len(result.poles), 40)
    share = result.states[:, :modes]
    rows = np.sort(np.argsort(-share.max(axis=1, initial=0.0))[:40])
    image = ax.imshow(share[rows], aspect="auto", cmap="Blues", vmin=0)
    ax.figure.colorbar(image, ax=ax, label="participation")
    ax.set_yticks(range(len(rows)), [result.state_names[i] for i in rows], fontsize="x-small")
    ax.set_xticks(
        range(modes),
        [f"{complex(z):.3g}" for z in result.poles[:modes]],
        rotation=90,
        fontsize="x-small",
    )
    ax.set_xlabel("mode (pole)")
    return ax
