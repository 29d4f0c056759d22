"""Scenes from files, presets by their name and the records of runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from cellsys.arguments import checked
from cellsys.effects.commands import Commands, History
from cellsys.effects.protocol import Effect
from cellsys.errors import ParameterError, SceneError
from cellsys.mechanics.crawler import Crawler
from cellsys.scene.forms import forms
from cellsys.scene.inherit import find_scene, read_table
from cellsys.scene.parts import CellScene, Training
from cellsys.scene.registry import Registry
from cellsys.scene.scene import Scene, parse_scene


@checked
def load_scene(
    path: str | Path,
    *,
    effects: Iterable[type[Effect]] = (),
    matrices: Iterable[type] = (),
) -> Scene:
    """Read a scene file (TOML), or a preset by its name.

    Parameters
    ----------
    path : path or str
        A file, or one of `cellsys.scene.preset_names()`; a file of that name comes first.
    effects : iterable of Effect classes
        Effects of your own that the scene may name.
    matrices : iterable of classes
        Kinds of matrix of your own (`cellsys.contracts.MatrixKind`) that it may name.

    Raises
    ------
    SceneError
        With the file's name, the key, the value and the cure.
    FileNotFoundError
        When there is neither such a file nor such a preset.
    """
    source = find_scene(path)
    table = read_table(source)
    try:
        scene = parse_scene(table, effects=effects, matrices=matrices, folder=source.parent)
        return dataclasses.replace(scene, text=source.read_text("utf-8-sig"))
    except SceneError as error:
        raise SceneError(f"{source.name}: {error}") from error


def scene_from_plain(
    table: Mapping[str, Any],
    *,
    effects: Iterable[type[Effect]] = (),
    matrices: Iterable[type] = (),
) -> Scene:
    """A scene from what `Scene.canonical` gave (values in internal units).

    `effects` and `matrices` are those of a script that the scene names.
    """
    registry = Registry(effects)

    def history(value: Mapping[str, Any] | None) -> History | None:
        return None if value is None else History(tuple(value["times"]), tuple(value["values"]))

    def commands(value: Mapping[str, Any] | None) -> Commands | None:
        if value is None:
            return None
        return Commands(history(value["heading"]), history(value["amplitude"]))

    def made(values: Mapping[str, Any]) -> dict[str, Effect]:
        return {name: effect(given) for name, given in values.items()}

    def effect(given: Mapping[str, Any]) -> Effect:
        fields = {k: v for k, v in given.items() if k not in ("effect", "origin")}
        if isinstance(fields.get("history"), Mapping):
            fields["history"] = history(fields["history"])
        if "patches" in fields:
            fields["patches"] = tuple(effect(p) for p in fields["patches"])
        kind = registry[given["effect"]]
        for item in dataclasses.fields(kind):
            once = item.metadata.get("once")
            if once in fields:
                fields[item.name] = fields.pop(once)
        return kind(**fields)

    matrix = table["matrix"]
    if matrix is not None:
        known = forms(matrices, matrix["kind"])
        if matrix["kind"] not in known:
            raise ParameterError(
                f"matrix.kind {matrix['kind']!r} is of a script or package that is not here; pass "
                "its class in matrices="
            )
        matrix = known[matrix["kind"]].restore(matrix)
    crawlers = tuple(Crawler(**c) for c in table["cells"] if "lead_node" in c)
    membranes = tuple(
        CellScene(
            position=tuple(c["position"]),
            polarity=c["polarity"],
            elevation=c.get("elevation", 0.0),
            radius=c["radius"],
            effects=made(c["effects"]),
            commands=commands(c["commands"]),
        )
        for c in table["cells"]
        if "lead_node" not in c
    )
    if crawlers and membranes:
        raise ParameterError("cells must be all with a membrane or all crawlers")
    return Scene(
        name=table["name"],
        duration=table["duration"],
        sample=table["sample"],
        effects=made(table["effects"]),
        cells=crawlers or membranes,
        matrix=matrix,
        commands=commands(table["commands"]) or Commands(),
        training=Training(**table["training"]),
        seed=table["seed"],
        step=table["step"],
        stepper=table.get("stepper"),
        tolerance=table.get("tolerance"),
        until=table.get("until"),
    )
