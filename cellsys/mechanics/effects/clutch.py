"""Motor clutches of one cell on the surface nodes of the matrix; parameters in `adhesion`."""

from __future__ import annotations

import numpy as np

from cellsys.mechanics import clutch_kernels as kernels
from cellsys.mechanics.effects.bond_laws import ClutchLaw
from cellsys.mechanics.effects.matrix import MATRIX
from cellsys.mechanics.effects.protocol import (
    CellBody,
    Configuration,
    Element,
    Port,
    Stiffness,
)
from cellsys.mechanics.geometry.disc import Disc
from cellsys.mechanics.tangent import diagonal
from cellsys.system import Block


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

    def weights(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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


class ClutchElement(Element):
    """Clutches of one cell: what the cell loses the matrix gains, by the same weights."""

    def __init__(self, effect: ClutchLaw, cell: CellBody, disc: Disc) -> None:
        self.effect, self.disc = effect, disc
        self.name = f"{cell.name}.{effect.name}"
        self.array = cell.name
        n = len(cell.membrane.position)
        self.ports = (
            Port(cell.name, self.name),
            Port(MATRIX, f"{MATRIX}.{effect.name}.{cell.name}"),
        )
        self.strength, self.stretch = f"{cell.name}.bond_strength", f"{cell.name}.bond_stretch"
        self.internal = (
            Block(self.strength, (n,), "1", role="component", kind="internal"),
            Block(self.stretch, (n, 2), "um", role="component", kind="internal"),
        )
        self.bins = SurfaceBins(disc, effect.reach)
        self._load = np.zeros(len(disc.position))
        self._load_key = 0

    def forget(self) -> None:
        self._load = np.zeros(len(self.disc.position))

    def _weights(self, s: Configuration) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if self.name not in s.cache:
            s.cache[self.name] = self.bins.weights(s.nodes[self.array])
        return s.cache[self.name]

    def _rim(self, s: Configuration) -> np.ndarray:
        key = self.name + ".rim"
        if key not in s.cache:
            s.cache[key] = rim_factor(s.nodes[self.array], self.disc.radius)
        return s.cache[key]

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        e = self.effect
        kernels.clutch_loads(
            s.nodes[self.array],
            s.nodes[MATRIX],
            s.internal[self.strength],
            s.internal[self.stretch],
            *self._weights(s),
            e.stiffness,
            e.zipper,
            *out,
        )

    def energy(self, s: Configuration) -> float:
        """Zipper energy only: the stretch follows velocities, not positions."""
        index, weight, count = self._weights(s)
        z = s.nodes[self.array][:, 2].copy()
        z -= (weight * s.nodes[MATRIX][index, 2]).sum(axis=1)
        n = s.internal[self.strength] * (count > 0)
        return 0.5 * self.effect.zipper * float(n @ z**2)

    def rates(self, s: Configuration, v: dict[str, np.ndarray], out: tuple) -> None:
        slip = np.empty((len(v[self.array]), 2))
        kernels.gather(v[MATRIX], *self._weights(s), slip)
        slip -= v[self.array][:, :2]
        e = self.effect
        kernels.clutch_rates(
            s.nodes[self.array],
            s.internal[self.strength],
            s.internal[self.stretch],
            self._rim(s),
            slip,
            e.stiffness,
            e.on_rate,
            e.height,
            e.width,
            e.off_rate,
            e.force_scale,
            e.retrograde_speed,
            *out,
        )

    def advance(self, s: Configuration, end: Configuration, dt: float) -> None:
        e, x = self.effect, s.nodes[self.array]
        slip = np.empty((len(x), 2))
        kernels.slip(
            s.nodes[MATRIX],
            end.nodes[MATRIX],
            x,
            end.nodes[self.array],
            *self._weights(s),
            dt,
            slip,
        )
        kernels.clutch_advance(
            x,
            s.internal[self.strength],
            s.internal[self.stretch],
            self._rim(s),
            slip,
            dt,
            e.stiffness,
            e.on_rate,
            e.height,
            e.width,
            e.off_rate,
            e.force_scale,
            e.retrograde_speed,
            end.internal[self.strength],
            end.internal[self.stretch],
        )

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        e = self.effect
        # Bond strengths grow by at most k_on per second: a margin of 0.2 lasts until the next look.
        n = np.minimum(s.internal[self.strength] + 0.2, 1.0)
        index, weight, count = self._weights(s)
        load = np.zeros(len(self.disc.position))
        used = np.arange(weight.shape[1]) < count[:, None]
        np.add.at(load, index[used], (weight * n[:, None])[used])
        if np.any(load > self._load) or load.max() < 0.3 * self._load.max():
            # A floor of half the greatest load on the whole surface: few factorisations.
            self._load = np.zeros(len(load))
            self._load[self.disc.surface] = 0.5 * load.max()
            self._load = np.maximum(self._load, 1.5 * load)
            self._load_key += 1
        greatest = max(e.stiffness, e.zipper)
        return (
            Stiffness(self.array, (0, 1), lambda: diagonal(e.stiffness * n), None),
            Stiffness(self.array, (2,), lambda: diagonal(e.zipper * n), None),
            Stiffness(MATRIX, (0, 1, 2), lambda: diagonal(greatest * self._load), self._load_key),
        )
