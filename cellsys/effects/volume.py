"""Volume of a cell: a pressure that keeps it, and holds the cortical tension from the start on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.effects.protocol import CellBody, Configuration, Effect, Element, Port, Site, parameter
from cellsys.geometry.membrane import volume_gradient


@dataclass(frozen=True)
class Volume(Effect):
    """Nearly constant volume, E = K_V (V - V0)^2/(2 V0) - p0 (V - V0).

    The pressure is p = p0 - K_V (V/V0 - 1). ``pressure = "laplace"``: p0 is what the forces of
    the cell on itself ask for at the start, p0 = -(sum F.g)/(sum g.g) with g = dV/dx, and nodes
    then move to where the free cell is in equilibrium (`cellsys.mechanics.rest`). On a sphere of
    radius R under a tension gamma that is Laplace's 2 gamma/R. ``pressure = "zero"``: p0 = 0; a
    cell under tension then loses 2 gamma/(R K_V) of its volume at once.
    """

    name: ClassVar[str] = "volume"
    not_on: ClassVar[dict[str, str]] = {"chain": "a crawler is two masses and encloses no volume"}
    modulus: float = parameter(
        "1000 pN/um^2",
        "pN/um^2",
        least=0.0,
        source="chosen here [notes: mechanics, volume]",
        about="K_V",
    )
    pressure: str = parameter(
        "laplace",
        choices=("laplace", "zero"),
        source="chosen here [notes: mechanics, volume]",
        about="pressure at the start",
    )

    def elements(self, site: Site) -> tuple[Element, ...]:
        return (VolumeElement(self, site.body),)


class VolumeElement(Element):
    """C-field of the enclosed volume."""

    def __init__(self, effect: Volume, cell: CellBody) -> None:
        self.effect, self.mesh = effect, cell.membrane
        self.name = f"{cell.name}.{effect.name}"
        self.array = cell.name
        self.ports = (Port(cell.name, self.name),)
        self.pressure = 0.0  # p0, pN/um^2

    def _gradient(self, s: Configuration) -> tuple[float, np.ndarray]:
        if self.name not in s.cache:
            x = s.nodes[self.array]
            gradient = np.empty_like(x)
            s.cache[self.name] = volume_gradient(x, self.mesh.triangles, gradient), gradient
        return s.cache[self.name]

    def balance(self, s: Configuration, others: Sequence[Element]) -> str:
        """Set p0 so that it takes up what it can of the forces of `others` on the membrane."""
        if self.effect.pressure == "zero":
            return ""
        _, g = self._gradient(s)
        force = np.zeros_like(g)
        for element in others:
            out = tuple([np.zeros_like(s.nodes[port.array]) for port in element.ports])
            element.efforts(s, out)
            for port, part in zip(element.ports, out, strict=True):
                if port.array == self.array:
                    force += part
        self.pressure = -float(np.vdot(force, g)) / float(np.vdot(g, g))
        return self.array

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        volume, gradient = self._gradient(s)
        pressure = -self.effect.modulus * (volume / self.mesh.volume - 1.0)
        if self.pressure:
            pressure += self.pressure
        out[0][:] = pressure * gradient

    def energy(self, s: Configuration) -> float:
        change = self._gradient(s)[0] - self.mesh.volume
        stored = 0.5 * self.effect.modulus * change**2 / self.mesh.volume
        return stored - self.pressure * change if self.pressure else stored

    def low_rank(self, s: Configuration) -> tuple[tuple[str, float, np.ndarray], ...]:
        if self.effect.modulus == 0.0:
            return ()
        return ((self.array, self.effect.modulus / self.mesh.volume, self._gradient(s)[1]),)
