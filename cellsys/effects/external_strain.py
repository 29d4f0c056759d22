"""External strain: part of the matrix follows a prescribed displacement history."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.effects.commands import History
from cellsys.effects.matrix import MATRIX
from cellsys.effects.patch import MatrixPatch
from cellsys.effects.protocol import Configuration, Element, Held, Site, parameter
from cellsys.errors import SceneError
from cellsys.geometry.network import FibreNetwork, offsets


@dataclass(frozen=True, kw_only=True)
class ExternalStrain(MatrixPatch):
    """Nodes that follow u(t) = h(t) (displacement + strain (e . (r - c))) e, a flow source.

    e is the direction in the plane, r a node's rest position, c the centre of the patch (0 for the
    rim), h the history. The nodes are held: no force moves them, and those they pull on feel the
    fibres between.
    """

    name: ClassVar[str] = "external_strain"
    not_on: ClassVar[dict[str, str]] = {"chain": "the walls of a chain do not move"}
    region: str = parameter(
        "rim",
        choices=("rim", "patch"),
        source="scene [notes: matrix, external load and strain]",
        about="nodes that are moved",
    )
    strain: float = parameter(
        "0.05",
        source="scene [notes: matrix, external load and strain]",
        about="stretch along the direction",
    )
    displacement: float = parameter(
        "0 um",
        "um",
        source="scene [notes: matrix, external load and strain]",
        about="shift of all its nodes",
    )
    history: History = History((0.0, 100.0), (0.0, 1.0))

    @property
    def outside_work(self) -> str:
        return "what holds the moved nodes takes up their forces"

    def elements(self, site: Site) -> tuple[Element, ...]:
        return (_StrainElement(self, site.network),)


class _StrainElement(Element):
    def __init__(self, effect: ExternalStrain, disc: FibreNetwork) -> None:
        self.effect = effect
        self.outside = effect.outside_work
        self.name = f"{MATRIX}.{effect.name}"
        center = np.zeros(2) if effect.region == "rim" else np.array([effect.x, effect.y])
        offset = offsets(disc, *center)
        nodes = disc.clamped
        if effect.region == "patch":
            nodes = np.linalg.norm(offset, axis=1) <= effect.radius
        if not nodes.any() and effect.region == "rim":
            raise SceneError(
                "external_strain.region = 'rim' moves the clamped nodes of the matrix, and it has "
                "none; set matrix.ends = 'clamped', or move a patch"
            )
        if not nodes.any():
            raise SceneError(
                f"external_strain at ({effect.x:g}, {effect.y:g}) um, radius {effect.radius:g} um, "
                "covers no matrix node; move the patch inside the matrix or enlarge it"
            )
        along = np.array([np.cos(effect.direction), np.sin(effect.direction), 0.0])
        reach = effect.displacement + effect.strain * (offset[nodes, :2] @ along[:2])
        self.nodes, self.pattern = nodes, reach[:, None] * along
        self.holds = (Held(MATRIX, nodes),)

    def place(self, t: float) -> tuple[np.ndarray, ...]:
        return (self.effect.history(t) * self.pattern,)

    def flows(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        # At the end of a step: the mean rate over it. Elsewhere: the rate that follows.
        rate = s.cache.get(self.name)
        out[0][self.nodes] = (self._slope(s.t) if rate is None else rate) * self.pattern

    def advance(self, s: Configuration, end: Configuration, dt: float) -> None:
        history = self.effect.history
        end.nodes[MATRIX][self.nodes] = history(s.t + dt) * self.pattern
        end.cache[self.name] = (history(s.t + dt) - history(s.t)) / dt

    def _slope(self, t: float) -> float:
        times, values = self.effect.history.times, self.effect.history.values
        k = bisect_right(times, t)
        if k in (0, len(times)):
            return 0.0
        return (values[k] - values[k - 1]) / (times[k] - times[k - 1])

    def stop_points(self) -> tuple[float, ...]:
        return self.effect.history.times
