"""Figure of a system norm."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from cellsys.figures.response import singular_values

if TYPE_CHECKING:
    from cellsys.response.norms import SystemNorm


def system_norm(result: SystemNorm, ax: Axes | None = None) -> Axes:
    """Singular values (dB) over frequency of a `SystemNorm`'s system; the peak is marked."""
    ax = singular_values(result.response, ax)
    if np.isfinite(result.frequency) and result.frequency > 0:
        ax.plot(result.frequency, 20 * np.log10(result.value), "o", color="C3", ms=5)
    ax.set_title(str(result), fontsize="medium")
    return ax
