"""What the data leave open of coupled poles: the same coupling of the refitted cells."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg as sla

from cellsys.errors import ParameterError
from cellsys.response.certainty import PoleCertainty, spread_of

if TYPE_CHECKING:
    from cellsys.population.cells import CoupledCells

_MOST = 1e9  # sum of n^3 over all refitted blocks: about twenty seconds of eigenvalues


def block_certainty(cells: CoupledCells) -> tuple[list[PoleCertainty] | None, str]:
    """One `PoleCertainty` for each matrix of `distinct(drop=False)`, and what is said of it.

    None for a cell whose model carries no refits, or where they would take too long.
    """
    refits, part = cells.model.refits, cells.model.left_out
    if refits is None:
        return None, ""
    blocks = cells.distinct(drop=False)
    if len(refits) * sum(float(len(M)) ** 3 for M, _, _, _ in blocks) > _MOST:
        return None, "what the data leave open is not worked out at this size"
    known, others, lost = cells.eigenvalues, [], 0
    for A in refits:
        try:
            model = replace(cells.model, A=A, refits=None)
            other = replace(cells, model=model).distinct(drop=False)
        except ParameterError:  # no continuous form
            lost += 1
            continue
        others.append([sla.eigvals(M) if len(M) else np.zeros(0) for M, _, _, _ in other])
    if not others:
        return None, f"no refit without a {part} has a continuous form"
    spreads = (spread_of(own, list(each)) for own, *each in zip(known, *others, strict=True))
    note = f"+-: the larger of rounding and leaving a {part} out"
    if lost:
        note += f" ({lost} of {len(refits)} refits have no continuous form)"
    return [PoleCertainty(o, s, part) for o, s in zip(known, spreads, strict=True)], note
