"""Coordinates of one cell: charges of shape and load, reduced by POD; the centroid stands apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.linalg as sla

from cellsys.cell.charges import TOP, pack, unpack
from cellsys.cell.port import PolarPort
from cellsys.cell.shape import ShapeBasis
from cellsys.errors import ParameterError, RankError

CHARGES = range(TOP + 1)
_NORM = np.sqrt(4.0 * np.pi)  # coefficients of harmonics to rms over the sphere


@dataclass(frozen=True, eq=False)
class CellRepresentation:
    """x of a cell and its load on the matrix <-> (centroid, features per charge).

    Features of charge q: shape coefficients over sqrt(4 pi), so that their norm is the rms node
    displacement in um, then `load_weight` (um per pN/um) times the load's. Charge 0 starts with
    the height of the centroid above that of the starting sphere.

    Parameters
    ----------
    shape : ShapeBasis
    port : PolarPort
    start_height : float
        Height of the starting centroid, um.
    load_weight : float
    """

    shape: ShapeBasis
    port: PolarPort
    start_height: float
    load_weight: float

    def features(
        self, nodes: np.ndarray, loads: Sequence[dict[int, np.ndarray]] | None
    ) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        """Centroid (T, 3) and features (T, d_q) per charge of nodes (T, n, 3) and T loads.

        Without loads those features are zero (a cell that has not touched the matrix).
        """
        centre, W, Z = self.shape.coefficients(nodes)
        out = {}
        for q in CHARGES:
            parts = [pack(W, Z, q) / _NORM]
            if q == 0:
                parts.insert(0, (centre[..., 2] - self.start_height)[..., None])
            if loads is None:
                parts.append(np.zeros((len(centre), self.load_size(q))))
            else:
                parts.append(self.load_weight * np.array([load[q] for load in loads]))
            out[q] = np.concatenate(parts, axis=-1)
        return centre, out

    def load_size(self, q: int) -> int:
        """Number of load coefficients of charge q."""
        orders = self.port.orders
        held = [abs(q) <= orders, abs(1 - q) <= orders, q > 0 and 1 + q <= orders]
        return self.port.n_hats * sum(held)

    def split(self, q: int, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Shape part (height first for charge 0) and load part of features (..., d_q)."""
        n = features.shape[-1] - self.load_size(q)
        return features[..., :n], features[..., n:] / self.load_weight

    def nodes(self, place: np.ndarray, features: dict[int, np.ndarray]) -> np.ndarray:
        """Node positions (..., n, 3) from the centroid's place (..., 2) and the features."""
        packed = {q: self.split(q, f)[0] * _NORM for q, f in features.items()}
        height = packed[0][..., 0] / _NORM + self.start_height
        packed[0] = packed[0][..., 1:]
        W, Z = unpack(packed, *self.shape.sizes())
        centre = np.concatenate([np.asarray(place)[..., :2], height[..., None]], axis=-1)
        return self.shape.nodes(centre, W, Z)

    def load(self, features: dict[int, np.ndarray]) -> dict[int, np.ndarray]:
        """Charges of the load on the matrix, pN/um, from features."""
        return {q: self.split(q, f)[1] for q, f in features.items()}


@dataclass(frozen=True, eq=False)
class ChargeModes:
    """Coordinates of every charge: features ~ decoder x, x = encoder features; both real.

    POD on real and imaginary parts, whitened; a reductor may go over to coordinates in which its
    model contracts (`in_norm`).

    Parameters
    ----------
    decoder : dict of (d_q, m_q)
    encoder : dict of (m_q, d_q)
        encoder decoder = I; their product the other way round is the orthogonal projection.
    variance : dict of (m_q,)
        Of the POD coordinates: weights of the loss.
    tail : dict of float
        Share of each charge's squared norm that is left out.
    """

    decoder: dict[int, np.ndarray]
    encoder: dict[int, np.ndarray]
    variance: dict[int, np.ndarray]
    tail: dict[int, float] = field(default_factory=dict)

    @property
    def orders(self) -> tuple[int, ...]:
        """m_q of the charges 0, 1, ...; complex for q > 0."""
        return tuple(self.decoder[q].shape[1] for q in CHARGES)

    @property
    def order(self) -> int:
        """Number of real states."""
        return sum(m * _cost(q) for q, m in enumerate(self.orders))

    def encode(self, features: dict[int, np.ndarray]) -> dict[int, np.ndarray]:
        """x_q (..., m_q)."""
        return {q: features[q] @ self.encoder[q].T for q in CHARGES}

    def decode(self, x: dict[int, np.ndarray]) -> dict[int, np.ndarray]:
        """Features (..., d_q)."""
        return {q: x[q] @ self.decoder[q].T for q in CHARGES}

    def in_norm(self, S: dict[int, np.ndarray]) -> ChargeModes:
        """Coordinates S_q x_q."""
        return ChargeModes(
            {q: sla.solve(S[q].T, D.T).T for q, D in self.decoder.items()},
            {q: S[q] @ E for q, E in self.encoder.items()},
            self.variance,
            self.tail,
        )


