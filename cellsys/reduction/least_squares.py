"""Least-squares models in PCA coordinates: DMD with control."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.reduction.basis import Basis, ExactSVD, RandomisedSVD, fit_basis
from cellsys.reduction.model import LatentModel
from cellsys.reduction.pcr import LatentParts, regress, role_blocks, truncated
from cellsys.reduction.snapshots import Snapshots


@dataclass(frozen=True, kw_only=True)
class LeastSquares:
    """z' ~ A z + B c + b by least squares over one-step forward differences (DMDc).

    Unlike `PCR` it learns every row, the input map included, from data: the commands c are the
    regressors; without commands a known u is subtracted first.

    Parameters
    ----------
    svd : ExactSVD or RandomisedSVD, optional
    rank_tolerance : float
        Relative singular value below which a regressor direction is dropped, and reported.
    """

    name: ClassVar[str] = "LeastSquares"
    svd: ExactSVD | RandomisedSVD | None = None
    rank_tolerance: float = 1e-13

    def fit(
        self,
        data: Snapshots,
        order: int,
        basis: Basis | None = None,
        parts: LatentParts | None = None,
    ) -> LatentModel:
        """Learn a model of order `order`.

        `basis` (of at least that order) and `parts` (latent samples in it) are reused if given.
        """
        basis = truncated(basis, order) or fit_basis(data, order, method=self.svd)
        n, m = data.states.size, order
        parts = (LatentParts.of(data, basis) if parts is None else parts).first(m)
        rate = (parts.next - parts.now) / data.dt
        B, names = np.zeros((m, 0)), ()
        if data.command_names:
            F, names = data.varying_commands()
            K, b, rank = regress(np.column_stack([parts.now, F]), rate, True, self.rank_tolerance)
            A, B = K[:m].T, K[m:].T
        else:
            if data.has_u:
                weight = basis.inverse_scale()[:n, None] * basis.V[:n]
                rate = rate - data.stacked("u") @ weight
                if n <= 200:
                    B, names = weight.T.copy(), tuple(f"u.{s}" for s in data.states.names)
            K, b, rank = regress(parts.now, rate, True, self.rank_tolerance)
            A = K.T
        return LatentModel(
            A,
            B=B,
            offset=b,
            V=basis.V,
            mean=basis.mean,
            scale=basis.scale,
            singular_values=basis.singular_values,
            dt=data.dt,
            n_states=n,
            blocks=role_blocks(data),
            states=data.states,
            auxiliaries=data.auxiliaries,
            input_names=names,
            notes={
                "method": repr(self),
                "regression_rank": int(rank),
                "dropped_columns": basis.dropped,
                "variance_share": float(np.sum(basis.singular_values**2) / basis.total),
            },
        )
