"""Where a cell inside a gel holds it: the free nodes around every membrane node, as they lie now.

    q_ij = (1 - |x_j - x_i|^2/h^2)^3_+ ,   W_i = sum_j q_ij ,
    w_ij = q_ij/(W_i + 0.02) ,             s_i = W_i/(W_i + 0.1)

w shares a force over the nodes, s is the share of k_on that finds a gel to bind to.
"""

from __future__ import annotations

import numpy as np

from cellsys.effects import clutch_kernels as kernels
from cellsys.effects.bond_laws import ClutchLaw
from cellsys.effects.footing import Foothold, Footing, Weights
from cellsys.effects.matrix import MATRIX
from cellsys.effects.protocol import Configuration, Port, Site
from cellsys.geometry.disc import Disc
from cellsys.geometry.network import FibreNetwork

_LEAST = 0.02  # weights of which half are lost: a force is not put on a node far away
_HALF = 0.1  # weights that bind at half the rate


def places(s: Configuration, matrix: FibreNetwork) -> np.ndarray:
    """Where the nodes of the matrix are (N, 3), um; found once for all who ask."""
    key = "matrix.places"
    if key not in s.cache:
        s.cache[key] = matrix.position + s.nodes[MATRIX]
    return s.cache[key]


class EmbeddedFooting(Foothold):
    """Weights of one cell's nodes on a gel around it."""

    axes = 3

    def __init__(self, array: str, matrix: FibreNetwork, reach: float) -> None:
        self.array, self.matrix, self.reach = array, matrix, reach
        self._free = matrix.surface.astype(np.int64)
        self._key = f"{array}.embedded.{reach!r}"

    def _found(self, s: Configuration) -> tuple[Weights, np.ndarray]:
        if self._key not in s.cache:
            x = s.nodes[self.array]
            count, total = np.zeros(len(x), np.int64), np.zeros(len(x))
            rows, shares = kernels.space_weights(
                x,
                places(s, self.matrix),
                self._free,
                self.reach,
                count,
                total,
            )
            longest = max(1, int(count.max()))
            index = np.zeros((len(x), longest), np.int64)
            weight = np.zeros((len(x), longest))
            kernels.by_rows(rows, shares, count, 1.0 / (total + _LEAST), index, weight)
            s.cache[self._key] = (index, weight, count), total
        return s.cache[self._key]

    def weights(self, s: Configuration) -> Weights:
        """w_ij of the nodes in reach."""
        return self._found(s)[0]

    def hold(self, s: Configuration) -> np.ndarray:
        """W_i/(W_i + 0.02)."""
        total = self._found(s)[1]
        return total / (total + _LEAST)

    def on_rates(self, s: Configuration, law: ClutchLaw) -> np.ndarray:
        """k_on s_i, 1/s."""
        total = self._found(s)[1]
        return law.on_rate * total / (total + _HALF)

    def port(self, name: str) -> Port:
        """One for all cells: a force on every node of a gel for every cell would fill memory."""
        return Port(MATRIX, f"{MATRIX}.{name}")


def foothold(site: Site, reach: float) -> Foothold:
    """The foothold of the site's cell on its matrix, flat or around it."""
    if isinstance(site.network, Disc):
        return Footing(site.body.name, site.network, reach)
    return EmbeddedFooting(site.body.name, site.network, reach)
