"""Ridge regression on standardised regressors, over a step of one's choice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.errors import ParameterError
from cellsys.model.latent import LatentModel
from cellsys.reduction.basis import (
    Basis,
    ExactSVD,
    RandomisedSVD,
    fit_basis,
    truncated,
)
from cellsys.reduction.regression import StepSamples, learned_model
from cellsys.samples.snapshots import Snapshots
from cellsys.units import real_number


@checked
@dataclass(frozen=True, kw_only=True)
class Ridge:
    """z+ = z + step (A z + B c + b) by ridge regression on z / sd(z) and c / sd(c).

        min over K, k_0 of   mean |(z+ - z)/step - K f - k_0|^2 + ridge |K|^2
        f = [z / sd(z); (c - mean(c)) / sd(c)]

    The penalty pulls towards "nothing changes" and weighs weak and strong directions alike; on
    raw z it would act on the weak ones only. A long step averages over what switches fast. The
    model is discrete; its continuous poles are log(eig(I + step A))/step.

    Parameters
    ----------
    ridge : float
        Penalty per sample, >= 0; 0 is least squares.
    step : float, optional
        s; a multiple of the sampling interval, which is the default. Commands enter by their
        mean over the step.
    svd : ExactSVD or RandomisedSVD, optional
        See `fit_basis`.
    """

    name: ClassVar[str] = "Ridge"
    ridge: float = 1e-3
    step: float | None = None
    svd: ExactSVD | RandomisedSVD | None = None

    def __post_init__(self) -> None:
        if not 0 <= real_number(self.ridge, "Ridge.ridge") <= 1e100:
            raise ParameterError(f"Ridge.ridge must be in [0, 1e100], got {self.ridge!r}")
        if self.step is not None and not (np.isfinite(self.step) and self.step > 0):
            raise ParameterError(f"Ridge.step must be > 0 s, got {self.step!r}")

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
        step = data.dt if self.step is None else float(self.step)
        s = StepSamples.of(data, basis, parts, step)
        K, b = self._solve(s)
        return learned_model(
            data,
            basis,
            K[:order].T,
            B=np.column_stack([K[order:].T, s.B]),
            offset=b,
            input_names=s.names,
            dt=step,
            notes={"method": repr(self)},
        )

    def refit(self, data: Snapshots, basis: Basis, kept: np.ndarray) -> np.ndarray:
        """A (m, m) from the samples `kept` (n_samples,) alone, in the same basis."""
        step = data.dt if self.step is None else float(self.step)
        samples = StepSamples.of(data, basis, basis.parts_of(data), step, kept)
        return self._solve(samples)[0][: basis.V.shape[1]].T

    def _solve(self, s: StepSamples) -> tuple[np.ndarray, np.ndarray]:
        rate = (s.ahead - s.now) / s.step - s.known
        return ridge_regress(np.column_stack([s.now, s.inputs]), rate, self.ridge)


def ridge_regress(Z: np.ndarray, Y: np.ndarray, ridge: float) -> tuple[np.ndarray, np.ndarray]:
    """K (regressors, columns), k_0 (columns,) of Y ~ Z K + k_0, the penalty on Z / sd(Z).

    By the augmented table [Z; sqrt(N ridge) I], never by normal equations; k_0 is not penalised.
    """
    mean, sd = Z.mean(axis=0), Z.std(axis=0)
    sd[sd == 0] = 1.0
    y_0 = Y.mean(axis=0)
    table, right = (Z - mean) / sd, Y - y_0
    if ridge > 0:
        k = Z.shape[1]
        table = np.concatenate([table, np.sqrt(len(Z) * ridge) * np.eye(k)])
        right = np.concatenate([right, np.zeros((k, Y.shape[1]))])
    K = sla.lstsq(table, right, check_finite=False)[0] / sd[:, None]
    return K, y_0 - mean @ K
