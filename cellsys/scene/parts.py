"""What a scene is put together from: its cells, spots and slopes of stiffness, its training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from cellsys.arguments import checked
from cellsys.effects.commands import Commands
from cellsys.effects.protocol import Effect
from cellsys.errors import SceneError
from cellsys.scene.sampling import intervals


@dataclass(frozen=True)
class Inclusion:
    """A round stiff (factor > 1) or soft spot: centre and radius in um."""

    center: tuple[float, float]
    radius: float
    factor: float


@dataclass(frozen=True)
class Gradient:
    """Stiffness rising along `direction` (rad) by the share `per_um` of its mean per um."""

    direction: float
    per_um: float


@checked
@dataclass(frozen=True, kw_only=True)
class CellScene:
    """One cell: position of its centre (um), polarity angle (rad), radius (um).

    The position is one in the plane, of a cell in a gel one in space (0 along z where it is left
    out); its polarity points `elevation` (rad) out of the plane.
    """

    position: tuple[float, float] | tuple[float, float, float] = (0.0, 0.0)
    polarity: float = 0.0
    elevation: float = 0.0
    radius: float = 8.0
    effects: Mapping[str, Effect] = field(default_factory=dict)
    commands: Commands | None = None

    @property
    def centre(self) -> np.ndarray:
        """Of the cell in space (3,), um; z is 0 where the position is one in the plane."""
        return np.array([*self.position, 0.0][:3])

    @property
    def heading(self) -> np.ndarray:
        """Unit vector (3,) of the polarity."""
        across = np.cos(self.elevation)
        return np.array(
            [
                np.cos(self.polarity) * across,
                np.sin(self.polarity) * across,
                np.sin(self.elevation),
            ]
        )


@checked
@dataclass(frozen=True, kw_only=True)
class Training:
    """The ensemble a reduced model is learned from.

    `runs` runs and `held_out` further ones, each of `duration` s sampled every `sample` s.
    `commands` "constant": headings spread over the circle, the held-out ones between them;
    "turning": turning headings and varying amplitudes drawn from the scene's seed, the last
    `loaded` training runs with loads on the matrix besides, every cell up to `scatter` um away
    from its place along each axis.
    """

    runs: int = 8
    held_out: int = 2
    duration: float = 1500.0
    sample: float = 5.0
    commands: str = "constant"
    loaded: int = 0
    scatter: float = 0.0

    def __post_init__(self) -> None:
        intervals(self.duration, self.sample, "training.")
        if self.commands not in ("constant", "turning"):
            raise SceneError(
                f"training.commands must be 'constant' or 'turning', got {self.commands!r}"
            )
        if not 0 <= self.loaded <= self.runs:
            raise SceneError(
                f"training.loaded must be between 0 and runs = {self.runs}, got {self.loaded}"
            )
        if not (np.isfinite(self.scatter) and self.scatter >= 0):
            raise SceneError(f"training.scatter must be >= 0 um, got {self.scatter!r}")
        if (self.loaded or self.scatter) and self.commands == "constant":
            raise SceneError(
                "training.loaded and training.scatter need training.commands = 'turning'"
            )
