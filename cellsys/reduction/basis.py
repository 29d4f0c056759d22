"""Basis: leading right singular vectors of the scaled, centred snapshots.

    V, s = leading right singular vectors of (X - mean) S^-1 ,   z = V^T S^-1 (x~ - mean)

The covariance of all columns is never formed. Snapshots are streamed by blocks of rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral

import numpy as np
import scipy.linalg as sla

from cellsys.errors import ParameterError, RankError
from cellsys.reduction.snapshots import Snapshots

_EXACT_SIZE = 4e6  # entries up to which the exact SVD is the default


@dataclass(frozen=True, kw_only=True)
class ExactSVD:
    """LAPACK's SVD of all snapshots in memory."""


@dataclass(frozen=True, kw_only=True)
class RandomisedSVD:
    """Randomised range finder with power iterations, streamed (Halko, Martinsson, Tropp 2011).

    Parameters
    ----------
    oversample : int
        Directions beyond the order asked for.
    power : int
        Power iterations; each reads the data twice.
    seed : int
        Of the start matrix; the same seed gives the same basis.
    """

    oversample: int = 20
    power: int = 2
    seed: int = 0

    def __post_init__(self) -> None:
        if self.oversample < 1 or self.power < 0:
            raise ParameterError("RandomisedSVD needs oversample >= 1 and power >= 0")


@dataclass(frozen=True, eq=False)
class Basis:
    """V (columns, m) orthonormal, singular values, mean (columns,) and scale (columns,).

    `scale` is 0 on columns that do not vary; their rows of V are zero and their value is the
    mean. `total` is the sum of all squared singular values.
    """

    V: np.ndarray
    singular_values: np.ndarray
    mean: np.ndarray
    scale: np.ndarray
    total: float
    dropped: int

    def inverse_scale(self) -> np.ndarray:
        """1/scale, and 0 where the column was dropped."""
        return np.divide(1.0, self.scale, out=np.zeros_like(self.scale), where=self.scale > 0)


def moments(data: Snapshots) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance of every column over the used samples.

    One pass, shifted by the first sample so that a large constant part costs no digits.
    """
    first = next(data.pieces())[0].copy()
    total, square = np.zeros(data.n_columns), np.zeros(data.n_columns)
    for piece in data.pieces(shift=first):
        total += piece.sum(axis=0)
        square += np.einsum("ij,ij->j", piece, piece)
    total /= data.n_samples
    variance = np.maximum(square / data.n_samples - total**2, 0.0)
    return first + total, variance


def scale_factors(data: Snapshots, mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Scale factor of every column; 0 where it does not vary beyond rounding.

    Beyond rounding: 1e-14 of its mean, and of the largest spread of the columns that share its
    unit (its block; all columns when scale is "none").
    """
    spread = np.sqrt(variance)
    if data.scale == "column":
        largest, factor = np.zeros(data.n_columns), spread
    elif data.scale == "none":
        largest, factor = np.full(data.n_columns, spread.max()), np.ones(data.n_columns)
    else:
        largest, factor = np.zeros(data.n_columns), np.ones(data.n_columns)
        for group in data.groups():
            largest[group] = spread[group].max(initial=0.0)
            factor[group] = np.sqrt(variance[group].sum()) or 1.0
    floor = np.maximum(1e-14 * np.maximum(np.abs(mean), largest), 1e-140)
    return np.where(spread > floor, factor, 0.0)


def check_order(order: int) -> None:
    """Refuse anything but a whole number >= 1."""
    if isinstance(order, bool) or not isinstance(order, Integral) or order < 1:
        raise ParameterError(f"order must be a whole number >= 1, got {order!r}")


def fit_basis(
    data: Snapshots,
    order: int,
    *,
    center: bool = True,
    method: ExactSVD | RandomisedSVD | None = None,
) -> Basis:
    """The leading `order` directions of the snapshots.

    Parameters
    ----------
    data : Snapshots
    order : int
        m; refused beyond the numerical rank.
    center : bool
        Subtract the mean (default); thesis eq. 8 does not.
    method : ExactSVD or RandomisedSVD, optional
        Default: exact up to 4e6 entries, randomised beyond.

    Raises
    ------
    RankError
        When the data span fewer than `order` directions; the message has the rank.
    """
    check_order(order)
    most = min(data.n_samples - (1 if center else 0), data.n_columns)
    if order > most:
        raise RankError(
            f"order {order} is beyond the data: {data.n_samples} samples of {data.n_columns} "
            f"columns span at most {most} directions; lower the order or add runs"
        )
    mean, variance = moments(data)
    if not center:
        # About zero a constant column varies too: left out, it would come back as 0.
        mean, variance = np.zeros_like(mean), variance + mean**2
    scale = scale_factors(data, mean, variance)
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)

    if method is None:
        small = data.n_samples * data.n_columns <= _EXACT_SIZE
        method = ExactSVD() if small else RandomisedSVD()
    if isinstance(method, ExactSVD):
        X = np.concatenate([piece * inverse for piece in data.pieces(shift=mean)])
        total = float(np.sum(X * X))
        _, s, Vt = sla.svd(X, full_matrices=False, check_finite=False)
        V = Vt.T
    else:
        V, s, total = _randomised(data, mean, inverse, order, method)
    rank = int(np.sum(s > max(data.n_samples, data.n_columns) * np.finfo(float).eps * s[0]))
    if order > rank:
        raise RankError(
            f"order {order} is beyond the data's numerical rank {rank}; lower the order"
        )
    V = np.ascontiguousarray(V[:, :order])
    return Basis(V, s[:order], mean, scale, total, int(np.sum(scale == 0)))


def _randomised(
    data: Snapshots,
    mean: np.ndarray,
    inverse: np.ndarray,
    order: int,
    method: RandomisedSVD,
) -> tuple[np.ndarray, np.ndarray, float]:
    width = min(order + method.oversample, data.n_samples, data.n_columns)
    rng = np.random.default_rng(np.random.SeedSequence(method.seed))

    def across(left: np.ndarray) -> np.ndarray:
        """S^-1 (X - mean)^T left, streamed."""
        out, row = np.zeros((data.n_columns, left.shape[1])), 0
        for piece in data.pieces(shift=mean):
            out += piece.T @ left[row : row + len(piece)]
            row += len(piece)
        return inverse[:, None] * out

    def along(right: np.ndarray) -> np.ndarray:
        """(X - mean) S^-1 right, streamed."""
        scaled = inverse[:, None] * right
        return np.concatenate([piece @ scaled for piece in data.pieces(shift=mean)])

    def orthonormal(matrix: np.ndarray) -> np.ndarray:
        return sla.qr(matrix, mode="economic", overwrite_a=True, check_finite=False)[0]

    Q = orthonormal(across(rng.standard_normal((data.n_samples, width))))
    for _ in range(method.power):
        Q = orthonormal(across(orthonormal(along(Q))))
    total, parts = 0.0, []
    scaled, weight = inverse[:, None] * Q, inverse**2
    for piece in data.pieces(shift=mean):
        parts.append(piece @ scaled)
        total += float(np.einsum("ij,ij->j", piece, piece) @ weight)
    _, s, Wt = sla.svd(np.concatenate(parts), full_matrices=False)
    return Q @ Wt.T, s, total


def latent_samples(data: Snapshots, basis: Basis, ahead: int = 0) -> np.ndarray:
    """Z (n_samples, m): latent coordinates of the used samples, shifted by `ahead`."""
    weight = basis.inverse_scale()[:, None] * basis.V
    return np.concatenate([piece @ weight for piece in data.pieces(ahead, basis.mean)])
