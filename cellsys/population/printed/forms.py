"""The printed ways to couple cells, split into blocks of the interaction's eigenvalues omega.

With N = I + omega P and R = I + P_map (or given), per eigenvalue omega of the interaction
(K - 1 once and -1 K-1 times when every cell meets every other):

    Superposition        N A N^#                 [36]
    MappedSuperposition  (I + omega R P) A N^#   [93]
    Feedback             (I + omega R P) A       [57]
"""

from __future__ import annotations

from collections.abc import Sequence as Sequence  # what the inherited __init__ is annotated with
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.model.latent import with_basis
from cellsys.population.headings import loop_of
from cellsys.population.printed.blocks import PrintedForm
from cellsys.population.printed.cells import CoupledCells
from cellsys.population.printed.maps import ForceMap, field_rows
from cellsys.population.request import CouplingRequest
from cellsys.units import real_array


def _map(value: np.ndarray | ForceMap, name: str, m: int) -> np.ndarray:
    array = real_array(value.matrix if isinstance(value, ForceMap) else value, name)
    if array.shape != (m, m):
        raise DimensionError(f"{name} must be ({m}, {m}) like A, got {array.shape}")
    if not np.all(np.isfinite(array)):
        raise DataError(f"{name} holds NaN or inf")
    if np.abs(array).max(initial=0.0) > 1e100:
        raise DataError(f"{name} holds {np.abs(array).max():.3g}; it must stay below 1e100")
    return array


@dataclass(frozen=True, kw_only=True)
class JoiningForm(PrintedForm):
    """A printed form as a coupling."""

    def join(self, request: CouplingRequest) -> CoupledCells:
        """K cells coupled through their matrix rows of V.

        Raises
        ------
        RepresentationError
            When the model has no V or names no matrix rows.
        ParameterError, DimensionError
        """
        headings, K = request.headings, request.count()
        model, _ = with_basis(request.model, self.name)
        self.check_rows(field_rows(model, self.rows, self.name))
        self.extra(model.order)
        if headings is not None and (headings.shape != (K,) or not np.all(np.isfinite(headings))):
            raise DimensionError(f"headings must be {K} finite angles in rad")
        loop = loop_of(model, request.controller, request.own_sensor(), request.normalise, headings)
        return CoupledCells(
            model=model,
            n_cells=K,
            coupling=self,
            graph=request.graph,
            positions=request.positions,
            headings=headings,
            loop=loop,
        )


@checked
@dataclass(frozen=True, kw_only=True)
class Superposition(JoiningForm):
    """Superposed isolated fields: block N A N^# [thesis eq. 36].

    A similarity transform of isolated cells when I - P is nonsingular: K copies of the poles of
    A, for every K. It couples no dynamics: z_em(t) = N z(t) of isolated cells. With q purely
    matrix directions each difference block has q zero poles and those of a compression of A.
    """

    name: ClassVar[str] = "Superposition"


@checked
@dataclass(frozen=True, kw_only=True)
class MappedSuperposition(JoiningForm):
    """Superposed isolated fields, answered by adhesion: block (I + omega R P) A N^# [eq. 93].

    Parameters
    ----------
    P_map : (m, m) or ForceMap
        R = I + P_map; see `fit_P_map`. Zero gives `Superposition`. A `ForceMap` goes with the
        rows it was fitted on, in [93] the matrix's forces: ``rows="forces"``.
    """

    P_map: np.ndarray | ForceMap
    name: ClassVar[str] = "MappedSuperposition"

    def extra(self, m: int) -> np.ndarray | None:
        """P_map, or None when it is zero."""
        P_map = _map(self.P_map, "P_map", m)
        return P_map if np.any(P_map) else None

    def check_rows(self, rows: np.ndarray) -> None:
        """P and P_map are of the same rows.

        Raises
        ------
        ParameterError
        """
        if isinstance(self.P_map, ForceMap) and not np.array_equal(rows, self.P_map.rows):
            raise ParameterError(
                f"P_map was fitted on {len(self.P_map.rows)} rows of V and rows={self.rows!r} "
                f'couples on {len(rows)}; take the same, rows="forces" in [93]'
            )


@checked
@dataclass(frozen=True, kw_only=True)
class Feedback(JoiningForm):
    """Neighbours' matrix rates as inputs: z_k' = A z_k + sum of R P A z_l over l != k [eq. 57].

    Mean block (I + (K - 1) R P) A: its poles grow like K. Stable for every K when R = I and
    A + A^T < 0.

    Parameters
    ----------
    R : (m, m), optional
        Default I; [57] prints I + V^T W C (V^T W)^#, [91] I + P_map.
    """

    R: np.ndarray | ForceMap | None = None
    name: ClassVar[str] = "Feedback"

    def extra(self, m: int) -> np.ndarray | None:
        """R - I, or None when R = I."""
        if self.R is None:
            return None
        extra = _map(self.R, "R", m) - np.eye(m)
        return extra if np.any(extra) else None

    def inverted(self) -> bool:
        """No inverse stands in [57]."""
        return False
