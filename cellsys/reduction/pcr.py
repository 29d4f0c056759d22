"""Principal component regression, thesis eq. 24 and 82."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.linalg as sla

from cellsys.errors import DataError, ParameterError
from cellsys.reduction.basis import Basis, ExactSVD, RandomisedSVD, check_order, fit_basis
from cellsys.reduction.model import LatentModel
from cellsys.reduction.snapshots import Snapshots


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
        Everything as printed: no centring, no intercept, backward difference.
    svd : ExactSVD or RandomisedSVD, optional
        See `fit_basis`.
    rank_tolerance : float
        Relative singular value below which a regressor direction is dropped, and reported.
    """

    name: ClassVar[str] = "PCR"
    difference: str = "forward"
    literal: bool = False
    svd: ExactSVD | RandomisedSVD | None = None
    rank_tolerance: float = 1e-13

    def __post_init__(self) -> None:
        if self.difference not in ("forward", "backward"):
            raise ParameterError(
                f"PCR.difference must be 'forward' or 'backward', got {self.difference!r}"
            )

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
        basis = truncated(basis, order) or fit_basis(
            data, order, center=not self.literal, method=self.svd
        )
        parts = LatentParts.of(data, basis) if parts is None else parts
        A, b, rank = self.generator(data, basis, parts)
        n = data.states.size
        weight = basis.inverse_scale()[:n, None] * basis.V[:n]
        B, b_u, names, explained = input_map(data, weight, self.rank_tolerance)
        return LatentModel(
            A,
            B=B,
            offset=b + b_u,
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
                "regression_rank": rank,
                "dropped_columns": basis.dropped,
                "input_share_explained": explained,
                "variance_share": float(np.sum(basis.singular_values**2) / basis.total),
            },
        )

    def generator(
        self, data: Snapshots, basis: Basis, parts: LatentParts
    ) -> tuple[np.ndarray, np.ndarray, int]:
        """A (m, m), b (m,) of eq. 24 and the rank of the regression, inputs apart."""
        if not data.auxiliaries.size:
            raise DataError(
                "PCR needs auxiliaries (eta) and W_eta; for states alone use LeastSquares()"
            )
        n, S, V = data.states.size, basis.scale, basis.V
        parts = parts.first(V.shape[1])
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


@dataclass(frozen=True, eq=False)
class LatentParts:
    """Latent samples split into the parts of x and of eta, now and one sample ahead.

    Each is (n_samples, m); `runs` and `samples` number the rows.
    """

    x_now: np.ndarray
    x_next: np.ndarray
    eta_now: np.ndarray
    eta_next: np.ndarray
    runs: np.ndarray
    samples: np.ndarray

    @classmethod
    def of(cls, data: Snapshots, basis: Basis) -> LatentParts:
        """Project all used samples and their successors, in one pass over the data."""
        n = data.states.size
        weight = basis.inverse_scale()[:, None] * basis.V
        parts: list[list] = [[], [], [], []]
        for run in data.runs:
            x, eta = [], []
            for piece in data.blocks(run, np.arange(run.n_pairs + 1), basis.mean):
                x.append(piece[:, :n] @ weight[:n])
                eta.append(piece[:, n:] @ weight[n:])
            ks = run.usable()
            for out, whole in ((parts[:2], x), (parts[2:], eta)):
                rows = np.concatenate(whole)
                out[0].append(rows[ks])
                out[1].append(rows[ks + 1])
        return cls(
            *(np.concatenate(p) for p in parts),
            data.run_ids,
            np.concatenate([r.usable() for r in data.runs]),
        )

    def first(self, order: int) -> LatentParts:
        """The first `order` coordinates."""
        cut = (a[:, :order] for a in (self.x_now, self.x_next, self.eta_now, self.eta_next))
        return LatentParts(*cut, self.runs, self.samples)

    def where(self, rows: np.ndarray) -> LatentParts:
        """A selection of samples."""
        names = ("x_now", "x_next", "eta_now", "eta_next", "runs", "samples")
        return LatentParts(*(getattr(self, name)[rows] for name in names))

    @property
    def now(self) -> np.ndarray:
        """z at the samples."""
        return self.x_now + self.eta_now

    @property
    def next(self) -> np.ndarray:
        """z one sample later."""
        return self.x_next + self.eta_next

    def after_previous(self) -> np.ndarray:
        """Rows whose previous sample belongs to the same run and is used too."""
        same = (self.runs[1:] == self.runs[:-1]) & (np.diff(self.samples) == 1)
        return np.flatnonzero(same) + 1


def truncated(basis: Basis | None, order: int) -> Basis | None:
    """The first `order` directions of a basis that has at least as many."""
    check_order(order)
    if basis is None or basis.V.shape[1] < order:
        return None
    return Basis(
        basis.V[:, :order],
        basis.singular_values[:order],
        basis.mean,
        basis.scale,
        basis.total,
        basis.dropped,
    )


def regress(
    Z: np.ndarray, Y: np.ndarray, intercept: bool, tolerance: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """Least squares Y ~ Z K + 1 k_0: K (regressors, columns), k_0 (columns,), rank.

    Regressors are scaled to unit norm first, so that `tolerance` is relative to each; directions
    below it are dropped (minimum norm).
    """
    columns = np.column_stack([Z, np.ones(len(Z))]) if intercept else Z
    norm = np.linalg.norm(columns, axis=0)
    norm[norm == 0] = 1.0
    solution, _, rank, _ = sla.lstsq(columns / norm, Y, cond=tolerance)
    solution = solution / norm[:, None]
    if not intercept:
        return solution, np.zeros(Y.shape[1]), int(rank)
    return solution[:-1], solution[-1], int(rank)


def input_map(
    data: Snapshots, weight: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...], float | None]:
    """How the commands enter: logged u regressed on them, projected.

    Returns B (m, n_c), the constant part (m,), names, and the share of u's variance about its
    mean that the commands explain (None without commands). Without commands a small system's u
    enters as it is, one input per state.
    """
    m = weight.shape[1]
    if not data.has_u:
        return np.zeros((m, 0)), np.zeros(m), (), None
    if data.command_names:
        moving, u = data.moving_input
        F, names = data.varying_commands()
        U, u_0, _ = regress(F, u, True, tolerance)
        left = u - F @ U - u_0
        spread = u - u.mean(axis=0)
        total = float(np.sum(spread**2))
        share = 1.0 - float(np.sum(left**2)) / total if total > 0 else None
        return (U @ weight[moving]).T, u_0 @ weight[moving], names, share
    if data.states.size > 200:
        raise DataError(
            "u has more than 200 columns and no commands were given; pass the low-dimensional "
            "commands behind u with each run"
        )
    return weight.T.copy(), np.zeros(m), tuple(f"u.{n}" for n in data.states.names), None


def role_blocks(data: Snapshots) -> dict[str, np.ndarray]:
    """Rows of V of the component (cells) and of the field (matrix), states and auxiliaries.

    The rows of ``step_residual`` belong to the states whose rate it is.
    """
    layout, out = data.layout, {}
    for role in ("component", "field"):
        rows = [
            np.arange(layout.slice(b.name).start, layout.slice(b.name).stop)
            for b in layout
            if b.role == role and b.name != "step_residual"
        ]
        if "step_residual" in data.auxiliaries:
            start = layout.slice("step_residual").start
            rows.append(start + data.states.where(role=role))
        found = np.concatenate(rows) if rows else np.zeros(0, int)
        if len(found):
            out[role] = np.sort(found)
    return out
