"""Contact of cells with the gel around them: its nodes do not pass through a membrane."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from cellsys.effects.contact_kernels import surface_contact
from cellsys.effects.embedded import places
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
from cellsys.geometry.network import FibreNetwork

_MARGIN = 0.3  # um: nodes this much farther away may touch before the next look at the tangent


@dataclass(frozen=True)
class MatrixContact(Effect):
    """Repulsion of gel nodes by membranes, E = sum k/2 max(0, gap - d)^2.

    d is the distance of a node of the gel to the membrane, negative inside: the law of
    `cell_contact` between a surface and the nodes around it. On a disc it acts on the nodes that a
    cell presses itself onto.
    """

    name: ClassVar[str] = "matrix_contact"
    acts_on: ClassVar[str] = "cells"
    needs: ClassVar[tuple[str, ...]] = ("matrix_elasticity",)
    not_on: ClassVar[dict[str, str]] = {"chain": "a crawler lies on the chain, not in it"}
    stiffness: float = parameter(
        "300 pN/um",
        "pN/um",
        least=0.0,
        source="assumed [notes: mechanics, contact]",
        about="repulsion of a node of the gel",
    )
    gap: float = parameter(
        "0.3 um",
        "um",
        above=0.0,
        source="assumed [notes: mechanics, contact]",
        about="distance at which it starts",
    )

    def elements(self, site: Site) -> tuple[Element, ...]:
        return (_MatrixContactElement(self, site.cells, site.network),) if site.cells else ()


class _MatrixContactElement(Element):
    def __init__(
        self, effect: MatrixContact, cells: tuple[CellBody, ...], matrix: FibreNetwork
    ) -> None:
        self.effect, self.cells, self.matrix = effect, cells, matrix
        self.name = f"{MATRIX}.{effect.name}"
        self.ports = (
            Port(MATRIX, self.name),
            *(Port(c.name, f"{c.name}.{effect.name}") for c in cells),
        )

    def _look(
        self, s: Configuration, out: tuple[np.ndarray, ...], reach: float
    ) -> tuple[float, tuple[np.ndarray, ...]]:
        e, energy = self.effect, 0.0
        nodes = places(s, self.matrix)
        near = tuple(np.zeros(len(f)) for f in out)
        for k, cell in enumerate(self.cells, start=1):
            surface = cell.membrane.mesh.at(s.nodes[cell.name])
            energy += surface_contact(
                nodes, *surface.arrays, e.stiffness, e.gap, reach, out[0], out[k], near[0], near[k]
            )
        return energy, near

    def _nothing(self, s: Configuration) -> tuple[np.ndarray, ...]:
        return tuple(np.zeros_like(s.nodes[port.array]) for port in self.ports)

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        self._look(s, out, self.effect.gap)

    def energy(self, s: Configuration) -> float:
        return self._look(s, self._nothing(s), self.effect.gap)[0]

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        """2 k on every node near a membrane and on the corners it faces, as of `cell_contact`."""
        _, near = self._look(s, self._nothing(s), self.effect.gap + _MARGIN)
        k = 2.0 * self.effect.stiffness
        return tuple(
            Stiffness(port.array, (0, 1, 2), partial(diagonal, k * n), None)
            for port, n in zip(self.ports, near, strict=True)
            if n.any()
        )
