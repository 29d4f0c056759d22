"""The disc of fibres: `MatrixScene`."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import SceneError
from cellsys.geometry.disc import DENSITY, Disc, disc
from cellsys.scene.memory import plane_words
from cellsys.scene.parts import CellScene, Gradient, Inclusion
from cellsys.scene.plan import ScenePlan
from cellsys.scene.plane import Plane

# From a speck to a metre, from a liquid to diamond: beyond, arrays of bins and stiffnesses
# overflow.
_MATRIX = {
    "diameter": (0.01, 1e6, "um"),
    "thickness": (1e-3, 1e4, "um"),
    "modulus": (1e-9, 1e12, "pN/um^2"),
}
_SPARSEST = 100.0  # um between neighbouring nodes: far apart, no cell touches any


@checked
@dataclass(frozen=True, kw_only=True)
class MatrixScene(Plane):
    """The matrix: a disc of fibres; lengths um, modulus pN/um^2 (Pa)."""

    kind: str = "disc"
    diameter: float = 60.0
    thickness: float = 2.0
    modulus: float = 5000.0
    nodes: int | None = None
    seed: int | None = None
    inclusion: Inclusion | None = None
    gradient: Gradient | None = None

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"a disc of {self.diameter:g} um"

    @property
    def node_count(self) -> int:
        """Number of nodes that the scene asks for."""
        if self.nodes is not None:
            return self.nodes
        return round(DENSITY * np.pi * (0.5 * self.diameter) ** 2 * self.thickness)

    @property
    def reach(self) -> float:
        """Radius, um."""
        return 0.5 * self.diameter

    def network(self, seed: int) -> Disc:
        """The disc with its inclusion and its gradient; `seed` where it has none of its own."""
        built = disc(
            0.5 * self.diameter,
            self.modulus,
            thickness=self.thickness,
            n_nodes=self.nodes,
            seed=seed if self.seed is None else self.seed,
        )
        if self.inclusion is None and self.gradient is None:
            return built
        middle = 0.5 * (built.position[built.fibres[:, 0]] + built.position[built.fibres[:, 1]])
        factor = np.ones(len(middle))
        if self.gradient is not None:
            along = np.array([np.cos(self.gradient.direction), np.sin(self.gradient.direction)])
            factor *= 1.0 + self.gradient.per_um * (middle[:, :2] @ along)
        if self.inclusion is not None:
            inside = np.hypot(*(middle[:, :2] - self.inclusion.center).T) < self.inclusion.radius
            factor[inside] *= self.inclusion.factor
        return dataclasses.replace(built, stiffness=factor * built.stiffness)

    def outside(self, cell: CellScene) -> str | None:
        """Why a cell does not lie on the disc; None where it does."""
        reach = float(np.hypot(*cell.position)) + cell.radius
        if reach <= 0.5 * self.diameter:
            return None
        return (
            f"reaches {reach:.3g} um from the centre, outside the disc of radius "
            f"{0.5 * self.diameter:.3g} um; move it or enlarge the matrix"
        )

    def place_cells(self, scene: ScenePlan) -> None:
        """Refuse a disc out of all proportion, then cells as `Plane` does."""
        for name, (least, most, unit) in _MATRIX.items():
            if not least <= getattr(self, name) <= most:
                raise SceneError(
                    f"matrix.{name} must be > 0, in [{least:g}, {most:g}] {unit}, "
                    f"got {getattr(self, name)!r}"
                )
        nodes = self.nodes
        if nodes is not None and nodes > 0 and nodes < (self.diameter / _SPARSEST) ** 2:
            raise SceneError(
                f"matrix.nodes = {nodes} leaves {self.diameter / np.sqrt(nodes):.3g} um "
                f"between nodes, more than {_SPARSEST:g} um; ask for more or leave it out"
            )
        if self.seed is not None and self.seed < 0:
            raise SceneError(f"matrix.seed must be >= 0, got {self.seed}")
        super().place_cells(scene)

    def words(self, scene: ScenePlan) -> tuple[str, str]:
        """The scene in words, and what makes it smaller."""
        return plane_words(scene, self.node_count, "make the disc smaller")
