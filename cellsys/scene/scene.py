"""`Scene`: what to simulate, as frozen data with checked values."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import CellsysError, SceneError
from cellsys.kinds import Seed
from cellsys.mechanics.commands import Commands, History
from cellsys.mechanics.crawler import Crawler
from cellsys.mechanics.effects.protocol import Effect
from cellsys.scene.chain import ChainScene, check_chain
from cellsys.scene.compatibility import check_effects
from cellsys.scene.parse import scene_fields
from cellsys.scene.parts import CellScene, MatrixScene, Training
from cellsys.scene.registry import source_of
from cellsys.scene.sampling import intervals
from cellsys.store.hashing import fingerprint

_MOST_SAMPLES = 1e7  # their times alone are 80 MB, their states of any scene beyond every memory
_MOST_STEPS = 1e9  # at 1 ms each, which only the smallest scenes need, twelve days
# From a speck to a metre, from a liquid to diamond: beyond, arrays of bins and stiffnesses
# overflow.
_MATRIX = {
    "diameter": (0.01, 1e6, "um"),
    "thickness": (1e-3, 1e4, "um"),
    "modulus": (1e-9, 1e12, "pN/um^2"),
}
_RADIUS = (0.01, 1e3)
_SPARSEST = 100.0  # um between neighbouring nodes: far apart, no cell touches any


@checked
@dataclass(frozen=True)
class Scene:
    """A scene: matrix, cells, the effects that act, commands, and how long.

    On a chain (`ChainScene`) the cells are `Crawler` objects, `effects` and `commands` are empty,
    and `training`, `seed` and `step` are not used.

    Built by `load_scene` or `Scene.parse`; change it with `dataclasses.replace`. Times in s,
    lengths in um, angles in rad. `cells` may be empty (a passive matrix) and `matrix` None (a
    free membrane), not both. `until` "contact" ends the run where two cells touch, before
    `duration` if that comes first.

    Raises
    ------
    SceneError
        Naming the contradiction: an effect without what it needs, cells that overlap or lie
        outside the disc, a duration of zero, a sample that does not divide the duration.
    """

    name: str
    duration: float
    sample: float
    effects: Mapping[str, Effect]
    cells: tuple[CellScene, ...] | tuple[Crawler, ...] = ()
    matrix: MatrixScene | ChainScene | None = None
    commands: Commands = field(default_factory=Commands)
    training: Training = field(default_factory=Training)
    seed: Seed = 0
    step: float = 0.5
    until: str | None = None

    def __repr__(self) -> str:
        """The scene in a few lines."""
        matrix = "no matrix"
        if isinstance(self.matrix, ChainScene):
            matrix = f"a chain of {self.matrix.nodes} nodes"
        elif self.matrix is not None:
            matrix = f"a disc of {self.matrix.diameter:g} um"
        effects = textwrap.shorten(", ".join(self.effects) or "none", 400, placeholder=" ...")
        text = (
            f"Scene {self.name!r}: {len(self.cells)} cell{'s' * (len(self.cells) != 1)}, {matrix}, "
            f"{self.duration:g} s every {self.sample:g} s; effects: {effects}"
        )
        return textwrap.fill(text, 100, subsequent_indent="    ")

    @staticmethod
    def parse(table: Mapping[str, Any], *, effects: Iterable[type[Effect]] = ()) -> Scene:
        """A scene from a mapping shaped like a scene file (quantities as strings with units).

        `effects` are classes of your own that the table may name beside the shipped ones.
        """
        return parse_scene(table, effects=effects)

    def __post_init__(self) -> None:
        if not (np.isfinite(self.step) and self.step > 0):
            raise SceneError(f"step must be > 0 s, got {self.step!r}")
        count = intervals(self.duration, self.sample)
        if count > _MOST_SAMPLES:
            raise SceneError(
                f"duration / sample = {count:.3g} samples, more than {_MOST_SAMPLES:.0e}; sample "
                "less often or shorten the run"
            )
        if self.until not in (None, "contact"):
            raise SceneError(f"until must be 'contact' or left out, got {self.until!r}")
        if self.until is not None and len(self.cells) < 2:
            raise SceneError(
                f"until = {self.until!r} needs at least two cells, got {len(self.cells)}; add "
                "[[cells]] or leave until out"
            )
        if self.until is not None and isinstance(self.matrix, ChainScene):
            raise SceneError(
                f"until = {self.until!r} is for cells with a membrane; crawlers on a chain stall "
                "where they meet: leave it out"
            )
        plan = self.training
        runs = float(min(plan.runs + plan.held_out, 10**15))  # no float holds every integer
        samples = runs * plan.duration / plan.sample
        if samples > _MOST_SAMPLES:
            raise SceneError(
                f"training asks for {runs:.3g} runs and {samples:.3g} "
                f"samples, more than {_MOST_SAMPLES:.0e}; lower training.runs, shorten training "
                "or sample less often"
            )
        if isinstance(self.matrix, ChainScene):
            check_chain(self.matrix, self.cells, self.effects, self.commands)
            return
        for name, span in (("duration", self.duration), ("training.duration", plan.duration)):
            if span / self.step > _MOST_STEPS:
                raise SceneError(
                    f"{name} / step = {span / self.step:.3g} steps, more than {_MOST_STEPS:.0e}, "
                    "which take months; shorten the run or lengthen the step"
                )
        if any(isinstance(cell, Crawler) for cell in self.cells):
            raise SceneError("a Crawler lives on a chain; its matrix must be a ChainScene")
        if not self.cells and self.matrix is None:
            raise SceneError("a scene needs [[cells]] or a [matrix]")
        if "drag" not in self.effects:
            raise SceneError(
                "effects.drag is missing: without drag nothing has a rate; add drag = {}"
            )
        self._check_effects()
        self._check_places()

    def _check_effects(self) -> None:
        check_effects(self.effects, [c.effects for c in self.cells], self.matrix is not None)
        if (
            self.commands.heading or self.commands.amplitude
        ) and "lamellipodium" not in self.effects:
            raise SceneError(
                "commands steer the lamellipodium, and effects.lamellipodium is missing"
            )

    def _check_places(self) -> None:
        for name, (least, most, unit) in _MATRIX.items() if self.matrix is not None else ():
            if not least <= getattr(self.matrix, name) <= most:
                raise SceneError(
                    f"matrix.{name} must be > 0, in [{least:g}, {most:g}] {unit}, "
                    f"got {getattr(self.matrix, name)!r}"
                )
        nodes = None if self.matrix is None else self.matrix.nodes
        if nodes is not None and nodes > 0 and nodes < (self.matrix.diameter / _SPARSEST) ** 2:
            raise SceneError(
                f"matrix.nodes = {nodes} leaves {self.matrix.diameter / np.sqrt(nodes):.3g} um "
                f"between nodes, more than {_SPARSEST:g} um; ask for more or leave it out"
            )
        seed = None if self.matrix is None else self.matrix.seed
        if seed is not None and seed < 0:
            raise SceneError(f"matrix.seed must be >= 0, got {seed}")
        for i, a in enumerate(self.cells):
            if not _RADIUS[0] <= a.radius <= _RADIUS[1]:
                raise SceneError(
                    f"cells[{i}].radius must be > 0 um, in [{_RADIUS[0]:g}, {_RADIUS[1]:g}] um, "
                    f"got {a.radius!r}"
                )
            if self.matrix is not None:
                reach = float(np.hypot(*a.position)) + a.radius
                if reach > 0.5 * self.matrix.diameter:
                    raise SceneError(
                        f"cells[{i}] reaches {reach:.3g} um from the centre, outside the disc of "
                        f"radius {0.5 * self.matrix.diameter:.3g} um; move it or enlarge the matrix"
                    )
        self._check_overlaps()

    def _check_overlaps(self) -> None:
        """Every cell against those in the squares around its own, as wide as two radii."""
        wide = 2.0 * max((c.radius for c in self.cells), default=1.0)
        squares: dict[tuple[float, float], list[int]] = {}
        for i, a in enumerate(self.cells):
            x, y = (v // wide for v in a.position)
            near = ((x + p, y + q) for p in (-1, 0, 1) for q in (-1, 0, 1))
            for j in sorted(j for square in near for j in squares.get(square, ())):
                b = self.cells[j]
                gap = float(np.hypot(a.position[0] - b.position[0], a.position[1] - b.position[1]))
                if gap < a.radius + b.radius:
                    raise SceneError(
                        f"cells[{j}] and cells[{i}] overlap: centres {gap:.3g} um apart, radii "
                        f"{b.radius:g} + {a.radius:g} um; move them apart"
                    )
            squares.setdefault((x, y), []).append(i)

    @property
    def times(self) -> np.ndarray:
        """Sample times, s: 0, sample, ..., duration."""
        return np.linspace(0.0, self.duration, intervals(self.duration, self.sample) + 1)

    def canonical(self) -> dict[str, Any]:
        """Everything the result depends on, as plain values in internal units."""
        table = {f.name: _plain(getattr(self, f.name)) for f in dataclasses.fields(self)}
        if self.until is None:
            table.pop("until")
        return table

    def fingerprint(self) -> str:
        """Hash of `canonical`, cellsys version and kind of processor: the key of the run cache.

        The name and the training plan do not enter: they do not change a run. The kind of
        processor and BLAS does, in the last digits (`processor_kind`).
        """
        table = self.canonical()
        for key in ("name", "training"):
            table.pop(key)
        from cellsys.store.processor import processor_kind

        return fingerprint(table, _version(), processor_kind())


def _version() -> str:
    from cellsys.version import __version__

    return __version__


def _plain(value: Any) -> Any:
    if isinstance(value, Effect):
        fields = {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
        origin = source_of(type(value))
        return {"effect": value.name, **({"origin": origin} if origin else {}), **fields}
    if isinstance(value, History):
        return {"times": list(value.times), "values": list(value.values)}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in sorted(value.items())}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value


def parse_scene(
    table: Mapping[str, Any],
    *,
    effects: Iterable[type[Effect]] = (),
    folder: Path | None = None,
) -> Scene:
    """A `Scene` from a mapping shaped like a scene file; see `load_scene` for the errors.

    `folder` is where a file named by ``extends`` is looked for; default the working directory.
    """
    fields = scene_fields(table, effects=effects, folder=folder)
    try:
        return Scene(**fields)
    except SceneError:
        raise
    except CellsysError as error:
        raise SceneError(str(error)) from error
