"""Basis: leading right singular vectors of the scaled, centred snapshots.

    V, s = leading right singular vectors of (X - mean) S^-1 ,   z = V^T S^-1 (x~ - mean)

The covariance of all columns is never formed. Snapshots are streamed by blocks of rows.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from numbers import Integral

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.errors import ParameterError, RankError
from cellsys.kinds import Seed
from cellsys.samples.snapshots import Snapshots

_EXACT_SIZE = 4e6  # entries up to which the exact SVD is the default


@checked
@dataclass(frozen=True, kw_only=True)
class ExactSVD:
    """LAPACK's SVD of all snapshots in memory."""


@checked
@dataclass(frozen=True, kw_only=True)
class RandomisedSVD:
    """Randomised block Krylov method, streamed (Musco & Musco 2015).

    With G = S^-1 (X - mean)^T (X - mean) S^-1 and a random start Q_0 = X^T Omega, the directions
    are the best ones in span[Q_0, G Q_0, ..., G^power Q_0]. Every product with G reads the data
    once, and so does the start: power + 2 passes, against 2 power + 3 of the randomised range
    finder, whose subspace is contained in this one.

    Parameters
    ----------
    oversample : int
        Directions beyond the order asked for.
    power : int
        Products with G after the first.
    seed : int
        Of the start matrix; the same seed gives the same basis.
    """

    oversample: int = 20
    power: int = 2
    seed: Seed = 0

    def __post_init__(self) -> None:
        if self.oversample < 1 or self.power < 0:
            raise ParameterError("RandomisedSVD needs oversample >= 1 and power >= 0")


@dataclass(frozen=True, eq=False, kw_only=True)
class LatentParts:
    """Latent samples split into the parts of x and of eta, now and one sample ahead.

    Each is (n_samples, m); `runs` and `samples` number the rows, `data` is what they are of.
    """

    x_now: np.ndarray
    x_next: np.ndarray
    eta_now: np.ndarray
    eta_next: np.ndarray
    runs: np.ndarray
    samples: np.ndarray
    data: Snapshots = field(repr=False)

    @classmethod
    def of(cls, data: Snapshots, basis: Basis) -> LatentParts:
        """Project all used samples and their successors, in one pass over the data."""
        n = data.states.size
        weight = basis.inverse_scale()[:, None] * basis.V
        parts: list[list[np.ndarray]] = [[], [], [], []]
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
        x_now, x_next, eta_now, eta_next = (np.concatenate(p) for p in parts)
        return cls(
            x_now=x_now,
            x_next=x_next,
            eta_now=eta_now,
            eta_next=eta_next,
            runs=data.run_ids,
            samples=np.concatenate([r.usable() for r in data.runs]),
            data=data,
        )

    def first(self, order: int) -> LatentParts:
        """The first `order` coordinates."""
        return replace(
            self,
            x_now=self.x_now[:, :order],
            x_next=self.x_next[:, :order],
            eta_now=self.eta_now[:, :order],
            eta_next=self.eta_next[:, :order],
        )

    def where(self, rows: np.ndarray) -> LatentParts:
        """A selection of samples."""
        return replace(
            self,
            x_now=self.x_now[rows],
            x_next=self.x_next[rows],
            eta_now=self.eta_now[rows],
            eta_next=self.eta_next[rows],
            runs=self.runs[rows],
            samples=self.samples[rows],
        )

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


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Basis:
    """V (columns, m) orthonormal, singular values, mean (columns,) and scale (columns,).

    `scale` is 0 on columns that do not vary; their rows of V are zero and their value is the
    mean. `total` is the sum of all squared singular values. `residuals` (m,), |G v - s^2 v| / s
    of a randomised basis, bound its error: there is an exact singular value within that of each
    s. They are zero where LAPACK found everything. `parts`, if given, are latent samples in it.
    """

    V: np.ndarray
    singular_values: np.ndarray
    mean: np.ndarray
    scale: np.ndarray
    total: float
    dropped: int
    residuals: np.ndarray | None = None
    parts: LatentParts | None = None

    def with_parts(self, data: Snapshots) -> Basis:
        """The basis carrying the samples of `data` in it, for all that are fitted to these data."""
        return replace(self, parts=self.parts_of(data))

    def parts_of(self, data: Snapshots) -> LatentParts:
        """The samples of `data` in it: those it carries where they are of these very data."""
        if self.parts is not None and self.parts.data is data:
            return self.parts
        return LatentParts.of(data, self)

    @property
    def left_out(self) -> float:
        """|X - X V V^T|_F / |X|_F of the scaled, centred snapshots: exact, whatever the method."""
        kept = float(np.sum(self.singular_values**2))
        return float(np.sqrt(max(1.0 - kept / self.total, 0.0)))

    def angle_bound(self, count: int) -> float:
        """Bound on the sine of the largest angle between the first `count` directions and the
        exact ones, from residuals and the gap to the next singular value (Davis & Kahan 1970).

            |G V - V S^2|_F / (s_count^2 - s_count+1^2)

        It takes the next value found for the next exact one, and holds for what was found: a
        direction that the random start missed altogether has probability zero.
        """
        if not 1 <= count < len(self.singular_values):
            raise ParameterError(
                f"count must be between 1 and {len(self.singular_values) - 1}, got {count}"
            )
        if self.residuals is None:
            return 0.0
        s = self.singular_values
        size = float(np.linalg.norm(self.residuals[:count] * s[:count]))
        gap = float(s[count - 1] ** 2 - (s[count] + self.residuals[count]) ** 2)
        return min(size / gap, 1.0) if gap > 0 else 1.0

    def inverse_scale(self) -> np.ndarray:
        """1/scale, and 0 where the column was dropped."""
        return np.divide(1.0, self.scale, out=np.zeros_like(self.scale), where=self.scale > 0)


