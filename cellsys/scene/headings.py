"""Open-loop scenes of cells in a plane: constant headings, turning ones, loads on the matrix."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from cellsys.effects.commands import Commands, History
from cellsys.effects.protocol import Effect
from cellsys.errors import ParameterError
from cellsys.scene.parts import Training
from cellsys.scene.plan import ScenePlan
from cellsys.scene.registry import EFFECTS

S = TypeVar("S", bound=ScenePlan)
TURN = np.radians(80.0)  # greatest change of heading at once, rad
RAMP = 60.0  # s a change of heading or amplitude takes, of the order of 1/kappa
HOLD = (250.0, 500.0)  # s between changes
AMPLITUDE = (0.4, 1.6)
LOAD = (4000.0, 12000.0)  # pN, total force of one patch at its greatest
PATCHES = 4
PERIOD = (200.0, 600.0)  # s of a load


def heading_scenes(scene: S, reach: float) -> tuple[list[S], list[S]]:
    """Training and held-out scenes as `[training]` asks; see `training_scenes`.

    Loads lie within 0.65 of `reach` (um) of the middle.
    """
    plan = scene.training
    if plan.commands == "turning":
        seed, spread = scene.seed, plan.scatter
        plain = turning(scene, plan.runs - plan.loaded, reach, seed=seed, scatter=spread)
        loaded = turning(scene, plan.loaded, reach, seed=seed, loaded=True, scatter=spread)
        held = turning(scene, plan.held_out, reach, seed=seed + 1, scatter=spread, label="held out")
        return plain + loaded, held
    spacing = 2.0 * np.pi / plan.runs
    trained = [spacing * k for k in range(plan.runs)]
    between = [
        spacing * ((k * plan.runs) // max(plan.held_out, 1) + 0.5) for k in range(plan.held_out)
    ]

    def at(angle: float, label: str) -> S:
        commands = Commands(History((0.0,), (angle,)), scene.commands.amplitude)
        name = f"{scene.name}: {label} {np.degrees(angle):.1f} deg"
        return commanded(scene, commands, angle, name)

    return [at(a, "training") for a in trained], [at(a, "held out") for a in between]


def turning(
    scene: S,
    n: int,
    reach: float,
    *,
    seed: int,
    loaded: bool = False,
    scatter: float = 0.0,
    label: str = "training",
) -> list[S]:
    """Scenes with turning commands; see `turning_scenes`, and `heading_scenes` for `reach`."""
    if not 0.0 <= scatter < np.inf:
        raise ParameterError(f"scatter must be finite and >= 0 um, got {scatter!r}")
    scenes = []
    for k, root in enumerate(np.random.SeedSequence([seed, int(loaded)]).spawn(n)):
        rng = np.random.default_rng(root)
        cells = []
        for cell in scene.membranes:
            angle, commands = _turning(scene.training.duration, rng)
            x, y = (float(v) for v in cell.position + rng.uniform(-scatter, scatter, 2))
            cells.append(
                dataclasses.replace(cell, position=(x, y), polarity=angle, commands=commands)
            )
        name = f"{scene.name}: {label} {k + 1}{' loaded' if loaded else ''}"
        drawn = commanded(scene, Commands(), None, name)
        effects = dict(drawn.effects)
        if loaded:
            effects["external_load"] = _loads(scene, reach, rng)
        scenes.append(dataclasses.replace(drawn, cells=tuple(cells), effects=effects))
    return scenes


def commanded(scene: S, commands: Commands, angle: float | None, name: str) -> S:
    """The scene open loop under `commands`, with the duration and sampling of its training."""
    plan: Training = scene.training
    cells = scene.cells
    if angle is not None:
        cells = tuple(
            dataclasses.replace(c, polarity=angle, commands=None) for c in scene.membranes
        )
    return dataclasses.replace(
        scene,
        name=name,
        duration=plan.duration,
        sample=plan.sample,
        effects={n: e for n, e in scene.effects.items() if n != "polarity"},
        cells=cells,
        commands=commands,
    )


def _turning(duration: float, rng: np.random.Generator) -> tuple[float, Commands]:
    """Heading at the start, rad, and the commands."""
    start = rng.uniform(*HOLD)
    changes = [start]
    while changes[-1] < duration:
        changes.append(changes[-1] + rng.uniform(*HOLD))
    heading, amplitude = [rng.uniform(0.0, 2.0 * np.pi)], [rng.uniform(*AMPLITUDE)]
    for _ in changes[:-1]:
        heading.append(heading[-1] + rng.uniform(-TURN, TURN))
        amplitude.append(rng.uniform(*AMPLITUDE))
    drawn = Commands(_steps(changes[:-1], heading), _steps(changes[:-1], amplitude))
    return heading[0], drawn


def _steps(changes: list[float], values: list[float]) -> History:
    """Constant values joined by ramps that begin at `changes`."""
    times, knots = [0.0], [values[0]]
    for t, before, after in zip(changes, values, values[1:], strict=False):
        times += [t, t + RAMP]
        knots += [before, after]
    return History(tuple(times), tuple(knots))


def _loads(scene: ScenePlan, reach: float, rng: np.random.Generator) -> Effect:
    kind: Callable[..., Effect] = EFFECTS["external_load"]
    within = 0.65 * reach
    patches: list[dict[str, object]] = []
    for _ in range(PATCHES):
        radius, angle = within * np.sqrt(rng.uniform()), rng.uniform(0.0, 2.0 * np.pi)
        period, phase = rng.uniform(*PERIOD), rng.uniform(0.0, 2.0 * np.pi)
        # Knots every twelfth of a period; it starts at rest like the cell does.
        times = np.arange(0.0, scene.training.duration + period / 12, period / 12)
        wave = np.sin(2.0 * np.pi * times / period + phase) * np.minimum(1.0, times / 100.0)
        patches.append(
            dict(
                force=rng.uniform(*LOAD),
                direction=rng.uniform(0.0, 2.0 * np.pi),
                x=radius * np.cos(angle),
                y=radius * np.sin(angle),
                history=History(tuple(times), tuple(wave)),
            )
        )
    first, *more = patches
    return kind(**first, patches=tuple(kind(**further) for further in more))
