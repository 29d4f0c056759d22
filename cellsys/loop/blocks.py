"""The parts of a loop as blocks of python-control, and their diagrams.

Signals: p_x, p_y, p_z polarity; d_x, d_y, d_z sensed direction; z[i] latent states; commands by
their names in the model, dots as underscores; ``one``, which is 1, what the offset of the plant
is driven by. With several cells each name begins with that of its cell: cell2_p_x.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np

from cellsys.loop.polarity import PolarityLaw
from cellsys.model.plant import ONE
from cellsys.model.sensor_block import latent_names, sensor_block, vector_names
from cellsys.state_space import block, joined

if TYPE_CHECKING:
    from control import InterconnectedSystem, NonlinearIOSystem, StateSpace


def command_block(
    commands: Callable[[np.ndarray], np.ndarray],
    names: Sequence[str],
    cells: Sequence[str] = ("",),
) -> NonlinearIOSystem:
    """What drives the plant: commands (K, n_c) of polarities p (K, 3), and ``one``."""

    def output(t: float, x: np.ndarray, u: np.ndarray, params: Mapping[str, float]) -> np.ndarray:
        p = u.reshape(len(cells), 3)
        # python-control asks once with nothing connected: no heading, no command.
        headed = np.hypot(p[:, 0], p[:, 1]) > 0
        values = commands(np.where(headed[:, None], p, [1.0, 0.0, 0.0]))
        return np.append(np.where(headed[:, None], values, 0.0).ravel(), 1.0)

    return block("commands", vector_names("p", cells), [*names, ONE], output)


def loop_diagram(
    plant: StateSpace,
    controller: NonlinearIOSystem,
    sense: Callable[[np.ndarray], np.ndarray],
    commands: Callable[[np.ndarray], np.ndarray],
    *,
    cells: Sequence[str] = ("",),
    order: int,
    more: Sequence[str] = (),
) -> InterconnectedSystem:
    """Plant, controllers, commands and sensors of K cells, closed; no inputs from outside.

    Its states are those of the plant, then p; its outputs z, p, d and `more` of the plant's.
    """
    names = [name for name in plant.input_labels if name != ONE]
    parts = [
        plant,
        controller,
        command_block(commands, names, cells),
        sensor_block(sense, order, cells),
    ]
    shown = [*latent_names(order, cells), *vector_names("p", cells), *vector_names("d", cells)]
    return joined("loop", parts, [*shown, *more])


class SteppedPlant(Protocol):
    """The plant of a scheduled loop; see `ScheduledSystem`."""

    def moved(self, z: np.ndarray, angles: np.ndarray, t: float, amplitude: float) -> np.ndarray:
        """z after a step under these headings."""


def scheduled_diagram(
    plant: SteppedPlant,
    law: PolarityLaw,
    direction: Callable[[np.ndarray], np.ndarray],
    *,
    order: int,
    dt: float,
    amplitude: float | None,
    unit: bool = True,
) -> InterconnectedSystem:
    """A loop whose plant steps by its own clock, step for step that of `ScheduledSystem`.

        d = sensed(z)              q = p turned by dt/2 towards d       z~ = plant(z, q)
        e = sensed(z~)             g = (d + e)/|d + e|                  h = p turned by dt/2 to g
        z+ = plant(z, h)           p+ = p turned by dt towards g

    Parameters
    ----------
    amplitude : float or None
        Of every step; None: an input ``amplitude`` of the whole.
    unit : bool
        Whether sensed directions have length 1; of graded cues g is their plain mean.
    """
    z = latent_names(order)

    def moved(name: str, heading: str, states: bool) -> NonlinearIOSystem:
        def step(t: float, x: np.ndarray, u: np.ndarray, params: Mapping[str, float]) -> np.ndarray:
            now = x if states else u[4:]
            return plant.moved(now, np.arctan2(u[1:2], u[:1]), t, float(u[3]))

        inputs = [*vector_names(heading), "amplitude"]
        if states:
            return block(name, inputs, z, None, states=z, update=step, dt=dt)
        return block(name, [*inputs, *z], latent_names(order, name="z_ahead"), step)

    def half(name: str, towards: str, out: str) -> NonlinearIOSystem:
        def turn(t: float, x: np.ndarray, u: np.ndarray, params: Mapping[str, float]) -> np.ndarray:
            return law.step(u[:3], u[3:], 0.5 * dt)

        return block(name, [*vector_names("p"), *vector_names(towards)], vector_names(out), turn)

    def mean(t: float, x: np.ndarray, u: np.ndarray, params: Mapping[str, float]) -> np.ndarray:
        middle = 0.5 * (u[:3] + u[3:])
        if not unit:
            return middle
        size = float(np.linalg.norm(middle))
        return middle / size if size > 0 else u[:3]

    read = {"sensor": ("z", "d"), "sensor_ahead": ("z_ahead", "d_ahead")}
    parts = [
        moved("plant", "p_drive", True),
        renamed(law.block(dt=dt), {f"d_{a}": f"d_mean_{a}" for a in "xyz"}),
        *(
            sensor_block(direction, order, name=name, latent=latent, sensed=sensed)
            for name, (latent, sensed) in read.items()
        ),
        half("turn", "d", "p_middle"),
        moved("predictor", "p_middle", False),
        block("mean", [*vector_names("d"), *vector_names("d_ahead")], vector_names("d_mean"), mean),
        half("turn_to_mean", "d_mean", "p_drive"),
    ]
    if amplitude is not None:
        parts.append(constant_block("amplitude", amplitude))
    shown = [*z, *vector_names("p"), *vector_names("d")]
    return joined("loop", parts, shown, ["amplitude"] if amplitude is None else [])


def constant_block(signal: str, value: float) -> NonlinearIOSystem:
    """A source of one signal."""

    def output(t: float, x: np.ndarray, u: np.ndarray, params: Mapping[str, float]) -> np.ndarray:
        return np.array([value])

    return block(f"{signal}_source", [], [signal], output)


def renamed(system: NonlinearIOSystem, names: Mapping[str, str]) -> NonlinearIOSystem:
    """A block whose inputs are called otherwise."""
    system.update_names(inputs=[names.get(n, n) for n in system.input_labels])
    return system
