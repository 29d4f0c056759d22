"""Bell clusters: adhesions that bind, load, contract and rupture one by one."""

from __future__ import annotations

import numpy as np

from cellsys.compiled import compiled
from cellsys.effects.bond_laws import ClusterLaw
from cellsys.effects.matrix import MATRIX
from cellsys.effects.protocol import CellBody, Configuration, Element, Port, Stiffness
from cellsys.effects.tangent import diagonal
from cellsys.geometry.disc import Disc
from cellsys.laws.bell import (
    bond_number_rate,
    bond_number_step,
    contraction_rate,
    contraction_step,
)
from cellsys.system import Block, Event

FREE = -1.0  # partner of a membrane node without a cluster
RUPTURE = 0.5  # bond number below which a cluster is gone
_SOFT = 1e-12  # um^2: a bond of length zero has no direction
_PARTNER = ".bond_partner"
_GROWTH = 10.0  # s: bonds that close between two looks at the tangent


@compiled
def cluster_loads(x, rest, u, number, length, partner, stiffness, cell, matrix):
    """Add n_b kappa max(0, L - L_r) along each bond to the cell, the opposite to the matrix."""
    energy = 0.0
    for i in range(x.shape[0]):
        j = int(partner[i])
        if j < 0 or number[i] <= 0.0:
            continue
        d0 = rest[j, 0] + u[j, 0] - x[i, 0]
        d1 = rest[j, 1] + u[j, 1] - x[i, 1]
        d2 = rest[j, 2] + u[j, 2] - x[i, 2]
        now = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2 + _SOFT)
        stretch = now - length[i]
        if stretch <= 0.0:
            continue
        f = number[i] * stiffness * stretch / now
        energy += 0.5 * number[i] * stiffness * stretch * stretch
        cell[i, 0] += f * d0
        cell[i, 1] += f * d1
        cell[i, 2] += f * d2
        matrix[j, 0] -= f * d0
        matrix[j, 1] -= f * d1
        matrix[j, 2] -= f * d2
    return energy


@compiled
def bind_nearest(x, rest, u, surface, partner, taken, drawn, chance, reach, rim, found):
    """Partner and length of each new cluster, in `found` (nodes, 2); partner -1 where none.

    Every free node inside the rim looks for the nearest free surface node within `reach`, in
    order of the node's number, and takes it when its random number `drawn` is below `chance`.
    """
    for i in range(x.shape[0]):
        found[i, 0] = -1.0
        # Matrix nodes rise by less than a micrometre; most of a round cell is out of reach.
        if partner[i] >= 0.0 or drawn[i] >= chance or x[i, 2] > reach + 1.0:
            continue
        if x[i, 0] * x[i, 0] + x[i, 1] * x[i, 1] > rim * rim:
            continue
        best = reach * reach
        for j in surface:
            if taken[j]:
                continue
            d0 = rest[j, 0] + u[j, 0] - x[i, 0]
            d1 = rest[j, 1] + u[j, 1] - x[i, 1]
            d2 = rest[j, 2] + u[j, 2] - x[i, 2]
            d = d0 * d0 + d1 * d1 + d2 * d2
            if d <= best:
                best = d
                found[i, 0] = j
        if found[i, 0] >= 0.0:
            taken[int(found[i, 0])] = True
            found[i, 1] = np.sqrt(best + _SOFT)


