"""What a study of a scene will run, told before it starts."""

from __future__ import annotations

from dataclasses import dataclass

from cellsys.arguments import checked
from cellsys.contracts import Embedding
from cellsys.errors import ParameterError
from cellsys.mechanics.crawler import Crawler
from cellsys.observe.pairs import alone_scenes
from cellsys.scene import Scene, build, training_scenes
from cellsys.scene.memory import memory_need
from cellsys.shown import Shown
from cellsys.store.memory import size_text
from cellsys.study.floors import floor_scenes

# One step of the shipped scene (7137 unknowns), 8000 nodes and 18 809 nodes take 1.3, 14 and 65 ms
# on one core of the machine of analysis/README.md.
_STEP, _UNKNOWNS, _POWER = 1.3e-3, 7137.0, 1.7
_LEARNING = 20.0  # s, of 8 runs of 300 samples on the same machine; in proportion to samples
_SAMPLES = 8 * 300


@dataclass(frozen=True, kw_only=True)
class StudyPlan(Shown):
    """Full-order runs of a study and what they take; without what the cache already holds.

    Attributes
    ----------
    runs : int
        Full-order runs, controls and floors among them.
    duration : float
        Of the longest, s of the scene.
    seconds : float
        Estimate of the wall time on a quiet machine, s.
    bytes : float
        On disk.
    learns : bool
        Whether models are learned.
    """

    runs: int
    duration: float
    seconds: float
    bytes: float
    learns: bool

    def __str__(self) -> str:
        runs = f"{self.runs} full-order run{'s' * (self.runs != 1)}"
        took = (
            f"{max(self.seconds, 1):.0f} s"
            if self.seconds < 300
            else f"{self.seconds / 60:.0f} min"
        )
        models = ", then models" if self.learns else ""
        return (
            f"{runs} of up to {self.duration:g} s{models}: about {took} and "
            f"{size_text(self.bytes)} on disk"
        )


def crawls(scene: Scene) -> bool:
    """Whether its cells are those of a chain."""
    return any(isinstance(cell, Crawler) for cell in scene.cells)


def in_gel(scene: Scene) -> bool:
    """Whether its cells lie inside their matrix."""
    return isinstance(scene.matrix, Embedding)


def steered(scene: Scene) -> bool:
    """Whether it has exactly one cell, on a matrix, that commands can steer: models are of such."""
    on_matrix = scene.matrix is not None and not crawls(scene) and not in_gel(scene)
    return on_matrix and len(scene.cells) == 1 and "lamellipodium" in scene.effects


def learns_from(scene: Scene, learn: bool | None) -> bool:
    """Whether models are learned: as asked, else where the scene has a [training] table.

    Raises
    ------
    ParameterError
        Asked of a scene that no model is learned from.
    """
    if learn and not steered(scene):
        raise ParameterError(
            f"learn: models are learned from scenes with exactly one steered cell on a matrix, and "
            f"{scene.name!r} is none; leave it out"
        )
    return steered(scene) and (scene.learn if learn is None else learn)


def study_scenes(scene: Scene, learns: bool) -> tuple[list[Scene], list[Scene], list[Scene]]:
    """The scene with what is run beside it, and of these the training and the held-out ones."""
    if learns:
        train, held = training_scenes(scene)
        return [scene, *train, *held, *floor_scenes(held)], train, held
    if in_gel(scene):
        from cellsys.study.gel import gel_controls

        return [scene, *gel_controls(scene)], [], []
    if len(scene.cells) > 1 and scene.matrix is not None and not crawls(scene):
        return [scene, *alone_scenes(scene)], [], []
    return [scene], [], []


@checked
def study_plan(scene: Scene, *, learn: bool | None = None, workers: int = 2) -> StudyPlan:
    """How many runs `study` will make of a scene, and about how long it takes.

    Parameters
    ----------
    scene : Scene
    learn, workers
        As of `study`.
    """
    learns = learns_from(scene, learn)
    scenes, train, _ = study_scenes(scene, learns)
    step = _STEP * (len(build(scene).x0) / _UNKNOWNS) ** _POWER
    each = sorted((step * s.duration / s.step for s in scenes), reverse=True)
    seconds = max(each[0], sum(each) / min(workers, len(each)))
    if learns:
        seconds += _LEARNING * max(1.0, sum(len(s.times) for s in train) / _SAMPLES)
    return StudyPlan(
        runs=len(scenes),
        duration=max(s.duration for s in scenes),
        seconds=seconds,
        bytes=sum(memory_need(s).record for s in scenes),
        learns=learns,
    )
