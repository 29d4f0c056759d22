"""Where a cell holds the matrix: the nodes in reach of every membrane node, with weights."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from cellsys.effects import clutch_kernels as kernels
from cellsys.effects.bond_laws import ClutchLaw
from cellsys.effects.protocol import Configuration, Port
from cellsys.geometry.disc import Disc
from cellsys.geometry.network import FibreNetwork

Weights = tuple[np.ndarray, np.ndarray, np.ndarray]  # index, weight, count


class Foothold(ABC):
    """What a clutch asks of the place where a cell holds its matrix.

    `axes`: in how many it pulls, 2 on a disc and 3 in a gel.
    """

    axes: int
    array: str
    matrix: FibreNetwork

    @abstractmethod
    def weights(self, s: Configuration) -> Weights:
        """(index, weight, count) at a configuration, found once for all who ask."""

    @abstractmethod
    def hold(self, s: Configuration) -> np.ndarray:
        """Sum of the weights of every membrane node (n,), in [0, 1]."""

    @abstractmethod
    def on_rates(self, s: Configuration, law: ClutchLaw) -> np.ndarray:
        """Binding of every membrane node (n,), 1/s."""

    @abstractmethod
    def port(self, name: str) -> Port:
        """Where the forces of an effect on the matrix go."""


def rim_factor(x: np.ndarray, radius: float) -> np.ndarray:
    """1 inside, 0 beyond 0.9 of the disc's radius, linear over 4 % of it: no bonds at the rim."""
    return np.clip((0.9 * radius - np.hypot(x[:, 0], x[:, 1])) / (0.04 * radius), 0.0, 1.0)


class SurfaceBins:
    """Surface nodes sorted into square bins of side `reach`, for `surface_weights`."""

    def __init__(self, disc: Disc, reach: float) -> None:
        xy = disc.position[disc.surface, :2]
        self.origin = float(-disc.radius - reach)
        self.bins = int(np.ceil(2.0 * (disc.radius + reach) / reach)) + 1
        cell = np.floor((xy - self.origin) / reach).astype(int) @ np.array([self.bins, 1])
        order = np.argsort(cell, kind="stable")
        self.nodes = disc.surface[order].astype(np.int64)
        self.start = np.searchsorted(cell[order], np.arange(self.bins**2 + 1)).astype(np.int64)
        self.reach, self.rest = reach, disc.position
        # Most nodes that any point can have in reach, counted with a margin of one bin.
        counts = np.diff(self.start).reshape(self.bins, self.bins)
        padded = np.pad(counts, 1)
        around = np.zeros_like(counts)
        for i, j in np.ndindex(3, 3):
            around += padded[i : i + self.bins, j : j + self.bins]
        self.most = max(1, int(around.max()))

    def weights(self, x: np.ndarray) -> Weights:
        """(index, weight, count) of the matrix nodes under each membrane node."""
        index = np.zeros((len(x), self.most), np.int64)
        weight = np.zeros((len(x), self.most))
        count = np.zeros(len(x), np.int64)
        kernels.surface_weights(
            x,
            self.rest,
            self.start,
            self.nodes,
            self.origin,
            self.bins,
            self.reach,
            index,
            weight,
            count,
        )
        return index, weight, count


class Footing(Foothold):
    """Weights of one cell's nodes on a disc; elements of the same reach share them."""

    axes = 2

    def __init__(self, array: str, disc: Disc, reach: float) -> None:
        self.array, self.matrix, self.disc = array, disc, disc
        self.bins = SurfaceBins(disc, reach)
        self._key = f"{array}.footing.{reach!r}"
        self._whole = np.ones(0)

    def weights(self, s: Configuration) -> Weights:
        """(index, weight, count) at a configuration, found once for all who ask."""
        if self._key not in s.cache:
            s.cache[self._key] = self.bins.weights(s.nodes[self.array])
        return s.cache[self._key]

    def hold(self, s: Configuration) -> np.ndarray:
        """1: the weights of a disc sum to that."""
        n = len(s.nodes[self.array])
        if len(self._whole) != n:
            self._whole = np.ones(n)
        return self._whole

    def on_rates(self, s: Configuration, law: ClutchLaw) -> np.ndarray:
        """k_on in the height of the bonds, away from the rim."""
        x = s.nodes[self.array]
        out = np.empty(len(x))
        rim = rim_factor(x, self.disc.radius)
        kernels.binding_rates(x, rim, law.on_rate, law.height, law.width, out)
        return out

    def port(self, name: str) -> Port:
        """One of every cell, which read-outs of tractions tell apart."""
        return Port("matrix", f"matrix.{name}.{self.array}")


class NodalLoad:
    """What membrane nodes put on the matrix, kept as a bound with a margin: few factorisations.

    The bound never falls below `floor` on the surface.
    """

    def __init__(self, disc: FibreNetwork, floor: float = 0.0) -> None:
        self.disc, self.floor, self.key = disc, floor, 0
        self.forget()

    def forget(self) -> None:
        """Drop the bound."""
        self.bound = np.zeros(len(self.disc.position))
        self.bound[self.disc.surface] = self.floor

    def look(self, share: np.ndarray, weights: Weights) -> None:
        """Renew the bound where the load of `share` (n,) has outgrown it, or fallen far below."""
        index, weight, count = weights
        load = np.zeros(len(self.bound))
        used = np.arange(weight.shape[1]) < count[:, None]
        np.add.at(load, index[used], (weight * share[:, None])[used])
        greatest = load.max()
        if np.any(load > self.bound) or max(greatest, self.floor) < 0.3 * self.bound.max():
            # At least half the greatest load on the whole surface: few factorisations.
            self.bound = np.zeros(len(load))
            self.bound[self.disc.surface] = max(0.5 * greatest, self.floor)
            self.bound = np.maximum(self.bound, 1.5 * load)
            self.key += 1
