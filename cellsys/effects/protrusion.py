"""The lamellipodium with its reaction: what pushes the cell forward pulls on its clutches.

    force on leading node i      g_i f_i
    carried by clutch j          r_j = sum_i phi_ij f_i + c_j     (`push_off`)
    force on matrix node k       -sum_j w_jk r_j,  w_jk the weights of the clutches

The push is commanded and enters u, as the source that the thesis has; what it takes is in eta.
Without clutches in reach there is no push (g = 0). Forces sum to zero to rounding, couples about
the substrate's normal too, those of the clutches' own pulls included; unbinding sees the load.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellsys.effects import protrusion_kernels as kernels
from cellsys.effects.anchorage import Anchorage
from cellsys.effects.commands import Commands
from cellsys.effects.matrix import MATRIX
from cellsys.effects.protocol import CellBody, Configuration, Element, Port
from cellsys.effects.push import CommandedPush, ProtrusionLaw
from cellsys.errors import SceneError
from cellsys.geometry.disc import Disc


class ProtrusionElement(CommandedPush):
    """Source of effort between a membrane and the matrix, modulated by the clutches."""

    def __init__(
        self, effect: ProtrusionLaw, cell: CellBody, disc: Disc, commands: Commands
    ) -> None:
        super().__init__(effect, cell, commands)
        self.disc = disc
        self.inputs = (Port(cell.name, self.name),)
        self.ports = (Port(MATRIX, f"{MATRIX}.{effect.name}.{cell.name}"),)
        self._anchorage: Anchorage | None = None

    @property
    def anchorage(self) -> Anchorage:
        """The clutches of the cell; SceneError where there are none."""
        if self._anchorage is None:
            raise SceneError(
                f"lamellipodium.reaction = 'clutch' of {self.array} needs focal_adhesion with "
                "kinetics = 'clutch'; add it, or set reaction = 'none'"
            )
        return self._anchorage

    def connect(self, built: Sequence[Element]) -> None:
        self._anchorage = next(
            (e for e in built if isinstance(e, Anchorage) and e.array == self.array), None
        )
        self.anchorage.carry(self.carried)

    def push(self, s: Configuration) -> np.ndarray:
        """Force of every node (n, 3), pN, at full engagement."""
        e = self.effect
        out = np.empty_like(s.nodes[self.array])
        kernels.sector_push(
            s.nodes[self.array],
            s.internal[self.polarity],
            self.amplitude(s.t) * e.force,
            e.height,
            e.edge,
            e.full,
            e.downward,
            out,
        )
        return out

    def _shares(self, s: Configuration) -> tuple[np.ndarray, np.ndarray]:
        """g_i f_i and r_j (n, 3), pN."""
        key = self.name + ".shares"
        if key not in s.cache:
            x, bonds = s.nodes[self.array], self.anchorage
            cell, carried = np.empty_like(x), np.empty_like(x)
            kernels.push_off(
                x,
                self.push(s),
                bonds.strengths(s),
                bonds.pulls(s),
                *bonds.footing.weights(s),
                self.disc.position,
                s.nodes[MATRIX],
                self.effect.range,
                self.effect.half,
                cell,
                carried,
            )
            s.cache[key] = cell, carried
        return s.cache[key]

    def carried(self, s: Configuration) -> np.ndarray:
        """Load r_j of every clutch (n, 3), pN."""
        return self._shares(s)[1]

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        kernels.put_down(self.carried(s), *self.anchorage.footing.weights(s), out[0])

    def force(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        out[0][:] = self._shares(s)[0]
