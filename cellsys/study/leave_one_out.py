"""What each effect of a scene is worth: its share of the time, and what its absence changes."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cellsys.accuracy.measures import motion
from cellsys.errors import IntegrationError, SceneError
from cellsys.observe.read_outs import read_out_errors, read_outs
from cellsys.scene.build import build, spreading
from cellsys.scene.ensemble import run_scene
from cellsys.scene.scene import Scene
from cellsys.scene.timing import time_shares
from cellsys.scene.variants import without
from cellsys.shown import Shown
from cellsys.trajectory import Trajectory


@dataclass(frozen=True, kw_only=True)
class Worth(Shown):
    """One effect of a scene.

    Parameters
    ----------
    effect : str
        Its name.
    with_it : tuple of str
        Effects that went with it because they need it.
    share : float
        Of the time of a run with everything, 0 to 1.
    saved : float
        Share of the run's time that was saved without it, nan when that run failed.
    motion : float
        |x without - x with| / |x with - x0| over all node positions and samples (the measure
        "motion"), nan likewise.
    changes : dict
        Relative change of every read-out, nan where it is below its own error.
    note : str
        Why there is no run without it, or how it failed.
    """

    effect: str
    with_it: tuple[str, ...]
    share: float
    saved: float
    motion: float
    changes: dict[str, float]
    note: str = ""

    def __str__(self) -> str:
        also = f" (with {', '.join(self.with_it)})" if self.with_it else ""
        head = f"{self.effect.replace('_', ' ')}{also}: {100 * self.share:.0f} % of the time"
        if self.note:
            return f"{head}; {self.note}"
        told = {"contact_radius_end_um": "spreading", "crawl_um": "crawling",
                "matrix_displacement_max_um": "the matrix"}  # fmt: skip
        parts = [
            f"{told[name]} by {100 * abs(change):.0f} %"
            for name, change in self.changes.items()
            if name in told and np.isfinite(change)
        ]
        parts.append(f"all motion by {100 * self.motion:.0f} %")
        return f"{head}, changes {', '.join(parts)}"


def leave_one_out(
    scene: Scene,
    *,
    duration: float | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> list[Worth]:
    """Run a scene once with everything and once without each of its effects.

    Parameters
    ----------
    scene : Scene
        On a disc, or a free membrane; a chain has no effects.
    duration : float, optional
        Length of the runs, s, a multiple of the scene's sample; default the scene's own.
    progress : callable, optional
        Called with (what, share done).

    Raises
    ------
    SceneError
        For a scene on a chain, or a duration that the scene's sample does not divide.
    """
    scene.matrix_kind.refuse(scene, "leave out")
    scene = dataclasses.replace(scene, until=None)  # all are compared at the same time
    if duration is not None:
        scene = dataclasses.replace(scene, duration=duration)
    tell = progress if progress is not None else lambda stage, share: None
    shares = time_shares(spreading(build(scene)), scene.step, min(20.0, scene.duration), scene.seed)
    whole, took = _timed(scene)
    names = list(scene.effects)
    tell("runs without", 1.0 / (len(names) + 1))
    out = []
    for k, name in enumerate(names, start=2):
        out.append(_worth(scene, name, whole, took, shares.get(name, 0.0)))
        tell("runs without", k / (len(names) + 1))
    return sorted(out, key=lambda w: -w.share)


def _timed(scene: Scene) -> tuple[Trajectory, float]:
    began = time.perf_counter()
    run = run_scene(scene)
    return run, time.perf_counter() - began


def _worth(scene: Scene, name: str, whole: Trajectory, took: float, share: float) -> Worth:
    nan = float("nan")
    try:
        rest, also = without(scene, name)
    except SceneError as error:
        return Worth(
            effect=name,
            with_it=(),
            share=share,
            saved=nan,
            motion=nan,
            changes={},
            note=f"cannot be left out: {error}",
        )
    try:
        run, time_without = _timed(rest)
    except IntegrationError as error:
        return Worth(
            effect=name,
            with_it=also,
            share=share,
            saved=nan,
            motion=nan,
            changes={},
            note=f"without it the run fails: {error}",
        )
    before, after, errors = read_outs(whole), read_outs(run), read_out_errors(whole)
    changes = {
        key: (after[key] - value) / value if value > errors.get(key, 0.0) else nan
        for key, value in before.items()
        if key in after
    }
    saved = 1.0 - time_without / took
    return Worth(
        effect=name,
        with_it=also,
        share=share,
        saved=saved,
        motion=_motion(whole, run),
        changes=changes,
    )


def _motion(whole: Trajectory, run: Trajectory) -> float:
    names = [b.name for b in whole.states if b.kind == "position" and b.name in run.states]
    if not names:
        return 0.0
    return motion(*(np.column_stack([r.block(n).reshape(len(r), -1) for n in names])
                    for r in (run, whole)))  # fmt: skip
