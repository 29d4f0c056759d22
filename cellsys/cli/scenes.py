"""Commands that take a scene: run, schema."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cellsys.cli.console import Json, Quiet, SceneFile, app, dump, progress_bars
from cellsys.cli.ending import say_ending
from cellsys.cli.output import note, show

if TYPE_CHECKING:
    from cellsys.scene import Scene


@app.command()
def run(
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Output folder.")] = None,
    order: Annotated[int, typer.Option(help="Order of the plant of the loop.")] = 10,
    workers: Annotated[int, typer.Option(help="Processes for the full-order runs.")] = 2,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue interrupted runs of the same scene.")
    ] = False,
    error: Annotated[
        float | None,
        typer.Option("--error", help="Share of the motion that the full-order stepping may miss."),
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", help="Equivariant model of one cell, run beside several cells."),
    ] = None,
    learn: Annotated[
        bool | None,
        typer.Option(
            "--learn/--no-learn",
            help="Learn models; default: where the scene has a [training] table.",
            show_default=False,
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Scene to report: full-order runs, reduced models, poles, margins, closed loop.

    Of a scene with several cells, or without a steered one: its run, read-outs, and one-cell
    controls.
    """
    from cellsys.study import study

    folder = Path("out") / scene.stem if out is None else out
    plan: Path | Scene = scene if error is None else _within(scene, error)
    with progress_bars(quiet) as progress:
        try:
            result = study(
                plan, folder, order=order, workers=workers, resume=resume, model=model,
                learn=learn, announce=None if quiet else note, progress=progress,
            )  # fmt: skip
        except KeyboardInterrupt as stop:
            sys.exit(say_ending(stop, "add --resume to go on from here"))
    if as_json:
        dump(result.summary)
        return
    show(result.report())
    show(f"\nreport: {folder / 'report.html'}")


def _within(scene: Path, error: float) -> Scene:
    """The scene with the cheapest setting of its stepper that keeps the error on other starts."""
    from cellsys.accuracy import budget
    from cellsys.accuracy.starts import scene_setups, stepped_by
    from cellsys.errors import ParameterError
    from cellsys.scene import load_scene

    plan = load_scene(scene)
    plan.matrix_kind.refuse(plan, "step")
    found = budget(plan, error=error, setups=scene_setups(plan))
    if found.integrator is None or isinstance(found.integrator, str):
        raise ParameterError(str(found))
    note(found)
    return stepped_by(plan, found.integrator)


@app.command()
def schema() -> None:
    """JSON schema of scene files, for editors."""
    from cellsys.scene import scene_schema

    show(json.dumps(scene_schema(), indent=2))
