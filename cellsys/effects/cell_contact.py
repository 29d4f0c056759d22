"""Cell contact: cells that touch push each other away and do not pass through each other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from cellsys.effects.contact_kernels import surface_contact
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
from cellsys.geometry.surface import Surface

_MARGIN = 0.3  # um: nodes this much farther apart may touch before the next look at the tangent


@dataclass(frozen=True)
class CellContact(Effect):
    """Repulsion of cells that touch: E = sum k/2 max(0, gap - d)^2 over the nodes of each pair.

    d is the distance of a node of one cell to the surface of the other, negative inside, as in the
    read-out of gaps (`cellsys.geometry.surface`), and the force is shared by the corners
    of the triangle that the node faces. Cells farther apart than the gap cost a comparison of
    their boxes.
    """

    name: ClassVar[str] = "cell_contact"
    acts_on: ClassVar[str] = "cells"
    not_on: ClassVar[dict[str, str]] = {"chain": "crawlers meet at the nodes of the chain"}
    stiffness: float = parameter(
        "1000 pN/um", "pN/um", least=0.0,
        source="calibrated here [notes: mechanics, contact]",
        about="repulsion of a node",
    )  # fmt: skip
    gap: float = parameter(
        "0.5 um",
        "um",
        above=0.0,
        source="assumed [notes: mechanics, contact]",
        about="distance at which it starts",
    )

    def elements(self, site: Site) -> tuple[Element, ...]:
        return (_CellContactElement(self, site.cells),) if len(site.cells) > 1 else ()


class _CellContactElement(Element):
    def __init__(self, effect: CellContact, cells: tuple[CellBody, ...]) -> None:
        self.effect, self.cells = effect, cells
        self.name = f"cells.{effect.name}"
        self.ports = tuple(Port(c.name, f"{c.name}.{effect.name}") for c in cells)

    def _look(self, s: Configuration, out: tuple[np.ndarray, ...], reach: float) -> tuple:
        e, energy = self.effect, 0.0
        near = tuple(np.zeros(len(f)) for f in out)
        at = [s.nodes[c.name] for c in self.cells]
        low, high = [x.min(axis=0) for x in at], [x.max(axis=0) for x in at]
        surfaces: dict[int, Surface] = {}
        for i in range(len(at)):
            for j in range(len(at)):
                if i == j or (low[i] > high[j] + reach).any() or (high[i] < low[j] - reach).any():
                    continue
                if j not in surfaces:
                    surfaces[j] = self.cells[j].membrane.mesh.at(at[j])
                energy += surface_contact(
                    at[i], *surfaces[j].arrays, e.stiffness, e.gap, reach,
                    out[i], out[j], near[i], near[j],
                )  # fmt: skip
        return energy, near

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        self._look(s, out, self.effect.gap)

    def energy(self, s: Configuration) -> float:
        out = tuple(np.zeros_like(s.nodes[c.name]) for c in self.cells)
        return self._look(s, out, self.effect.gap)[0]

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        """2 k on every node near a surface and on the corners it faces.

        |r|^2 of r = d_x - sum b_j d_j with shares b_j that sum to 1 is at most
        2 |d_x|^2 + 2 sum b_j |d_j|^2.
        """
        out = tuple(np.zeros_like(s.nodes[c.name]) for c in self.cells)
        _, near = self._look(s, out, self.effect.gap + _MARGIN)
        k = 2.0 * self.effect.stiffness
        return tuple(
            Stiffness(c.name, (0, 1, 2), partial(diagonal, k * n), None)
            for c, n in zip(self.cells, near, strict=True)
            if n.any()
        )
