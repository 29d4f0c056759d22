"""What the data leave open of coupled poles: the same coupling of the refitted cells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.linalg as sla

from cellsys.errors import ParameterError
from cellsys.model import LatentModel
from cellsys.spectra.certainty import PoleCertainty, spread_of

_MOST = 1e9  # sum of n^3 over all refitted blocks: about twenty seconds of eigenvalues


def block_certainty(
    model: LatentModel,
    eigenvalues: list[np.ndarray],
    refitted: Callable[[LatentModel], list[np.ndarray]],
) -> tuple[list[PoleCertainty] | None, str]:
    """One `PoleCertainty` for each block, and what is said of them.

    None for a cell whose model carries no refits, or where they would take too long.

    Parameters
    ----------
    model : LatentModel
        One cell.
    eigenvalues : list of complex array
        Of every block.
    refitted : callable
        The matrices of the same blocks for another model of the cell.
    """
    refits, part = model.refits, model.left_out
    if refits is None:
        return None, ""
    if len(refits) * sum(float(len(values)) ** 3 for values in eigenvalues) > _MOST:
        return None, "what the data leave open is not worked out at this size"
    others, lost = [], 0
    for A in refits:
        try:
            blocks = refitted(replace(model, A=A, refits=None))
        except ParameterError:  # no continuous form
            lost += 1
            continue
        others.append([sla.eigvals(M) if len(M) else np.zeros(0) for M in blocks])
    if not others:
        return None, f"no refit without a {part} has a continuous form"
    spreads = (spread_of(own, list(each)) for own, *each in zip(eigenvalues, *others, strict=True))
    note = f"+-: the larger of rounding and leaving a {part} out"
    if lost:
        note += f" ({lost} of {len(refits)} refits have no continuous form)"
    return [PoleCertainty(o, s, part) for o, s in zip(eigenvalues, spreads, strict=True)], note
