"""Principal component regression, thesis eq. 24 and 82."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DataError, ParameterError
from cellsys.model.latent import LatentModel
from cellsys.reduction.basis import (
    Basis,
    ExactSVD,
    LatentParts,
    RandomisedSVD,
    fit_basis,
    truncated,
)
from cellsys.reduction.regression import (
    input_map,
    learned_model,
    regress,
)
from cellsys.samples.snapshots import Snapshots


@checked
@dataclass(frozen=True, kw_only=True)
class PCR:
    """The thesis's A*: structure for the states, regression for the auxiliaries.

        eta' ~ K z + k_0
        A = V_x^T S_x^-1 (W_x S_x V_x + W_eta S_eta V_eta) + V_eta^T S_eta^-1 K        [eq. 24]
        b = V_x^T S_x^-1 (W_x mean(x) + W_eta mean(eta)) + V_eta^T S_eta^-1 k_0

    With exact one-step data and forward differences this equals least-squares DMD in PCA
    coordinates with the input known.

    Parameters
    ----------
    difference : {"forward", "backward"}
        How eta' is taken inside a run. Backward [eq. 19] turns the sign of the damping of every
        fast component that switching or noise keeps alive; it is here to be compared.
    literal : bool
        Equation 24 exactly as printed: snapshots as they come (S = I, no mean subtracted, eq. 8),
        eta' by backward differences (eq. 19), no intercept. It always learns in its own basis,
        whatever basis or `scale` the data come with. Kept to be compared, not to be used.
    svd : ExactSVD or RandomisedSVD, optional
        See `fit_basis`.
    rank_tolerance : float
        Relative singular value below which a regressor direction is dropped, and reported.
    """

    difference: str = "forward"
    literal: bool = False
    svd: ExactSVD | RandomisedSVD | None = None
    rank_tolerance: float = 1e-13

    def __post_init__(self) -> None:
        if self.difference not in ("forward", "backward"):
            raise ParameterError(
                f"PCR.difference must be 'forward' or 'backward', got {self.difference!r}"
            )

    @property
    def name(self) -> str:
        """Name in tables and cards."""
        return "PCR (literal)" if self.literal else "PCR"

    @property
    def own_basis(self) -> bool:
        """Whether it learns in a basis of its own: the literal form does."""
        return self.literal

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
        if self.literal:
            # Another basis would not be the printed one.
            data = dataclasses.replace(data, scale="none")
            basis = fit_basis(data, order, center=False, method=self.svd)
        basis = truncated(basis, order) or fit_basis(data, order, method=self.svd)
        A, b, rank = self.generator(data, basis, basis.parts_of(data))
        n = data.states.size
        weight = basis.inverse_scale()[:n, None] * basis.V[:n]
        B, b_u, names, explained = input_map(data, weight, self.rank_tolerance)
        return learned_model(
            data,
            basis,
            A,
            B=B,
            offset=b + b_u,
            input_names=names,
            dt=data.dt,
            notes={
                "method": repr(self),
                "regression_rank": rank,
                "input_share_explained": explained,
            },
        )

    def refit(self, data: Snapshots, basis: Basis, kept: np.ndarray) -> np.ndarray:
        """A (m, m) from the samples `kept` (n_samples,) alone, in the same basis."""
        return self.generator(data, basis, basis.parts_of(data).where(kept))[0]

    def generator(
        self, data: Snapshots, basis: Basis, parts: LatentParts
    ) -> tuple[np.ndarray, np.ndarray, int]:
        """A (m, m), b (m,) of eq. 24 and the rank of the regression, inputs apart."""
        if not data.auxiliaries.size:
            raise DataError(
                "PCR needs auxiliaries (eta) and W_eta; for states alone use LeastSquares()"
            )
        n, S, V = data.states.size, basis.scale, basis.V
        rate = (parts.eta_next - parts.eta_now) / data.dt
        rows = np.arange(len(rate))
        if self.literal or self.difference == "backward":
            rows = parts.after_previous()
            rate = rate[rows - 1]
        K, k_0, rank = regress(parts.now[rows], rate, not self.literal, self.rank_tolerance)
        weight = basis.inverse_scale()[:n, None] * V[:n]
        image = data.W_x @ (S[:n, None] * V[:n]) + data.W_eta @ (S[n:, None] * V[n:])
        A, b = weight.T @ image + K.T, k_0
        if not self.literal:
            b = b + weight.T @ (data.W_x @ basis.mean[:n] + data.W_eta @ basis.mean[n:])
        return A, b, rank
