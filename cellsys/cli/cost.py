"""What accuracy costs for a scene: cellsys cost."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellsys.cli.console import Json, Quiet, SceneFile, app, dump, print_table, progress_bars
from cellsys.cli.output import show


@app.command()
def cost(
    scene: SceneFile,
    error: Annotated[float, typer.Option(help="Share of the motion that may be missed.")] = 0.01,
    probe: Annotated[float, typer.Option(help="Seconds of the scene that are run.")] = 10.0,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Folder for CSV, JSON and figure.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Error and time of every full-order method on a scene, and the cheapest that will do."""
    from cellsys.accuracy import budget
    from cellsys.accuracy.starts import probe_times
    from cellsys.errors import DataError
    from cellsys.scene import load_scene

    plan = load_scene(scene)
    t = probe_times(plan, probe)
    with progress_bars(quiet) as progress:
        found = budget(plan, error=error, t=t, progress=progress)
    if not found.sweeps:
        raise DataError(str(found))
    sweep = found.sweeps[0]
    if out is not None:
        from cellsys.figures import save_png, sheet, work_precision

        csv, _ = sweep.save(out)
        figure, ax = sheet((7.5, 5.5), 1)
        work_precision(sweep, ax)
        save_png(figure, csv.with_suffix(".png"))
    if as_json:
        dump(
            {
                "error": error,
                "measure": found.measure,
                "integrator": repr(found.integrator) if found else None,
                "held_out": found.held_out,
                "floor": found.floor,
                "points": [vars(p) for p in sweep.points],
                "footer": sweep.footer,
            }
        )
        return
    print_table(
        f"{sweep.problem}: share of the motion missed in {t[-1]:g} s",
        ["method", "setting", "error", "time or reason", ""],
        sweep.table(),
    )
    show(found)