def fit_modes(features: Sequence[dict[int, np.ndarray]], order: int) -> ChargeModes:
    """Modes of at most `order` real states, given out by the variance they bring per state.

    `features` are those of every run. A complex mode costs two states and brings the variance of
    both parts; charges 0 and 1 always get one.

    Raises
    ------
    RankError
        When the order is below 3 or beyond the data.
    """
    return _Variance(features).modes(order)


def smallest_order(features: Sequence[dict[int, np.ndarray]], tol: float) -> int:
    """Fewest real states whose modes leave at most `tol` of the features' squared norm.

    Raises
    ------
    ParameterError
        When all modes of the data leave more.
    """
    variance = _Variance(features)
    low, high = 3, variance.most
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if variance.left(middle) <= tol else (middle + 1, high)
    if variance.left(low) > tol:
        raise ParameterError(
            f"tol = {tol:g} cannot be met: all modes of these runs leave {variance.left(low):.2g}"
        )
    return low


class _Variance:
    """Singular values of every charge, and how an order is shared among them."""

    def __init__(self, features: Sequence[dict[int, np.ndarray]]) -> None:
        self.rows, self.parts = {}, {}
        for q in CHARGES:
            rows = np.concatenate([f[q] for f in features])
            stack = rows if q == 0 else np.concatenate([rows.real, rows.imag])
            self.rows[q], self.parts[q] = len(rows), sla.svd(stack, full_matrices=False)[1:]
        self.rank = {
            q: int((s > 1e-10 * s[0]).sum()) if s[0] > 0 else 0 for q, (s, _) in self.parts.items()
        }
        self.most = sum(r * _cost(q) for q, r in self.rank.items())

    def shares(self, order: int) -> dict[int, int]:
        """Modes per charge for an order."""
        if not 3 <= order <= self.most or not (self.rank[0] and self.rank[1]):
            raise RankError(
                f"order {order + 2} cannot be met: the centroid and one mode of charges 0 and 1 "
                f"need 5 states, and the data of these runs allow {self.most + 2}"
            )
        chosen = {q: 1 if q <= 1 else 0 for q in CHARGES}
        used = 3
        while True:
            gains = {
                q: self.parts[q][0][m] ** 2 / _cost(q)
                for q, m in chosen.items()
                if m < self.rank[q] and used + _cost(q) <= order
            }
            if not gains:
                return chosen
            best = max(gains, key=lambda q: gains[q])
            chosen[best] += 1
            used += _cost(best)

    def left(self, order: int) -> float:
        """Share of the squared norm that an order leaves."""
        chosen = self.shares(order)
        lost = sum(float(np.sum(self.parts[q][0][m:] ** 2)) for q, m in chosen.items())
        return lost / sum(float(np.sum(s**2)) for s, _ in self.parts.values())

    def modes(self, order: int) -> ChargeModes:
        """Coordinates of every charge and what they leave out."""
        chosen = self.shares(order)
        decoder, encoder, variance = {}, {}, {}
        for q, m in chosen.items():
            spread = self.parts[q][0][:m] / np.sqrt(self.rows[q])
            V = self.parts[q][1][:m]
            decoder[q], encoder[q] = np.ascontiguousarray(V.T) * spread, V / spread[:, None]
            variance[q] = spread**2
        tail = {}
        for q, (s, _) in self.parts.items():
            total = float(np.sum(s**2))
            tail[q] = float(np.sum(s[chosen[q] :] ** 2)) / total if total else 0.0
        return ChargeModes(decoder, encoder, variance, tail)


def _cost(q: int) -> int:
    """Real states of one mode."""
    return 1 if q == 0 else 2
