"""The blocks of coupled cells, equal ones joined."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cellsys.population.printed.blocks import ModeBlock, kept_directions
from cellsys.population.printed.printed_cells import PrintedCells


def distinct_blocks(
    cells: PrintedCells,
    blocks: Callable[[], list[ModeBlock]],
    multiplicity: np.ndarray,
    *,
    drop: bool,
) -> list[tuple[np.ndarray, int, int, float]]:
    """(matrix without its dropped directions, multiplicity, dropped, omega) of each.

    Parameters
    ----------
    cells : CoupledCells
    blocks : callable
        Every block; asked where they have to be worked out one by one.
    multiplicity : (n,)
        Of each eigenvalue of the interaction.
    drop : bool
        Doubtful directions are dropped too.
    """
    form, split, modes = cells.coupling, cells.rank, cells.modes
    if modes is None or form.extra(cells.order) is not None or not form.inverted():
        return [
            (b.M[np.ix_(b.kept, b.kept)], int(k), b.dropped, b.omega)
            for b, k in zip(blocks(), multiplicity, strict=True)
        ]
    groups: dict[bytes, tuple[np.ndarray, list[int], list[float]]] = {}
    masks = kept_directions(split, modes.omega, drop=drop)
    for mask, n, w in zip(masks, modes.multiplicity, modes.omega, strict=True):
        _, counts, omegas = groups.setdefault(mask.tobytes(), (mask, [], []))
        counts.append(int(n))
        omegas.append(float(w))
    A = cells.matrices[0]
    A_w = None
    out = []
    for mask, counts, omegas in groups.values():
        if mask.all():
            M = A
        else:
            A_w = split.W.T @ A @ split.W if A_w is None else A_w
            M = A_w[np.ix_(mask, mask)]
        out.append((M, sum(counts), int((~mask).sum()), omegas[0] if len(omegas) == 1 else np.nan))
    return out
