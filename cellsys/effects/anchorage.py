"""What an element needs to know of bonds that carry its load."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable

import numpy as np

from cellsys.effects.footing import Foothold
from cellsys.effects.protocol import Configuration, Element


class Anchorage(Element):
    """Bonds between a cell and the matrix that also carry the loads of other elements.

    An element that pushes the cell's nodes against the matrix finds the anchorage of its cell in
    `connect`, shares its reaction over the bonds by `strengths`, puts it on the matrix by the
    weights of `footing`, and lets the bonds know of it by `carry`.
    """

    array: str
    footing: Foothold

    @abstractmethod
    def strengths(self, s: Configuration) -> np.ndarray:
        """Strength of the bond at every membrane node (n,), in [0, 1]."""

    @abstractmethod
    def pulls(self, s: Configuration) -> np.ndarray:
        """Force in the plane (n, 2), pN, with which each bond by itself pulls its membrane node."""

    @abstractmethod
    def carry(self, load: Callable[[Configuration], np.ndarray]) -> None:
        """Let the bonds carry `load(s)` (n, 2 or 3), pN, besides their own."""