def truncated(basis: Basis | None, order: int) -> Basis | None:
    """The first `order` directions of a basis that has at least as many."""
    check_order(order)
    if basis is None or basis.V.shape[1] < order:
        return None
    return Basis(
        V=basis.V[:, :order],
        singular_values=basis.singular_values[:order],
        mean=basis.mean,
        scale=basis.scale,
        total=basis.total,
        dropped=basis.dropped,
        residuals=None if basis.residuals is None else basis.residuals[:order],
        parts=None if basis.parts is None else basis.parts.first(order),
    )


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


@checked
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
    # All of the variance that is kept, without another pass over the data.
    total = data.n_samples * float(np.sum(variance * inverse**2))
    if isinstance(method, ExactSVD):
        X = np.concatenate([piece * inverse for piece in data.pieces(shift=mean)])
        _, s, Vt = sla.svd(X, full_matrices=False, check_finite=False)
        V, residuals, total = Vt.T, None, float(np.sum(X * X))
    else:
        V, s, residuals = _randomised(data, mean, inverse, order, method)
    rank = int(np.sum(s > max(data.n_samples, data.n_columns) * np.finfo(float).eps * s[0]))
    if order > rank:
        raise RankError(
            f"order {order} is beyond the data's numerical rank {rank}; lower the order"
        )
    V = np.ascontiguousarray(V[:, :order])
    residuals = None if residuals is None else residuals[:order]
    return Basis(
        V=V,
        singular_values=s[:order],
        mean=mean,
        scale=scale,
        total=total,
        dropped=int(np.sum(scale == 0)),
        residuals=residuals,
    )


def _randomised(
    data: Snapshots,
    mean: np.ndarray,
    inverse: np.ndarray,
    order: int,
    method: RandomisedSVD,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directions (columns, .), singular values and residuals, best first."""
    width = min(order + method.oversample, data.n_samples, data.n_columns)
    rng = np.random.default_rng(np.random.SeedSequence(method.seed))
    # Fortran order throughout: BLAS then adds a block's share to `out` in place.
    out, row = np.zeros((data.n_columns, width), order="F"), 0
    start = rng.standard_normal((data.n_samples, width))
    for piece in data.pieces(shift=mean):
        out = _add_product(out, piece, start[row : row + len(piece)])
        row += len(piece)
    Q = _orthonormal(inverse[:, None] * out)
    space, image, left = [], [], []
    for k in range(method.power + 1):
        scaled = np.asfortranarray(inverse[:, None] * Q)
        out, parts = np.zeros_like(scaled), []
        for piece in data.pieces(shift=mean):
            parts.append(piece @ scaled)
            out = _add_product(out, piece, parts[-1])
        GQ = inverse[:, None] * out
        space.append(Q)
        image.append(GQ)
        left.append(np.concatenate(parts))
        room = min(data.n_samples, data.n_columns) - sum(b.shape[1] for b in space)
        if k == method.power or room <= 0:
            break
        # Against all blocks, twice: the basis is orthonormal to rounding.
        for _ in range(2):
            for block in space:
                GQ = GQ - block @ (block.T @ GQ)
            GQ = _orthonormal(GQ)
        Q = GQ[:, :room]
    # X K = U S W^T in the Krylov basis K; G K W is known, so the residuals cost no pass.
    _, s, Wt = sla.svd(
        sla.qr(np.concatenate(left, axis=1), mode="economic", check_finite=False)[1],
        full_matrices=False,
        check_finite=False,
    )
    W = Wt.T[:, : order + 1]
    V, s = np.concatenate(space, axis=1) @ W, s[: order + 1]
    miss = np.linalg.norm(np.concatenate(image, axis=1) @ W - V * s**2, axis=0)
    residuals = np.divide(miss, s, out=np.zeros_like(miss), where=s > 0)
    return V, s, residuals


def _orthonormal(matrix: np.ndarray) -> np.ndarray:
    return sla.qr(matrix, mode="economic", overwrite_a=True, check_finite=False)[0]


def _add_product(out: np.ndarray, piece: np.ndarray, left: np.ndarray) -> np.ndarray:
    """out + piece^T left, in place where BLAS allows it."""
    return sla.blas.dgemm(1.0, piece.T, left, beta=1.0, c=out, overwrite_c=True)
