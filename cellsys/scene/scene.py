"""`Scene`: what to simulate, as frozen data with checked values."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import MatrixKind
from cellsys.effects.commands import Commands, History
from cellsys.effects.protocol import Effect
from cellsys.errors import CellsysError, SceneError
from cellsys.kinds import Seed
from cellsys.mechanics.crawler import Crawler
from cellsys.scene.parse import scene_fields
from cellsys.scene.parts import CellScene, Training
from cellsys.scene.plan import Kind
from cellsys.scene.plane import NO_MATRIX
from cellsys.scene.registry import source_of
from cellsys.scene.sampling import intervals
from cellsys.scene.steppers import check_stepping
from cellsys.store.hashing import fingerprint

E = TypeVar("E", bound=Effect)
_MOST_SAMPLES = 1e7  # their times alone are 80 MB, their states of any scene beyond every memory


@checked
@dataclass(frozen=True, kw_only=True)
class Scene:
    """A scene: matrix, cells, the effects that act, commands, and how long.

    `matrix` is a `MatrixScene` (disc), a `GelScene`, a `ChainScene` or a kind of your own
    (`MatrixKind`). On a chain the cells are `Crawler` objects, `effects` and `commands` are empty,
    and `training`, `seed` and `step` are not used.

    Built by `load_scene` or `Scene.parse`; change it with `dataclasses.replace`. Times in s,
    lengths in um, angles in rad. `cells` may be empty (a passive matrix) and `matrix` None (a free
    membrane), not both. `stepper` is "auto" (a file that names none and no
    step), "BDF2", "RKC" or "LinearlyImplicit" (which None stands for), `step` and `tolerance` its
    setting: ``[run]`` in a file. `learn` says whether `cs.study`
    learns models from its `training`; a scene file without [training] does not ask for any. `text`
    is the file that the scene was read from, as it was given. `until` "contact" ends the run where
    two cells touch, before `duration` if that comes first.

    Raises
    ------
    SceneError
        Naming the contradiction: an effect without what it needs, cells that overlap or lie
        outside the disc, a duration of zero, a sample that does not divide the duration, a
        setting that the stepper does not take.
    """

    name: str
    duration: float
    sample: float
    effects: Mapping[str, Effect]
    cells: tuple[CellScene, ...] | tuple[Crawler, ...] = ()
    matrix: MatrixKind | None = None
    commands: Commands = field(default_factory=Commands)
    training: Training = field(default_factory=Training)
    learn: bool = field(default=True, compare=False)
    text: str | None = field(default=None, compare=False)
    seed: Seed = 0
    step: float = 0.5
    stepper: str | None = None
    tolerance: float | None = None
    until: str | None = None

    def __repr__(self) -> str:
        """The scene in a few lines."""
        effects = textwrap.shorten(", ".join(self.effects) or "none", 400, placeholder=" ...")
        text = (
            f"Scene {self.name!r}: {len(self.cells)} cell{'s' * (len(self.cells) != 1)}, "
            f"{self.matrix_kind.title}, {self.duration:g} s every {self.sample:g} s; "
            f"effects: {effects}"
        )
        return textwrap.fill(text, 100, subsequent_indent="    ")

    def find(self, kind: type[E]) -> E | None:
        """The scene's effect of this class, if there is one."""
        return next((e for e in self.effects.values() if isinstance(e, kind)), None)

    @staticmethod
    def parse(
        table: Mapping[str, object],
        *,
        effects: Iterable[type[Effect]] = (),
        matrices: Iterable[type] = (),
    ) -> Scene:
        """A scene from a mapping shaped like a scene file (quantities as strings with units).

        `effects` and `matrices` are classes of your own that the table may name beside the
        shipped ones.
        """
        return parse_scene(table, effects=effects, matrices=matrices)

    def __post_init__(self) -> None:
        check_stepping(self.stepper, self.step, self.tolerance)
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
        plan = self.training
        runs = float(min(plan.runs + plan.held_out, 10**15))  # no float holds every integer
        samples = runs * plan.duration / plan.sample
        if samples > _MOST_SAMPLES:
            raise SceneError(
                f"training asks for {runs:.3g} runs and {samples:.3g} "
                f"samples, more than {_MOST_SAMPLES:.0e}; lower training.runs, shorten training "
                "or sample less often"
            )
        self.matrix_kind.refuse(self)
        self.matrix_kind.place_cells(self)

    @property
    def matrix_kind(self) -> Kind:
        """The matrix, or what stands for none."""
        return NO_MATRIX if self.matrix is None else self.matrix

    @property
    def membranes(self) -> tuple[CellScene, ...]:
        """The cells, each with a membrane; SceneError where there are crawlers."""
        found = tuple(cell for cell in self.cells if isinstance(cell, CellScene))
        if len(found) < len(self.cells):
            raise SceneError("this takes cells with a membrane, and the scene has crawlers")
        return found

    @property
    def crawlers(self) -> tuple[Crawler, ...]:
        """The cells, each a crawler; SceneError where there are cells with a membrane."""
        found = tuple(cell for cell in self.cells if isinstance(cell, Crawler))
        if len(found) < len(self.cells):
            raise SceneError("this takes crawlers, and the scene has cells with a membrane")
        return found

    @property
    def times(self) -> np.ndarray:
        """Sample times, s: 0, sample, ..., duration."""
        return np.linspace(0.0, self.duration, intervals(self.duration, self.sample) + 1)

    def canonical(self) -> dict[str, Any]:
        """Everything the result depends on, as plain values in internal units."""
        table: dict[str, Any] = {
            f.name: _plain(getattr(self, f.name)) for f in dataclasses.fields(self)
        }
        table.pop("learn")
        table.pop("text")
        for key in ("stepper", "tolerance", "until"):
            if table[key] is None:  # as scenes were written that knew no such choice
                table.pop(key)
        for cell in table["cells"]:
            if cell.get("elevation") == 0.0:
                cell.pop("elevation")
        if self.matrix is not None:
            origin = source_of(type(self.matrix))
            own = {"kind": self.matrix.kind, "origin": origin} if origin else {}
            table["matrix"] = {**table["matrix"], **own}
        return table

    def fingerprint(self) -> str:
        """Hash of `canonical`, cellsys version and kind of processor: the key of the run cache.

        The name and the training plan do not enter: they do not change a run. The kind of
        processor and BLAS does, in the last digits (`processor_kind`).
        """
        table = self.canonical()
        for key in ("name", "training"):
            table.pop(key)
        if self.stepper == "auto":  # what it chooses may be another one tomorrow
            table["method"] = repr(self.matrix_kind.method(self))
        from cellsys.store.processor import processor_kind

        return fingerprint(table, _version(), processor_kind())


def _version() -> str:
    from cellsys.version import __version__

    return __version__


def _plain(value: object) -> object:
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
    table: Mapping[str, object],
    *,
    effects: Iterable[type[Effect]] = (),
    matrices: Iterable[type] = (),
    folder: Path | None = None,
) -> Scene:
    """A `Scene` from a mapping shaped like a scene file; see `load_scene` for the errors.

    `folder` is where a file named by ``extends`` is looked for; default the working directory.
    """
    fields = scene_fields(table, effects=effects, matrices=matrices, folder=folder)
    try:
        return Scene(**fields)
    except SceneError:
        raise
    except CellsysError as error:
        raise SceneError(str(error)) from error
