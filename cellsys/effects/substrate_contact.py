"""Contact of a cell with what lies under it: a soft wall on the rigid support or on the matrix."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.effects import clutch_kernels as kernels
from cellsys.effects.bond_laws import ClutchLaw
from cellsys.effects.footing import Footing, NodalLoad
from cellsys.effects.matrix import MATRIX
from cellsys.effects.protocol import (
    CellBody,
    Configuration,
    Effect,
    Element,
    Port,
    Site,
    Stiffness,
    parameter,
)
from cellsys.effects.tangent import diagonal
from cellsys.errors import SceneError
from cellsys.geometry.disc import Disc

_SHARE = 1.0  # membrane nodes that press on a matrix node of the shipped density, at most
_ALONE = 3.0  # um: reach of the weights where no clutch gives one


@dataclass(frozen=True)
class SubstrateContact(Effect):
    """Soft wall under the cell, F_z = k max(0, gap - z).

    ``support = "rigid"``: z is the height above the support below the matrix, which takes up the
    force. ``support = "matrix"``: z is the height above the matrix under the node, a weighted mean
    with the weights of the clutches, and the matrix takes up the force by the same weights; a node
    beyond the matrix stands on the rigid support.
    """

    name: ClassVar[str] = "substrate_contact"
    not_on: ClassVar[dict[str, str]] = {
        "chain": "a crawler moves along the chain and does not press on it",
        "gel": "a cell lies in the gel, not on it; use matrix_contact",
    }
    stiffness: float = parameter(
        "1000 pN/um",
        "pN/um",
        least=0.0,
        source="assumed [notes: mechanics, contact]",
        about="wall stiffness",
    )
    gap: float = parameter(
        "0.05 um",
        "um",
        least=0.0,
        source="assumed [notes: mechanics, contact]",
        about="wall height",
    )
    support: str = parameter(
        "rigid",
        choices=("rigid", "matrix"),
        source="chosen here [notes: mechanics, contact]",
        about="what the cell presses on",
    )

    @property
    def outside_work(self) -> str:
        return "" if self.support == "matrix" else "the rigid support below takes up the push"

    def elements(self, site: Site) -> tuple[Element, ...]:
        if self.support == "rigid":
            return (WallElement(self, site.body),)
        if site.matrix is None:
            raise SceneError(
                "substrate_contact.support = 'matrix' needs a matrix; add [matrix] to the scene, "
                "or set support = 'rigid'"
            )
        law = site.find(ClutchLaw)
        reach = _ALONE if law is None else law.reach
        return (MatrixWallElement(self, site.body, site.disc, reach),)


class WallElement(Element):
    """The wall on the rigid support."""

    def __init__(self, effect: SubstrateContact, cell: CellBody) -> None:
        self.effect = effect
        self.name = f"{cell.name}.{effect.name}"
        self.array = cell.name
        self.outside = effect.outside_work
        self.ports = (Port(cell.name, self.name),)

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        depth = self.effect.gap - s.nodes[self.array][:, 2]
        out[0][:, 2] = self.effect.stiffness * np.maximum(depth, 0.0)

    def energy(self, s: Configuration) -> float:
        depth = np.maximum(self.effect.gap - s.nodes[self.array][:, 2], 0.0)
        return 0.5 * self.effect.stiffness * float(depth @ depth)

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        # Nodes within 0.1 um of the wall may touch it before the next look.
        near = s.nodes[self.array][:, 2] < self.effect.gap + 0.1
        wall = diagonal(self.effect.stiffness * near)
        return (Stiffness(self.array, (2,), lambda: wall, None),)


class MatrixWallElement(Element):
    """The wall on the matrix: what lifts the cell presses on the nodes under it."""

    def __init__(self, effect: SubstrateContact, cell: CellBody, disc: Disc, reach: float) -> None:
        self.effect = effect
        self.name = f"{cell.name}.{effect.name}"
        self.array = cell.name
        self.ports = (
            Port(cell.name, self.name),
            Port(MATRIX, f"{MATRIX}.{effect.name}.{cell.name}"),
        )
        self.footing = Footing(cell.name, disc, reach)
        self._load = NodalLoad(disc, _SHARE)

    def forget(self) -> None:
        self._load.forget()

    def _depth(self, s: Configuration) -> np.ndarray:
        """gap - height above the matrix (n,), um."""
        key = self.name + ".depth"
        if key not in s.cache:
            x, ground = s.nodes[self.array], s.nodes[MATRIX][:, 2]
            depth = np.empty(len(x))
            kernels.gather_scalar(ground, *self.footing.weights(s), depth)
            s.cache[key] = self.effect.gap - x[:, 2] + depth
        return s.cache[key]

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        lift = self.effect.stiffness * np.maximum(self._depth(s), 0.0)
        out[0][:, 2] = lift
        kernels.put_weight(lift, *self.footing.weights(s), out[1])

    def energy(self, s: Configuration) -> float:
        depth = np.maximum(self._depth(s), 0.0)
        return 0.5 * self.effect.stiffness * float(depth @ depth)

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        near = (self._depth(s) > -0.1).astype(float)
        self._load.look(near, self.footing.weights(s))
        k, bound = self.effect.stiffness, self._load
        return (
            Stiffness(self.array, (2,), lambda: diagonal(k * near), None),
            Stiffness(MATRIX, (2,), lambda: diagonal(k * bound.bound), bound.key),
        )
