"""Block diagram of an interconnected system of python-control, drawn from its own connections."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

from cellsys.figures.axes import axes_of

if TYPE_CHECKING:
    from control import InterconnectedSystem

_WIDE, _HIGH, _STEP, _LANE = 2.0, 1.0, 3.4, 0.45


def wires(system: InterconnectedSystem) -> dict[tuple[str, str], list[str]]:
    """Signals between the blocks by (from, to), as the connection map has them.

    Inputs and outputs of the whole come from and go to ``""``.
    """
    inputs = [(s.name, n) for s in system.syslist for n in s.input_labels]
    sources = [(s.name, n) for s in system.syslist for n in s.output_labels]
    found: dict[tuple[str, str], list[str]] = {}
    for row, column in np.argwhere(system.connect_map != 0):
        name, signal = sources[column]
        found.setdefault((name, inputs[row][0]), []).append(signal)
    for row, column in np.argwhere(system.input_map != 0):
        found.setdefault(("", inputs[row][0]), []).append(system.input_labels[column])
    for row, column in np.argwhere(system.output_map != 0):
        if column < len(sources):
            found.setdefault((sources[column][0], ""), []).append(system.output_labels[row])
    return found


def shortened(signals: Sequence[str], most: int = 3) -> str:
    """Names of many signals in few words: ``z[0..19]``, ``p_x, p_y, p_z``, ``cell1..50_cos``."""
    groups: dict[tuple[str, str], list[int]] = {}
    for name in dict.fromkeys(signals):
        number = re.search(r"(?<=\[)\d+(?=\])", name) or re.search(r"(?<=^cell)\d+(?=_)", name)
        key, value = ((name, ""), -1)
        if number:
            key, value = (name[: number.start()], name[number.end() :]), int(number[0])
        groups.setdefault(key, []).append(value)
    words = []
    for (before, after), numbers in groups.items():
        low, high = min(numbers), max(numbers)
        span = "" if low < 0 else (f"{low}" if low == high else f"{low}..{high}")
        words.append(f"{before}{span}{after}")
    if len(words) > most:
        words = [*words[: most - 1], "...", words[-1]]
    return ", ".join(words)


def _ports(
    wires: Sequence[tuple[str, str]], place: dict[str, float]
) -> dict[tuple[str, str], tuple[float, float]]:
    """Where each wire leaves and enters: those on one side of a block spread over its width."""
    ends: dict[tuple[str, bool], list[tuple[float, tuple[str, str], int]]] = {}
    for wire in wires:
        above = place[wire[1]] > place[wire[0]]
        for k in range(2):
            ends.setdefault((wire[k], above), []).append((place[wire[1 - k]], wire, k))
    x = {wire: [0.0, 0.0] for wire in wires}
    for (name, _), wanted in ends.items():
        for i, (_, wire, k) in enumerate(sorted(wanted)):
            x[wire][k] = place[name] + _WIDE * ((i + 1) / (len(wanted) + 1) - 0.5)
    return {wire: (x0, x1) for wire, (x0, x1) in x.items()}


def block_diagram(system: InterconnectedSystem, ax: Axes | None = None) -> Axes:
    """Blocks of a loop in a row, with the names of the signals between them.

    Parameters
    ----------
    system : control.InterconnectedSystem
        Such as ``loop.interconnect()``. Forward signals run above, feedback below.
    """
    ax = axes_of(ax)
    place = {s.name: _STEP * k for k, s in enumerate(system.syslist)}
    for part in system.syslist:
        x = place[part.name]
        moves = part.nstates > 0
        ax.add_patch(
            FancyBboxPatch(
                (x - _WIDE / 2, -_HIGH / 2),
                _WIDE,
                _HIGH,
                boxstyle="round,pad=0.1",
                facecolor="0.93" if moves else "white",
                edgecolor="0.2",
            )
        )
        states = f"\n{part.nstates} states" if moves else ""
        ax.text(x, 0, part.name.replace("_", "\n") + states, ha="center", va="center", fontsize=7)
    found = wires(system)
    inner = sorted(
        (key for key in found if all(key)), key=lambda key: abs(place[key[1]] - place[key[0]])
    )
    ports = _ports(inner, place)
    lanes = {1.0: 0, -1.0: 0}  # above and below
    for key in inner:
        (x0, x1), side = ports[key], 1.0 if place[key[1]] > place[key[0]] else -1.0
        lanes[side] += 1
        edge, y = side * (_HIGH / 2 + 0.1), side * (_HIGH / 2 + 0.1 + _LANE * lanes[side])
        color = "C0" if side > 0 else "C3"
        ax.plot([x0, x0, x1], [edge, y, y], color=color, lw=1.2)
        ax.annotate(
            "",
            (x1, edge),
            (x1, y),
            arrowprops={"arrowstyle": "-|>", "color": color, "shrinkA": 0, "shrinkB": 0},
        )
        ax.text((x0 + x1) / 2, y, shortened(found[key]), ha="center", va="bottom", fontsize=6)
    for (start, end), signals in found.items():
        if not (start and end):
            side, what = (-1.0, "out") if start else (1.0, "in")
            ax.text(
                place[start or end],
                side * (_HIGH / 2 - 0.02),
                f"{what}: {shortened(signals)}",
                ha="center",
                va="bottom" if start else "top",
                fontsize=5,
                color="C2",
            )
    top, bottom = (_HIGH / 2 + _LANE * (n + 1) for n in lanes.values())
    last = max(place.values(), default=0.0)
    ax.set(xlim=(-_WIDE, last + _WIDE), ylim=(-bottom, top))
    ax.set_axis_off()
    ax.set_title(system.name, fontsize="medium")
    return ax
