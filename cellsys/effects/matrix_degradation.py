"""Matrix degradation: fibres near a cell lose stiffness for good."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.compiled import compiled
from cellsys.effects.fibre_kernels import fibre_forces
from cellsys.effects.matrix import MATRIX, FibreElement
from cellsys.effects.protocol import CellBody, Configuration, Effect, Element, Port, Site, parameter
from cellsys.errors import SceneError
from cellsys.laws.fibre import axial_energy
from cellsys.system import Block


@compiled
def exposures(middle, x, reach, width, exposed):
    """Add 1/(1 + exp((d - reach)/width)) to `exposed`, d from each fibre's middle to the nodes x.

    Beyond reach + 8 width it is taken as zero (it is below 4e-4 there).
    """
    far = reach + 8.0 * width
    low, high = np.full(3, 1e300), np.full(3, -1e300)
    for i in range(x.shape[0]):
        for c in range(3):
            low[c], high[c] = min(low[c], x[i, c] - far), max(high[c], x[i, c] + far)
    for k in range(middle.shape[0]):
        if middle[k, 0] < low[0] or middle[k, 1] < low[1] or middle[k, 2] < low[2]:
            continue
        if middle[k, 0] > high[0] or middle[k, 1] > high[1] or middle[k, 2] > high[2]:
            continue
        best = far * far
        for i in range(x.shape[0]):
            d0, d1, d2 = x[i, 0] - middle[k, 0], x[i, 1] - middle[k, 1], x[i, 2] - middle[k, 2]
            best = min(best, d0 * d0 + d1 * d1 + d2 * d2)
        if best < far * far:
            exposed[k] += 1.0 / (1.0 + np.exp((np.sqrt(best) - reach) / width))


@dataclass(frozen=True)
class MatrixDegradation(Effect):
    """Every fibre has an intact share w: w' = -rate c (w - least), c the exposure to all cells.

    Its force is w times that of the elastic law; the port holds the share that is lost,
    -(1 - w) f. c falls from 1 to 0 around `reach` from the nearest membrane node of a cell. The
    sensor reads what is left. Energy -(1 - w) E; with that of the fibres, w E, it only falls.
    """

    name: ClassVar[str] = "matrix_degradation"
    acts_on: ClassVar[str] = "cells"
    needs: ClassVar[tuple[str, ...]] = ("matrix_elasticity",)
    not_on: ClassVar[dict[str, str]] = {"chain": "the springs of a chain keep their stiffness"}
    rate: float = parameter(
        "0.001 1/s",
        "1/s",
        least=0.0,
        source="chosen here [notes: matrix, matrix degradation]",
        about="loss of a fibre at a cell",
    )
    least: float = parameter(
        "0.1",
        least=0.0,
        most=1.0,
        source="chosen here [notes: matrix, matrix degradation]",
        about="share that always stays",
    )
    reach: float = parameter(
        "2 um",
        "um",
        above=0.0,
        source="chosen here [notes: matrix, matrix degradation]",
        about="distance that enzymes reach",
    )
    width: float = parameter(
        "0.5 um",
        "um",
        above=0.0,
        source="chosen here [notes: matrix, matrix degradation]",
        about="width of that distance",
    )

    def elements(self, site: Site) -> tuple[Element, ...]:
        fibres = next((e for e in site.built if isinstance(e, FibreElement)), None)
        if fibres is None:
            raise SceneError("matrix_degradation needs a matrix; add [matrix] to the scene")
        built = _DegradationElement(self, fibres, site.cells)
        fibres.intact = built.intact
        return (built,)


class _DegradationElement(Element):
    def __init__(
        self, effect: MatrixDegradation, fibres: FibreElement, cells: tuple[CellBody, ...]
    ) -> None:
        self.effect, self.disc, self.law = effect, fibres.disc, fibres.law
        self.arrays = tuple(c.name for c in cells)
        self.name = f"{MATRIX}.{effect.name}"
        self.ports = (Port(MATRIX, self.name),)
        self.state = f"{MATRIX}.intact"
        self.internal = (
            Block(self.state, (len(self.disc.fibres),), "1", role="field", kind="internal"),
        )

    def initial(self, block: Block) -> np.ndarray:
        return np.ones(block.shape)

    def intact(self, s: Configuration) -> np.ndarray:
        """Share of every fibre's stiffness that is left."""
        return s.internal[self.state]

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        d = self.disc
        lost = (self.intact(s) - 1.0) * d.stiffness
        fibre_forces(d.position, s.nodes[MATRIX], d.fibres, d.length, lost, *self.law, out[0])

    def energy(self, s: Configuration) -> float:
        d = self.disc
        now = d.position + s.nodes[MATRIX]
        offset = now[d.fibres[:, 1]] - now[d.fibres[:, 0]]
        strain = np.sqrt((offset**2).sum(axis=1) + 1e-12) / d.length - 1.0
        lost = (self.intact(s) - 1.0) * d.stiffness
        return float((lost * d.length**2) @ axial_energy(strain, *self.law))

    def _decay(self, s: Configuration) -> np.ndarray:
        """rate c of every fibre, 1/s."""
        if self.name not in s.cache:
            now = self.disc.position + s.nodes[MATRIX]
            middle = 0.5 * (now[self.disc.fibres[:, 0]] + now[self.disc.fibres[:, 1]])
            exposed = np.zeros(len(middle))
            for array in self.arrays:
                exposures(middle, s.nodes[array], self.effect.reach, self.effect.width, exposed)
            s.cache[self.name] = self.effect.rate * exposed
        return s.cache[self.name]

    def rates(self, s: Configuration, v: dict[str, np.ndarray], out: tuple) -> None:
        out[0][:] = -self._decay(s) * (self.intact(s) - self.effect.least)

    def advance(self, s: Configuration, end: Configuration, dt: float) -> None:
        least = self.effect.least
        left = (self.intact(s) - least) * np.exp(-self._decay(s) * dt)
        end.internal[self.state][:] = least + left
