"""Commands that take a scene: run, schema."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from cellsys.cli.console import Json, Quiet, SceneFile, app, dump, progress_bars


@app.command()
def run(
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Output folder.")] = None,
    order: Annotated[int, typer.Option(help="Order of the plant of the loop.")] = 10,
    workers: Annotated[int, typer.Option(help="Processes for the full-order runs.")] = 2,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue interrupted runs of the same scene.")
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Scene to report: full-order runs, reduced models, poles, margins, closed loop."""
    from cellsys.study import study

    folder = Path("out") / scene.stem if out is None else out
    with progress_bars(quiet) as progress:
        try:
            result = study(
                scene, folder, order=order, workers=workers, resume=resume, progress=progress
            )
        except KeyboardInterrupt:
            print("cellsys: interrupted; add --resume to go on from here", file=sys.stderr)
            sys.exit(1)
    if as_json:
        dump(result.summary)
        return
    print(result.report())
    print(f"\nreport: {folder / 'report.html'}")


@app.command()
def schema() -> None:
    """JSON schema of scene files, for editors."""
    from cellsys.scene import scene_schema

    print(json.dumps(scene_schema(), indent=2))
