"""External loads on patches of the matrix."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.effects.commands import History
from cellsys.effects.matrix import MATRIX
from cellsys.effects.patch import MatrixPatch
from cellsys.effects.protocol import Configuration, Element, Port, Site, parameter
from cellsys.errors import SceneError
from cellsys.geometry.network import FibreNetwork, offsets


@dataclass(frozen=True, kw_only=True)
class ExternalLoad(MatrixPatch):
    """A force history spread over the surface nodes of a round patch of the matrix.

    In a gel the patch is a ball about (x, y, 0).

    `patches` are further loads of the same kind that act together with this one.
    """

    name: ClassVar[str] = "external_load"
    not_on: ClassVar[dict[str, str]] = {"chain": "a chain is loaded by its cells only"}
    force: float = parameter(
        "1000 pN",
        "pN",
        source="scene [notes: matrix, external load and strain]",
        about="total force at factor 1",
    )
    history: History = History((0.0,), (1.0,))
    patches: tuple[ExternalLoad, ...] = ()

    @property
    def outside_work(self) -> str:
        return "what pulls on the matrix from outside"

    def elements(self, site: Site) -> tuple[Element, ...]:
        return (_LoadElement(self, site.network),)


class _LoadElement(Element):
    def __init__(self, effect: ExternalLoad, disc: FibreNetwork) -> None:
        self.effect = effect
        self.name = f"{MATRIX}.{effect.name}"
        self.outside = effect.outside_work
        self.inputs = (Port(MATRIX, self.name),)
        self.parts = tuple((p, _pattern(p, disc)) for p in (effect, *effect.patches))

    def force(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        out[0][:] = 0.0
        for patch, pattern in self.parts:
            out[0][:] += patch.history(s.t) * pattern

    def stop_points(self) -> tuple[float, ...]:
        return tuple(t for patch, _ in self.parts for t in patch.history.times)


def _pattern(patch: ExternalLoad, disc: FibreNetwork) -> np.ndarray:
    """Nodal forces (n, 3) of one patch at factor 1."""
    away = offsets(disc, patch.x, patch.y)
    weight = np.clip(1.0 - (away**2).sum(axis=1) / patch.radius**2, 0.0, None)
    weight[disc.clamped] = 0.0
    mask = np.zeros(len(weight))
    mask[disc.surface] = 1.0
    weight *= mask
    if not weight.any():
        raise SceneError(
            f"external_load at ({patch.x:g}, {patch.y:g}) um, radius {patch.radius:g} um, "
            "covers no free matrix node; move it inside the matrix or enlarge it"
        )
    unit = np.array([np.cos(patch.direction), np.sin(patch.direction), 0.0])
    return patch.force * (weight / weight.sum())[:, None] * unit
