"""``cellsys sweep``: one scene at many values, cached, several at a time, one table of results."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Annotated

import typer

from cellsys.cli.console import Json, Quiet, SceneFile, app, dump, print_table, progress_bars
from cellsys.cli.output import show


@app.command()
def sweep(
    scene: SceneFile,
    settings: Annotated[
        list[str],
        typer.Option(
            "--set", help="key=value,value,... such as effects.volume.modulus='200 Pa,300 Pa'."
        ),
    ],
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, help="Runs at a time.")] = 1,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Output folder.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run a scene at every combination of values; finished runs are kept and not run again."""
    from cellsys.observe import read_out_errors, read_outs
    from cellsys.scene import run_ensemble
    from cellsys.scene.memory import memory_need
    from cellsys.scene.variants import read_setting, variants
    from cellsys.store.atomic import write_text
    from cellsys.store.memory import size_text

    chosen = variants(scene, [read_setting(text) for text in settings])
    if not as_json:
        need = sum(memory_need(variant).record for _, variant in chosen)
        show(f"{len(chosen)} runs, {size_text(need)} on the disk")
    folder = Path("out") / f"{scene.stem} sweep" if out is None else out
    with progress_bars(quiet) as progress:
        runs = run_ensemble(
            [variant for _, variant in chosen],
            folder / "runs",
            workers=jobs,
            progress=lambda done, all_: progress("runs", done / all_),
        )
    rows: list[dict[str, str | float]] = []
    for (values, variant), run in zip(chosen, runs, strict=True):
        where = f"runs/{variant.fingerprint()[:20]}"
        rows.append({**values, **read_outs(run), "run": where})
    write_text(folder / "sweep.csv", _csv(rows))
    if as_json:
        dump(rows)
        return
    head = [name for name in rows[0] if name != "run"]
    shown = [
        [_shown(row[h], errors.get(h, -1.0)) for h in head]
        for row, errors in zip(rows, map(read_out_errors, runs), strict=True)
    ]
    print_table(f"{scene.stem} at {len(rows)} settings", head, shown)
    show(f"table: {folder / 'sweep.csv'}; runs: {folder / 'runs'}")


def _shown(value: str | float, error: float) -> str:
    """A cell of the table; a read-out below its own error is not to be told from zero."""
    if isinstance(value, str):
        return value
    return f"{value:.4g}" if value > error else f"below {error:.2g}"


def _csv(rows: list[dict[str, str | float]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
