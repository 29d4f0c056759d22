"""`Plane`: cells with a membrane on a flat network of fibres, or on none."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from itertools import product

import numpy as np

from cellsys.drawable import draw_by
from cellsys.effects.matrix import Drag
from cellsys.effects.protocol import CellBody, Effect, check_parameters
from cellsys.errors import SceneError
from cellsys.geometry.membrane import sphere
from cellsys.geometry.network import FibreNetwork
from cellsys.mechanics.crawler import Crawler
from cellsys.mechanics.spreading import CellSpec, SpreadingSystem, build_spreading
from cellsys.scene.compatibility import check_effects
from cellsys.scene.headings import S, heading_scenes, turning
from cellsys.scene.memory import MemoryNeed, plane_memory, plane_words
from cellsys.scene.parts import CellScene
from cellsys.scene.plan import ScenePlan
from cellsys.scene.registry import EFFECTS
from cellsys.scene.steppers import BySystem, SceneStepper, stepper_of
from cellsys.trajectory import Trajectory

START_GAP = 0.05  # um between the lowest point of a cell and the top of the matrix
SCATTER = 2.0  # um that other starts lie beside the scene's place, along each axis
_MOST_STEPS = 1e9  # at 1 ms each, which only the smallest scenes need, twelve days
_RADIUS = (0.01, 1e3)


class Plane:
    """What every matrix under cells with a membrane has, a `MatrixKind` but for its network.

    A matrix of your own is a frozen dataclass of parameters (`cellsys.effects.parameter`)
    that derives from this one, with a `kind` of its own, `network`, and `outside` where cells may
    not stand everywhere.
    """

    @property
    def kind(self) -> str:
        """What a scene file calls it, in matrix.kind."""
        return "none"

    @property
    def flat(self) -> bool:
        """Whether cells lie on it."""
        return True

    def __post_init__(self) -> None:
        if dataclasses.is_dataclass(self):
            check_parameters(self)

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"a matrix of kind {self.kind}"

    @property
    def node_count(self) -> int:
        """Number of nodes of the network; found by building it, unless a kind knows before."""
        network = self.network(0)
        return 0 if network is None else len(network.position)

    @property
    def reach(self) -> float:
        """Radius of a circle about the middle, within which training puts its loads, um."""
        network = self.network(0)
        return 0.0 if network is None else float(np.hypot(*network.position[:, :2].T).max())

    def network(self, seed: int) -> FibreNetwork | None:
        """Nodes and fibres; `seed` is that of the scene.

        `Disc` holds any flat network; beyond its `radius` from the middle nothing adheres.
        """
        return None

    def outside(self, cell: CellScene) -> str | None:
        """Why a cell does not lie on the network, ending in the cure; None where it does."""
        return None

    def around(self, scene: ScenePlan) -> FibreNetwork | None:
        """The network of a scene, with what its cells make of it."""
        return self.network(scene.seed)

    def centre(self, cell: CellScene) -> tuple[float, float, float]:
        """Where the middle of a cell starts, um: on the matrix."""
        return (cell.position[0], cell.position[1], cell.radius + START_GAP)

    def build(self, scene: ScenePlan) -> SpreadingSystem:
        """The full-order system: only the effects that the scene names."""
        matrix = self.around(scene)
        effects = {n: e for n, e in _ordered(scene.effects) if e.acts_on != "cell"}
        cells = []
        for k, cell in enumerate(scene.membranes, start=1):
            body = CellBody(f"cell{k}", sphere(cell.radius, self.centre(cell)), cell.heading)
            every = _ordered({**scene.effects, **cell.effects})
            own = {n: e for n, e in every if e.acts_on == "cell"}
            cells.append(CellSpec(body, own, cell.commands or scene.commands))
        drag = scene.effects["drag"]
        if not isinstance(drag, Drag):
            raise SceneError(f"effects.drag must be a Drag, got a {type(drag).__name__}")
        return build_spreading(tuple(cells), matrix, effects, drag)

    def place_cells(self, scene: ScenePlan) -> None:
        """Refuse cells that are too small or large, reach outside, or overlap."""
        for i, cell in enumerate(scene.membranes):
            if not _RADIUS[0] <= cell.radius <= _RADIUS[1]:
                raise SceneError(
                    f"cells[{i}].radius must be > 0 um, in [{_RADIUS[0]:g}, {_RADIUS[1]:g}] um, "
                    f"got {cell.radius!r}"
                )
            if self.flat and (len(cell.position) > 2 or cell.elevation != 0.0):
                raise SceneError(
                    f"cells[{i}] has a place or a polarity out of the plane, and {self.title} is "
                    "flat; give position = [x, y] and no elevation, or take matrix.kind = 'gel'"
                )
            why = self.outside(cell)
            if why is not None:
                raise SceneError(f"cells[{i}] {why}")
        _check_overlaps(scene.membranes)

    def start_elsewhere(self, scene: ScenePlan, rng: np.random.Generator) -> tuple[CellScene, ...]:
        """Every cell with a drawn heading, all of them together up to `SCATTER` um away."""
        shift = rng.uniform(-SCATTER, SCATTER, 2)
        return tuple(
            dataclasses.replace(
                c,
                polarity=float(rng.uniform(-np.pi, np.pi)),
                position=(float(c.position[0] + shift[0]), float(c.position[1] + shift[1])),
            )
            for c in scene.membranes
        )

    def train(self, scene: S) -> tuple[list[S], list[S]]:
        """Scenes of commanded headings; see `training_scenes`."""
        return heading_scenes(scene, self.reach)

    def turn(
        self, scene: S, n: int, *, seed: int, loaded: bool, scatter: float, label: str
    ) -> list[S]:
        """Scenes of turning commands; see `turning_scenes`."""
        return turning(scene, n, self.reach, seed=seed, loaded=loaded, scatter=scatter, label=label)

    def draw(self, run: Trajectory, ax: object = None, *, k: int = -1) -> object:
        """Horizontal displacement of the surface at sample k."""
        rest, u = run.geometry["matrix.rest"], run.block("matrix.displacement")
        error = run.error_of("matrix.displacement")
        return draw_by("displacement_field", rest, u[k], ax=ax, error=error)

    def refuse(self, scene: ScenePlan, use: str = "run") -> None:
        """Refuse steps without end, crawlers, and effects that contradict each other."""
        if use != "run":
            return
        plan = scene.training
        for name, span in (("duration", scene.duration), ("training.duration", plan.duration)):
            if span / scene.step > _MOST_STEPS:
                raise SceneError(
                    f"{name} / step = {span / scene.step:.3g} steps, more than {_MOST_STEPS:.0e}, "
                    "which take months; shorten the run or lengthen the step"
                )
        if any(isinstance(cell, Crawler) for cell in scene.cells):
            raise SceneError("a Crawler lives on a chain; its matrix must be a ChainScene")
        if not scene.cells and scene.matrix is None:
            raise SceneError("a scene needs [[cells]] or a [matrix]")
        if "drag" not in scene.effects:
            raise SceneError(
                "effects.drag is missing: without drag nothing has a rate; add drag = {}"
            )
        for effects in (scene.effects, *(c.effects for c in scene.membranes)):
            for name, effect in effects.items():
                why = effect.refusal(self.kind)
                if why is not None:
                    raise SceneError(
                        f"effects.{name} has no meaning with matrix.kind = {self.kind!r}: {why}"
                    )
        on_matrix = scene.matrix is not None
        check_effects(scene.effects, [c.effects for c in scene.membranes], on_matrix)
        told = scene.commands.heading or scene.commands.amplitude
        if told and "lamellipodium" not in scene.effects:
            raise SceneError(
                "commands steer the lamellipodium, and effects.lamellipodium is missing"
            )

    def method(self, scene: ScenePlan) -> SceneStepper | BySystem:
        """The stepper that the scene names, by default LinearlyImplicit."""
        return stepper_of(scene)

    def memory(self, scene: ScenePlan, *, on_disk: bool = True, run: bool = True) -> MemoryNeed:
        """By the number of nodes, cells and laws; see `plane_memory`."""
        return plane_memory(scene, self.node_count, on_disk=on_disk, run=run)

    def words(self, scene: ScenePlan) -> tuple[str, str]:
        """The scene in words, and what makes it smaller."""
        return plane_words(scene, self.node_count, "make the matrix smaller")


class FreeMembranes(Plane):
    """Cells on nothing."""

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return "no matrix"


NO_MATRIX = FreeMembranes()


def _ordered(effects: Mapping[str, Effect]) -> list[tuple[str, Effect]]:
    """Effects in the registry's order, so that one scene has one layout of x and eta.

    A scene read back from a run folder names its effects in another order than its file did.
    """
    return sorted(effects.items(), key=lambda item: EFFECTS.place(item[0]))


def _check_overlaps(cells: tuple[CellScene, ...]) -> None:
    """Every cell against those in the cubes around its own, as wide as two radii."""
    wide = 2.0 * max((c.radius for c in cells), default=1.0)
    cubes: dict[tuple[float, float, float], list[int]] = {}
    steps = tuple(product((-1, 0, 1), repeat=3))
    for i, a in enumerate(cells):
        x, y, z = (float(v) // wide for v in a.centre)
        near = [
            found for p, q, r in steps if (found := cubes.get((x + p, y + q, z + r))) is not None
        ]
        for j in sorted(j for found in near for j in found):
            b = cells[j]
            gap = float(np.hypot.reduce(a.centre - b.centre))
            if gap < a.radius + b.radius:
                raise SceneError(
                    f"cells[{j}] and cells[{i}] overlap: centres {gap:.3g} um apart, radii "
                    f"{b.radius:g} + {a.radius:g} um; move them apart"
                )
        cubes.setdefault((x, y, z), []).append(i)
