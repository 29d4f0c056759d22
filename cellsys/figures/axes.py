"""Axes to draw into: the caller's, or new ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

Pair = Sequence[Axes] | np.ndarray  # two axes


def axes_of(ax: Axes | None, layout: Literal["constrained"] | None = "constrained") -> Axes:
    """The axes given, or new ones."""
    return plt.subplots(layout=layout)[1] if ax is None else ax


def unit_circle(ax: Axes, style: str = "-") -> None:
    """The circle |z| = 1."""
    turn = np.linspace(0, 2 * np.pi, 200)
    ax.plot(np.cos(turn), np.sin(turn), style, color="0.6", lw=1)


def labelled(ax: Axes, x: str, y: str) -> Axes:
    """The axes with their labels and a grid."""
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    ax.grid(True, which="both", alpha=0.3)
    return ax
