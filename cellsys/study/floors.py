"""What no model can be better than: runs with a shifted start, and the same commands elsewhere."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from cellsys.cell import EquivariantModel, realisation_floor
from cellsys.cell.records import read_records
from cellsys.effects.commands import Commands
from cellsys.samples import snapshots
from cellsys.scene import Scene
from cellsys.trajectory import Trajectory, cell_names

SHIFTS = {"start shifted by 5 nm": 0.005, "start shifted by 100 nm": 0.1}
ELSEWHERE = (-1.5, 1.0)  # um, where the same commands are given again, turned
TURN = 2.0  # rad


def floor_scenes(held: Sequence[Scene]) -> list[Scene]:
    """The first held-out scene with its start shifted, then at another place and turned."""
    first = held[0]
    near = [_moved(first, (shift, 0.0), 0.0) for shift in SHIFTS.values()]
    return [*near, _moved(first, ELSEWHERE, TURN)]


def measured_floors(
    held: Trajectory, runs: Sequence[Trajectory], model: EquivariantModel | None
) -> dict[str, float]:
    """Relative differences of the cell's nodes; the last run needs a model's representation."""
    (cell,) = cell_names(held.states)
    name = f"{cell}.position"
    x = held.block(name)
    moved = float(np.linalg.norm(x - x[0]))
    out = {
        label: float(np.linalg.norm(run.block(name) - x)) / moved
        for label, run in zip(SHIFTS, runs, strict=False)
    }
    if model is not None:
        port = model.representation.port
        first, again = (read_records(snapshots([r]), model.dt, port)[0] for r in (held, runs[-1]))
        floor = realisation_floor(model, [(first, again)])
        out["realisation, cells"] = floor["cells"]
        out["realisation, loads"] = floor["loads"]
    return out


def _moved(scene: Scene, shift: tuple[float, float], turn: float) -> Scene:
    (cell,) = scene.membranes
    place = (cell.position[0] + shift[0], cell.position[1] + shift[1])
    polarity = cell.polarity + turn
    return dataclasses.replace(
        scene,
        name=f"{scene.name}, moved by {shift[0]:g}, {shift[1]:g} um, turned by {turn:g} rad",
        commands=_turned(scene.commands, turn),
        cells=(
            dataclasses.replace(
                cell,
                position=place,
                polarity=polarity,
                commands=None if cell.commands is None else _turned(cell.commands, turn),
            ),
        ),
    )


def _turned(commands: Commands, turn: float) -> Commands:
    if commands.heading is None or turn == 0.0:
        return commands
    values = tuple(v + turn for v in commands.heading.values)
    return dataclasses.replace(
        commands, heading=dataclasses.replace(commands.heading, values=values)
    )
