"""A push of the leading edge under commands: what both forms of the lamellipodium share."""

from __future__ import annotations

import numpy as np

from cellsys.effects.commands import Commands
from cellsys.effects.protocol import CellBody, Configuration, Effect, Element
from cellsys.system import Block


class ProtrusionLaw(Effect):
    """An effect with the parameters of a protrusion [notes: mechanics, lamellipodium]."""

    force: float  # pN
    height: float  # um
    edge: float
    full: float
    downward: float
    range: float  # um
    half: float


class CommandedPush(Element):
    """An element that pushes along the polarity of a cell, by a commanded amplitude."""

    def __init__(self, effect: ProtrusionLaw, cell: CellBody, commands: Commands) -> None:
        self.effect, self.commands = effect, commands
        self.name = f"{cell.name}.{effect.name}"
        self.array = cell.name
        self.outside = effect.outside_work
        self.commanded = (
            Block(f"{cell.name}.heading", (3,), "1", role="controller", kind="internal"),
            Block(f"{cell.name}.amplitude", (), "1", role="controller", kind="internal"),
        )
        self.polarity = f"{cell.name}.polarity"

    def amplitude(self, t: float) -> float:
        """Commanded factor on the force at time t."""
        history = self.commands.amplitude
        return 1.0 if history is None else history(t)

    def observe(self, s: Configuration) -> dict[str, np.ndarray]:
        return {"amplitude": np.asarray(self.amplitude(s.t))}

    def stop_points(self) -> tuple[float, ...]:
        return self.commands.stop_points()
