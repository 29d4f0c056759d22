"""``cellsys effects``: what effects there are, what a scene builds of them, what each is worth."""

from __future__ import annotations

import dataclasses
import shutil
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from cellsys.cli.console import Json, Quiet, app, dump, print_table, progress_bars
from cellsys.cli.output import show

USUAL = 300.0  # s of a scene that are run without each effect


@app.command()
def effects(
    scene: Annotated[Path | None, typer.Argument(help="A scene file (toml) or a preset.")] = None,
    measure: Annotated[
        bool, typer.Option("--measure", help="Run the scene without each effect in turn.")
    ] = False,
    duration: Annotated[
        float | None,
        typer.Option(
            help="Length of the --measure runs in s, a multiple of the scene's sample; 0: the "
            "scene's own. Default: 300 s, or the scene's own where that is shorter."
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """List all effects, what a scene builds of them, or what each of them is worth to it."""
    from cellsys.errors import ParameterError

    if scene is None:
        if measure:
            raise ParameterError("--measure needs a scene to run; name a file or a preset")
        _list_all(as_json)
    elif measure:
        if duration is not None and not 0.0 <= duration < float("inf"):
            raise ParameterError(f"--duration must be >= 0 s, got {duration:g}")
        _measure(scene, duration, as_json, quiet)
    else:
        _list_scene(scene, as_json)


def _list_all(as_json: bool) -> None:
    from cellsys.scene.listing import effect_list, effect_table, setting_text

    rows = effect_table()
    if as_json:
        dump(rows)
        return
    for effect in effect_list():
        name = effect["effect"]
        show(f"{name} ({effect['acts on']})")
        _paragraph(effect["what it is"])
        known = ("effect", "acts on", "what it is")
        rest = [f"{k}: {v}" for k, v in effect.items() if k not in known and v]
        if rest:
            _paragraph("; ".join(rest))
        for row in rows:
            if row["effect"] == name:
                setting, meaning = setting_text(row)
                _paragraph(f"{setting}  {meaning}; {row['source']}", "    ")


def _paragraph(text: str, indent: str = "  ") -> None:
    wide = min(max(shutil.get_terminal_size((80, 24)).columns, 40), 100)
    show(textwrap.fill(text, wide, initial_indent=indent, subsequent_indent=indent + "    "))


def _list_scene(scene: Path, as_json: bool) -> None:
    from cellsys.scene.listing import scene_effects

    rows = scene_effects(scene)
    if as_json:
        dump(rows)
        return
    for row in rows:
        if "share of time" in row:
            row["share of time"] = f"{100 * row['share of time']:.1f} %"
    _table(f"what {scene.name} builds", rows)


def _measure(scene: Path, duration: float | None, as_json: bool, quiet: bool) -> None:
    from cellsys.scene import load_scene
    from cellsys.study.leave_one_out import leave_one_out

    loaded = load_scene(scene)
    length = duration or loaded.duration
    if duration is None and length > USUAL:
        length = loaded.sample * max(1, int(USUAL / loaded.sample))
    with progress_bars(quiet) as progress:
        result = leave_one_out(loaded, duration=length, progress=progress)
    if as_json:
        dump({"duration_s": length, "effects": [dataclasses.asdict(w) for w in result]})
        return
    show(f"{loaded.name}, {length:g} s, without each effect in turn:")
    for worth in result:
        show(f"  {worth}")


def _table(title: str, rows: Sequence[Mapping[str, object]]) -> None:
    head = list(rows[0])
    print_table(title, head, [[str(r[h]) for h in head] for r in rows])