class SwitchingElement(Element):
    """Clusters of one cell, each between a membrane node and the matrix node it holds.

        F_i = n_b kappa max(0, L - L_r) n ,   F_j = -F_i          [thesis eq. 61-62]

    Binding and rupture happen between steps only; a free node has n_b = L_r = 0 and partner -1,
    and its force is exactly zero. All three are states: a run goes on from its arrays alone.
    Laws and numbers: [notes: mechanics, clusters].
    """

    def __init__(self, effect: ClusterLaw, cell: CellBody, disc: Disc) -> None:
        self.effect, self.disc = effect, disc
        self.name = f"{cell.name}.{effect.name}"
        self.array = cell.name
        n = len(cell.membrane.position)
        self.ports = (
            Port(cell.name, self.name),
            Port(MATRIX, f"{MATRIX}.{effect.name}.{cell.name}"),
        )
        self.number, self.length = f"{cell.name}.bond_number", f"{cell.name}.bond_length"
        self.partner = cell.name + _PARTNER
        self.internal = (
            Block(self.number, (n,), "1", role="component", kind="internal"),
            Block(self.length, (n,), "um", role="component", kind="internal"),
            Block(self.partner, (n,), "1", role="component", kind="label"),
        )
        self.surface = disc.surface.astype(np.int64)
        self.rim = 0.9 * disc.radius
        self._held = np.zeros(len(disc.position), bool)
        self._key = 0

    def initial(self, block: Block) -> np.ndarray:
        return np.full(block.shape, FREE if block.name == self.partner else 0.0)

    def forget(self) -> None:
        self._held = np.zeros(len(self.disc.position), bool)

    def _bonds(self, s: Configuration) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bound nodes, the length of their bonds (um) and the load of one bond (pN)."""
        partner = s.internal[self.partner]
        bound = np.flatnonzero(partner >= 0.0)
        j = partner[bound].astype(np.int64)
        offset = self.disc.position[j] + s.nodes[MATRIX][j] - s.nodes[self.array][bound]
        now = np.sqrt((offset**2).sum(axis=1) + _SOFT)
        load = self.effect.bond_stiffness * np.maximum(now - s.internal[self.length][bound], 0.0)
        return bound, now, load

    def _loads(self, s: Configuration, cell: np.ndarray, matrix: np.ndarray) -> float:
        return cluster_loads(
            s.nodes[self.array],
            self.disc.position,
            s.nodes[MATRIX],
            s.internal[self.number],
            s.internal[self.length],
            s.internal[self.partner],
            self.effect.bond_stiffness,
            cell,
            matrix,
        )

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        self._loads(s, *out)

    def energy(self, s: Configuration) -> float:
        """Energy of the stretched bonds at the present bond numbers and rest lengths."""
        return self._loads(s, np.zeros_like(s.nodes[self.array]), np.zeros_like(s.nodes[MATRIX]))

    def rates(self, s: Configuration, v: dict[str, np.ndarray], out: tuple) -> None:
        e = self.effect
        bound, _, load = self._bonds(s)
        number, length = s.internal[self.number][bound], s.internal[self.length][bound]
        out[0][bound] = bond_number_rate(
            number, load, e.gain_rate, e.loss_rate, e.bonds, e.bond_force
        )
        shortens = length > e.rest_length
        out[1][bound] = shortens * contraction_rate(load, e.contraction_speed, e.stall_force)

    def advance(self, s: Configuration, end: Configuration, dt: float) -> None:
        e = self.effect
        for name in (self.number, self.length, self.partner):
            end.internal[name][:] = s.internal[name]
        bound, now, load = self._bonds(s)
        end.internal[self.number][bound] = bond_number_step(
            s.internal[self.number][bound],
            load,
            dt,
            e.gain_rate,
            e.loss_rate,
            e.bonds,
            e.bond_force,
        )
        end.internal[self.length][bound] = contraction_step(
            now,
            s.internal[self.length][bound],
            dt,
            e.bond_stiffness,
            e.contraction_speed,
            e.stall_force,
            e.rest_length,
        )

    def between_steps(
        self, s: Configuration, dt: float, rng: np.random.Generator
    ) -> tuple[Event, ...]:
        """Rupture clusters below 0.5 bonds, then let free nodes bind.

        One random number per membrane node and step, used or not: two runs that differ a little
        then draw the same numbers for the same nodes.
        """
        e = self.effect
        number, length = s.internal[self.number], s.internal[self.length]
        partner = s.internal[self.partner]
        drawn = rng.random(len(number))
        gone = np.flatnonzero((partner >= 0.0) & (number < RUPTURE))
        events = [Event(s.t, "rupture", self._detail(int(i), partner[i])) for i in gone]
        # A ruptured node binds again in the next step at the earliest.
        drawn[gone] = 1.0
        number[gone], length[gone], partner[gone] = 0.0, 0.0, FREE

        taken = np.zeros(len(self.disc.position), bool)
        for name, held in s.internal.items():
            if name.endswith(_PARTNER):
                taken[held[held >= 0.0].astype(np.int64)] = True
        found = np.empty((len(number), 2))
        bind_nearest(
            s.nodes[self.array],
            self.disc.position,
            s.nodes[MATRIX],
            self.surface,
            partner,
            taken,
            drawn,
            -np.expm1(-e.bind_rate * dt),
            e.bind_distance,
            self.rim,
            found,
        )
        new = np.flatnonzero(found[:, 0] >= 0.0)
        number[new], partner[new] = 1.0, found[new, 0]
        # Born at its own length: a new cluster carries no load.
        length[new] = np.maximum(e.rest_length, found[new, 1])
        events += [Event(s.t, "bind", self._detail(int(i), partner[i])) for i in new]
        return tuple(events)

    def _detail(self, node: int, partner: float) -> str:
        return f"{self.array} node {node} on matrix node {int(partner)}"

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        """1.5 kappa n on the cell, 3 on the matrix: diag(1.5, 3) >= [[1, -1], [-1, 1]].

        The smaller factor goes where a node is soft, the larger where fibres hold it anyway. A
        bond's tangent is at most n kappa in every direction. n grows towards n_max at k_on,
        within a few seconds, so the margin of `_GROWTH` is usually all of n_max.
        """
        e = self.effect
        partner, number = s.internal[self.partner], s.internal[self.number]
        bound = partner >= 0.0
        grown = e.bonds - (e.bonds - number) * np.exp(-e.gain_rate * _GROWTH)
        own = 1.5 * e.bond_stiffness * np.where(bound, np.maximum(number, grown), 0.0)
        j = partner[bound].astype(np.int64)
        if not self._held[j].all() or self._held.sum() > 2 * len(j) + 10:
            self._held = np.zeros(len(self._held), bool)
            self._held[j] = True
            self._key += 1
        held = 3.0 * e.bond_stiffness * e.bonds * self._held
        return (
            Stiffness(self.array, (0, 1, 2), lambda: diagonal(own), None),
            Stiffness(MATRIX, (0, 1, 2), lambda: diagonal(held), self._key),
        )
