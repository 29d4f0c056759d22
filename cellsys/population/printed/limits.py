"""Poles of the mean block as the number of cells grows."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from cellsys.errors import ParameterError
from cellsys.population.printed.printed_cells import PrintedCells


def limit_poles(cells: PrintedCells) -> np.ndarray:
    """See `CoupledCells.limit_poles`."""
    A, m = cells.matrices[0], cells.order
    extra = cells.coupling.extra(m)
    R = np.eye(m) if extra is None else np.eye(m) + extra
    if not cells.coupling.inverted():
        return sla.eigvals(R @ cells.rank.P @ A)
    if extra is None:
        return sla.eigvals(A)
    W, weight = cells.rank.W, 1.0 - cells.rank.gap
    if weight.min() <= 1e3 * m * np.finfo(float).eps:
        raise ParameterError(
            f"P is singular (smallest eigenvalue {weight.min():.1e}): the mean block of "
            "MappedSuperposition then has poles that in general grow like K, no limit"
        )
    return sla.eigvals(((W.T @ R @ W) * weight / weight[:, None]) @ (W.T @ A @ W))
