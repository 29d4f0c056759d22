"""What external loads and strains share: a round patch of the matrix and a direction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cellsys.effects.protocol import Effect, parameter


@dataclass(frozen=True, kw_only=True)
class MatrixPatch(Effect):
    """An effect from outside on the matrix nodes of a round patch, along one direction."""

    acts_on: ClassVar[str] = "matrix"
    active: ClassVar[bool] = True
    direction: float = parameter(
        "0 deg",
        "rad",
        source="scene [notes: matrix, external load and strain]",
        about="angle in the plane",
    )
    x: float = parameter(
        "0 um",
        "um",
        source="scene [notes: matrix, external load and strain]",
        about="centre of the patch",
    )
    y: float = parameter(
        "0 um",
        "um",
        source="scene [notes: matrix, external load and strain]",
        about="centre of the patch",
    )
    radius: float = parameter(
        "5 um",
        "um",
        above=0.0,
        source="scene [notes: matrix, external load and strain]",
        about="radius of the patch",
    )
