"""Noise: thermal forces of a given temperature on every node that has a drag."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.effects.protocol import (
    Configuration,
    Effect,
    Element,
    JunctionArray,
    Port,
    Site,
    parameter,
)
from cellsys.effects.streams import stream
from cellsys.system import Block, Event

BOLTZMANN = 1.380649e-5  # pN um/K, exact (SI 2019)


@dataclass(frozen=True)
class Noise(Effect):
    """White thermal force of every drag C, <F F> = 2 k_B T C delta(t) (fluctuation-dissipation).

    Over a step dt the force is constant, sqrt(2 k_B T C/dt) times a normal number, and enters u.
    Implicit Euler keeps k_B T/(1 + dt k/(2 C)) in a spring k instead of k_B T: use a step well
    below C/k where the fluctuations themselves are asked for.
    """

    name: ClassVar[str] = "noise"
    acts_on: ClassVar[str] = "scene"
    active: ClassVar[bool] = True
    not_on: ClassVar[dict[str, str]] = {
        "chain": "its switches are found by their roots, which a random force does not have"
    }
    temperature: float = parameter(
        "310 K",
        "K",
        least=0.0,
        source="body temperature [notes: mechanics, noise]",
        about="absolute temperature",
    )

    @property
    def outside_work(self) -> str:
        return "the medium gives the random forces"

    def elements(self, site: Site) -> tuple[Element, ...]:
        return tuple(_NoiseElement(self, array) for array in site.arrays)


class _NoiseElement(Element):
    def __init__(self, effect: Noise, array: JunctionArray) -> None:
        self.array, self.drag = array.name, array.drag
        self.name = f"{array.name}.{effect.name}"
        self.outside = effect.outside_work
        self.force_block = f"{array.name}.thermal_force"
        self.inputs = (Port(array.name, self.name),)
        self.internal = (
            Block(self.force_block, array.drag.shape, "pN", role=array.block.role, kind="label"),
        )
        moving = np.where(np.isfinite(array.drag), array.drag, 0.0)
        self.scale = np.sqrt(2.0 * BOLTZMANN * effect.temperature * moving)

    def force(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        out[0][:] = s.internal[self.force_block]

    def advance(self, s: Configuration, end: Configuration, dt: float) -> None:
        end.internal[self.force_block][:] = s.internal[self.force_block]

    def between_steps(
        self, s: Configuration, dt: float, rng: np.random.Generator
    ) -> tuple[Event, ...]:
        own = stream(rng, self.name, s.t, dt)
        s.internal[self.force_block][:] = (
            self.scale / np.sqrt(dt) * own.standard_normal(self.scale.shape)
        )
        return ()
