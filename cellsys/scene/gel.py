"""The gel of fibres around its cells: `GelScene`."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from cellsys.arguments import checked
from cellsys.drawable import draw_by
from cellsys.errors import DataError, ParameterError, SceneError
from cellsys.geometry.gel import FLOPPY, GRIP, MARGIN, Gel, depth_of, gel, volume_of
from cellsys.scene.headings import S
from cellsys.scene.memory import MemoryNeed, gel_memory, plane_words
from cellsys.scene.parts import CellScene
from cellsys.scene.plan import ScenePlan
from cellsys.scene.plane import SCATTER, Plane
from cellsys.scene.steppers import GEL_AUTO, STEPS, BySystem, SceneStepper, stepper_of
from cellsys.trajectory import Trajectory

DENSITY = 4000.0 / (0.25 * np.pi * 40.0**2 * 100.0)  # nodes per um^3: a spacing of 3.2 um
_RANGES = {
    "length": (0.1, 1e5, "um"),
    "modulus": (1e-9, 1e12, "pN/um^2"),
    "coordination": (3.0, 20.0, "fibres per node"),
}
_ACROSS = (0.1, 1e5)
_FEWEST = 50
_NO_TRAINING = (
    "commanded headings train the models of cells on a disc, and nothing is learned from a scene "
    "in a gel; run it with cs.run_scene"
)


@checked
@dataclass(frozen=True, kw_only=True)
class GelScene(Plane):
    """A gel of fibres, cells inside it: a cylinder or a box along x, lengths um, modulus Pa.

    `nodes` counts those of the gel without cells, by default `DENSITY` of them: the length of a
    fibre belongs to the material. `cavities` (x, y, z, radius) are empty places besides those of
    the cells. A cylinder has a `diameter` (40 um), a box a `width` and a `height`.
    """

    kind: str = "gel"
    shape: str = "cylinder"
    length: float = 100.0
    diameter: float | None = None
    width: float | None = None
    height: float | None = None
    modulus: float = 500.0
    nodes: int | None = None
    coordination: float = 9.0
    ends: str = "clamped"
    cavities: tuple[tuple[float, float, float, float], ...] = ()
    seed: int | None = None

    def __post_init__(self) -> None:
        for name, options in (("shape", ("cylinder", "box")), ("ends", ("clamped", "free"))):
            if getattr(self, name) not in options:
                raise SceneError(
                    f"matrix.{name} must be {' or '.join(map(repr, options))}, got "
                    f"{getattr(self, name)!r}"
                )
        wrong = ("width", "height") if self.shape == "cylinder" else ("diameter",)
        for name in wrong:
            if getattr(self, name) is not None:
                raise SceneError(f"matrix.{name} is not a size of a {self.shape}; leave it out")
        for name, (least, most, unit) in _RANGES.items():
            if not least <= getattr(self, name) <= most:
                raise SceneError(
                    f"matrix.{name} must be in [{least:g}, {most:g}] {unit}, got "
                    f"{getattr(self, name)!r}"
                )
        for name, value in zip(("length", "width", "height"), self.size, strict=True):
            if not _ACROSS[0] <= value <= _ACROSS[1]:
                shown = "diameter" if self.shape == "cylinder" and name != "length" else name
                raise SceneError(
                    f"matrix.{shown} must be in [{_ACROSS[0]:g}, {_ACROSS[1]:g}] um, got {value!r}"
                )
        if self.ends == "clamped" and not self.length > 3.0 * GRIP:
            raise SceneError(
                f"matrix.length = {self.length:g} um leaves nothing between its clamped ends of "
                f"{GRIP:g} um each; lengthen it, or set ends = 'free'"
            )
        if self.seed is not None and self.seed < 0:
            raise SceneError(f"matrix.seed must be >= 0, got {self.seed}")
        if self.node_count < _FEWEST:
            raise SceneError(
                f"a gel of {self.node_count} nodes is too coarse; ask for at least {_FEWEST} "
                "(matrix.nodes, or a larger gel)"
            )
        for i, (*_, radius) in enumerate(self.cavities):
            if not radius > 0:
                raise SceneError(f"matrix.cavities[{i}].radius must be > 0 um, got {radius!r}")

    @property
    def flat(self) -> bool:
        """Cells lie in it."""
        return False

    @property
    def size(self) -> tuple[float, float, float]:
        """Along x, y, z, um."""
        if self.shape == "cylinder":
            across = 40.0 if self.diameter is None else self.diameter
            return self.length, across, across
        return (
            self.length,
            40.0 if self.width is None else self.width,
            40.0 if self.height is None else self.height,
        )

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        a, b, c = self.size
        told = f"{b:g} um" if self.shape == "cylinder" else f"{b:g} x {c:g} um"
        return f"a gel of {a:g} x {told}, {self.node_count} nodes"

    @property
    def node_count(self) -> int:
        """Number of nodes that the scene asks for."""
        if self.nodes is not None:
            return self.nodes
        return round(DENSITY * volume_of(self.shape, self.size))

    @property
    def reach(self) -> float:
        """Half of its length, um."""
        return 0.5 * self.length

    def network(self, seed: int) -> Gel:
        """The gel with its `cavities`; `seed` where it has none of its own."""
        return self._filled((), seed)

    def _filled(self, cells: tuple[CellScene, ...], seed: int) -> Gel:
        places = [(*(float(v) for v in c.centre), float(c.radius)) for c in cells]
        cavities = sorted({*self.cavities, *((p[0], p[1], p[2], p[3]) for p in places)})
        try:
            return gel(
                self.size,
                self.modulus,
                n_nodes=self.node_count,
                shape=self.shape,
                coordination=self.coordination,
                ends=self.ends,
                cavities=tuple(cavities),
                seed=seed if self.seed is None else self.seed,
            )
        except (DataError, ParameterError) as error:
            raise SceneError(f"matrix: {error}") from error

    def around(self, scene: ScenePlan) -> Gel:
        """The gel without the nodes inside the cells."""
        return self._filled(scene.membranes, scene.seed)

    def centre(self, cell: CellScene) -> tuple[float, float, float]:
        """Where the middle of a cell starts, um: in its cavity."""
        x, y, z = (float(v) for v in cell.centre)
        return x, y, z

    def control(self, scene: ScenePlan) -> GelScene:
        """The same gel, node by node: the cavities of the other cells stay, empty."""
        places = [(*self.centre(c), float(c.radius)) for c in scene.membranes]
        cavities = sorted({*self.cavities, *((p[0], p[1], p[2], p[3]) for p in places)})
        return dataclasses.replace(self, cavities=tuple(cavities))

    def outside(self, cell: CellScene) -> str | None:
        """Why a cell does not lie inside the gel; None where it does."""
        centre, needs = cell.centre, cell.radius + MARGIN
        depth = float(depth_of(self.shape, self.size, centre[None])[0])
        if depth < needs:
            return (
                f"reaches the lateral boundary of the gel: its centre is {depth:.3g} um inside and "
                f"it needs {needs:.3g} um; move it inward or widen the gel"
            )
        end = 0.5 * self.length - (GRIP if self.ends == "clamped" else 0.0)
        if abs(float(centre[0])) + needs > end:
            what = "the clamped ends" if self.ends == "clamped" else "an end"
            return (
                f"reaches {what} of the gel: |x| + radius = {abs(centre[0]) + needs:.3g} um, and "
                f"the gel is free up to {end:.3g} um; move it inward or lengthen the gel"
            )
        return None

    def start_elsewhere(self, scene: ScenePlan, rng: np.random.Generator) -> tuple[CellScene, ...]:
        """Every cell with a drawn heading, all together up to `SCATTER` um away along x."""
        shift = float(rng.uniform(-SCATTER, SCATTER))
        return tuple(
            dataclasses.replace(
                c,
                polarity=float(rng.uniform(-np.pi, np.pi)),
                position=(float(c.centre[0]) + shift, float(c.centre[1]), float(c.centre[2])),
            )
            for c in scene.membranes
        )

    def train(self, scene: S) -> tuple[list[S], list[S]]:
        """Refused: see `refuse`."""
        self.refuse(scene, "train")
        return [], []

    def turn(
        self, scene: S, n: int, *, seed: int, loaded: bool, scatter: float, label: str
    ) -> list[S]:
        """Refused: see `refuse`."""
        self.refuse(scene, "train")
        return []

    def draw(self, run: Trajectory, ax: object = None, *, k: int = -1) -> object:
        """Displacement in a section along the axis at sample k, over the densification."""
        return draw_by("gel_section", run, k, ax=ax, error=run.error_of("matrix.displacement"))

    def refuse(self, scene: ScenePlan, use: str = "run") -> None:
        """Refuse training, floppy networks, and a step that no stepper is named for."""
        if use == "train":
            raise SceneError(_NO_TRAINING)
        super().refuse(scene, use)
        if use != "run":
            return
        if self.coordination <= FLOPPY and "fibre_bending" not in scene.effects:
            raise SceneError(
                f"matrix.coordination = {self.coordination:g} leaves a gel floppy: fibres that "
                f"only pull along themselves are rigid above {FLOPPY:g}; raise it, or add "
                "fibre_bending = {}"
            )
        if scene.stepper is None and scene.step != STEPS["LinearlyImplicit"]:
            raise SceneError(
                f"step = {scene.step:g} s is given and a gel is stepped by RKC, which finds its "
                "own; leave it out, or name a stepper"
            )

    def method(self, scene: ScenePlan) -> SceneStepper | BySystem:
        """RKC where the scene names no other."""
        return GEL_AUTO if scene.stepper in (None, "auto") else stepper_of(scene)

    def memory(self, scene: ScenePlan, *, on_disk: bool = True, run: bool = True) -> MemoryNeed:
        """By the number of nodes, cells, laws and the stepper; see `gel_memory`."""
        return gel_memory(scene, self.node_count, on_disk=on_disk, run=run)

    def words(self, scene: ScenePlan) -> tuple[str, str]:
        """The scene in words, and what makes it smaller."""
        return plane_words(scene, self.node_count, "make the gel smaller")
