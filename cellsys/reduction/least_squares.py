"""Least-squares models in PCA coordinates: DMD with control."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.arguments import checked
from cellsys.model.latent import LatentModel
from cellsys.reduction.basis import Basis, ExactSVD, RandomisedSVD, fit_basis, truncated
from cellsys.reduction.regression import (
    StepSamples,
    learned_model,
    regress,
)
from cellsys.samples.snapshots import Snapshots


@checked
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
        *,
        test: Snapshots | None = None,
        basis: Basis | None = None,
    ) -> LatentModel:
        """Learn a model of order `order`.

        `basis`, of at least that order, is used if given, and the samples that it carries.
        """
        basis = truncated(basis, order) or fit_basis(data, order, method=self.svd)
        parts = basis.parts_of(data)
        s = StepSamples.of(data, basis, parts, data.dt)
        K, b, rank = self._solve(s)
        return learned_model(
            data,
            basis,
            K[:order].T,
            B=np.column_stack([K[order:].T, s.B]),
            offset=b,
            input_names=s.names,
            dt=data.dt,
            notes={"method": repr(self), "regression_rank": rank},
        )

    def refit(self, data: Snapshots, basis: Basis, kept: np.ndarray) -> np.ndarray:
        """A (m, m) from the samples `kept` (n_samples,) alone, in the same basis."""
        samples = StepSamples.of(data, basis, basis.parts_of(data), data.dt, kept)
        return self._solve(samples)[0][: basis.V.shape[1]].T

    def _solve(self, s: StepSamples) -> tuple[np.ndarray, np.ndarray, int]:
        rate = (s.ahead - s.now) / s.step - s.known
        return regress(np.column_stack([s.now, s.inputs]), rate, True, self.rank_tolerance)
