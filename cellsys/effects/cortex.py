"""Cortex: a layer of its own under the membrane, with its own drag and tension."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from cellsys.effects.membrane import area_bound, area_forces
from cellsys.effects.protocol import (
    CellBody,
    Configuration,
    Effect,
    Element,
    JunctionArray,
    Port,
    Site,
    Stiffness,
    parameter,
)
from cellsys.effects.tangent import diagonal, laplacian
from cellsys.system import Block


@dataclass(frozen=True)
class Cortex(Effect):
    """One cortex node under each membrane node, at x + s, in place of the condensed cortex.

        C_c v + C_cort (v - v_cort) = F          [thesis eq. 63-64]
        C_cort (v_cort - v) = F_T - k s

    The state is the offset s (array ``cellK.cortex``): with v_cort = v + s' the two equations read
    C_c x' = F + F_T and C_cort s' = F_T - k s, so that every drag stays diagonal and W_eta
    constant. F_T = -d(gamma A)/dx at the cortex; it acts on x and on s alike, since both move the
    cortex. `drag.cortex` is left out of the membrane's drag.
    """

    name: ClassVar[str] = "cortex"
    replaces: ClassVar[tuple[str, ...]] = ("drag.cortex",)
    excludes: ClassVar[dict[str, str]] = {
        "cortical_tension": "the cortex carries the tension, and a cell has one"
    }
    not_on: ClassVar[dict[str, str]] = {"chain": "a crawler is two masses and has no cortex"}
    drag: float = parameter(
        "1000 pN s/um", "pN s/um", above=0.0, source="thesis, C_cort [notes: mechanics, cortex]",
        about="friction between a cortex node and its membrane node",
    )  # fmt: skip
    tension: float = parameter(
        "150 pN/um",
        "pN/um",
        least=0.0,
        source="working set [notes: mechanics, cortex]",
        about="surface tension gamma",
    )
    link: float = parameter(
        "100 pN/um", "pN/um", least=0.0,
        source="chosen here [notes: mechanics, cortex]",
        about="spring between a cortex node and its membrane node",
    )  # fmt: skip

    def arrays(self, site: Site) -> tuple[JunctionArray, ...]:
        shape = site.body.membrane.position.shape
        name = f"{site.body.name}.cortex"
        block = Block(f"{name}.offset", shape, "um")
        return (JunctionArray(name, block, np.zeros(shape), np.full(shape, self.drag)),)

    def elements(self, site: Site) -> tuple[Element, ...]:
        return (_CortexElement(self, site.body),)


class _CortexElement(Element):
    def __init__(self, effect: Cortex, cell: CellBody) -> None:
        self.effect, self.mesh, self.array = effect, cell.membrane, cell.name
        self.name = self.layer = f"{cell.name}.cortex"
        self.ports = (Port(cell.name, self.name), Port(self.layer, f"{self.name}.offset"))

    def _place(self, s: Configuration) -> np.ndarray:
        return s.nodes[self.array] + s.nodes[self.layer]

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        m, e = self.mesh, self.effect
        area_forces(self._place(s), m.triangles, m.triangle_area, 0.0, e.tension, out[0])
        out[1][:] = out[0] - e.link * s.nodes[self.layer]

    def energy(self, s: Configuration) -> float:
        m, e, x = self.mesh, self.effect, self._place(s)
        area = area_forces(x, m.triangles, m.triangle_area, 0.0, e.tension, np.zeros_like(x))
        return area + 0.5 * e.link * float((s.nodes[self.layer] ** 2).sum())

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        """Twice the bound of the tension on x and on s: |a + b|^2 <= 2 |a|^2 + 2 |b|^2."""
        link = np.full(len(s.nodes[self.layer]), self.effect.link)
        return (
            Stiffness(self.array, (0, 1, 2), lambda: self._bound(s), None),
            Stiffness(self.layer, (0, 1, 2), lambda: self._bound(s) + diagonal(link), None),
        )

    def _bound(self, s: Configuration) -> sp.csc_array:
        m, x = self.mesh, self._place(s)
        pairs, weight = area_bound(x, m.triangles, m.triangle_area, 0.0, self.effect.tension)
        return laplacian(len(x), pairs, 2.0 * weight)
