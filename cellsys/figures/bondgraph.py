"""Drawing of a bond graph: half arrows for power, strokes for causality."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

if TYPE_CHECKING:
    from cellsys.bondgraph import BondGraph


def _layout(names: list[str], edges: list[tuple[int, int]], steps: int = 400) -> np.ndarray:
    """Positions (n, 2) by springs between neighbours and repulsion between all; deterministic."""
    n = len(names)
    angle = 2.4 * np.arange(n)  # golden angle: no two start in one place
    place = np.sqrt(np.arange(n) + 0.5)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    tails, heads = np.array(edges).T
    for k in range(steps):
        gap = place[:, None] - place[None]
        square = np.sum(gap**2, axis=-1) + 1e-3
        move = np.sum(gap / square[..., None] ** 1.5, axis=1) * 1.5
        pull = place[heads] - place[tails]
        length = np.linalg.norm(pull, axis=1, keepdims=True) + 1e-9
        force = 0.6 * (length - 1.0) * pull / length
        np.add.at(move, tails, force)
        np.add.at(move, heads, -force)
        size = np.linalg.norm(move, axis=1, keepdims=True) + 1e-12
        place += move / size * np.minimum(size, 0.5 * (1.0 - k / steps) + 0.01)
    return place - place.mean(axis=0)


def bond_graph(graph: BondGraph, ax: Axes | None = None) -> Axes:
    """Draw a `BondGraph`.

    Junctions are shown as 0 and 1, elements by kind and name. A half arrow at the head counts
    power positive; the stroke stands at the end of the bond that receives the effort.
    """
    if ax is None:
        ax = plt.subplots(layout="constrained", figsize=(8, 6))[1]
    elements = [e for e in graph.elements if type(e).__name__ != "Internal"]
    names = [e.name for e in elements]
    index = {n: i for i, n in enumerate(names)}
    edges = [(index[b.tail], index[b.head]) for b in graph.joined]
    place = _layout(names, edges)
    causality = graph.equations().causality
    for bond, (i, j) in zip(graph.joined, edges, strict=True):
        a, b = place[i], place[j]
        length = float(np.linalg.norm(b - a)) + 1e-9
        along = (b - a) / length
        side = np.array([-along[1], along[0]])
        start, end = a + 0.28 * along * min(1, length), b - 0.28 * along * min(1, length)
        ax.plot(*np.array([start, end]).T, color="0.2", lw=1)
        barb = end - 0.12 * along + 0.10 * side
        ax.plot(*np.array([end, barb]).T, color="0.2", lw=1)
        stroke = end if causality[bond.name] == "tail" else start
        ax.plot(*np.array([stroke - 0.1 * side, stroke + 0.1 * side]).T, color="C3", lw=2)
    for element, (x, y) in zip(elements, place, strict=True):
        kind = {"Zero": "0", "One": "1"}.get(type(element).__name__, type(element).__name__)
        junction = kind in ("0", "1")
        text = kind if junction else f"{kind}\n{element.name}"
        colour = "C0" if junction else "0.1"
        ax.text(x, y, text, ha="center", va="center", fontsize="small", color=colour)
        if junction:
            ax.annotate(
                element.name, (x, y), (0, -9), textcoords="offset points", ha="center",
                va="center", fontsize=6, color="0.5",
            )  # fmt: skip
    ax.set(aspect="equal", title=graph.name)
    ax.margins(0.1)
    ax.set_axis_off()
    return ax
