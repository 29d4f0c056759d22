"""How certain the poles of a model are: refit with each training run left out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.optimize import linear_sum_assignment

from cellsys.drawable import Drawable
from cellsys.reduction.basis import Basis, fit_basis
from cellsys.reduction.model import LatentModel
from cellsys.reduction.pcr import PCR
from cellsys.reduction.regression import LatentParts, truncated
from cellsys.reduction.snapshots import Snapshots


@dataclass(frozen=True, eq=False)
class PoleCertainty(Drawable):
    """Poles (m,) of a model, 1/s, and their spread (m,): the largest distance to the matched pole
    when one training run is left out (0 for a single run: nothing is known).
    """

    poles: np.ndarray
    spread: np.ndarray

    _figure: ClassVar[str] = "pole_certainty"


def pole_certainty(
    data: Snapshots,
    method: PCR,
    order: int,
    basis: Basis | None = None,
    parts: LatentParts | None = None,
) -> PoleCertainty:
    """Poles of `PCR` and how far each moves, in one basis, when a run is left out.

    Poles are matched by the assignment with the least total distance, not by sorting.
    """
    basis = truncated(basis, order) or fit_basis(data, order)
    parts = LatentParts.of(data, basis) if parts is None else parts

    def fitted(rows: np.ndarray) -> np.ndarray:
        A, _, _ = method.generator(data, basis, parts.where(rows))
        return LatentModel(A, dt=data.dt).poles()

    poles = fitted(np.ones(data.n_samples, bool))
    spread = np.zeros(len(poles))
    for i in range(len(data.runs)) if len(data.runs) > 1 else ():
        other = fitted(parts.runs != i)
        distance = np.abs(poles[:, None] - other[None, :])
        rows, cols = linear_sum_assignment(np.where(np.isfinite(distance), distance, 1e6))
        spread[rows] = np.maximum(spread[rows], distance[rows, cols])
    # A pair that turns into two real poles is matched either way round: both get the larger.
    partner = np.argmin(np.abs(poles[:, None] - poles.conj()[None, :]), axis=1)
    spread = np.maximum(spread, spread[partner])
    return PoleCertainty(poles, spread)
