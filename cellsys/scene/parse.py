"""Scene files: TOML in, `Scene` out; every unknown key refused with the nearest known one."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, TypeAdapter, ValidationError

from cellsys.errors import CellsysError, SceneError
from cellsys.mechanics.commands import Commands, History
from cellsys.mechanics.crawler import Crawler
from cellsys.mechanics.effects.protocol import Effect
from cellsys.scene.chain import ChainScene, ChainSceneTable, chain_parts
from cellsys.scene.registry import EFFECTS
from cellsys.scene.scene import (
    CellScene,
    Gradient,
    Inclusion,
    MatrixScene,
    Scene,
    Training,
)
from cellsys.scene.tables import CommandsTable, DiscSceneTable, DiscTable, Table, explain

KINDS: dict[str, type[Table]] = {"disc": DiscSceneTable, "chain": ChainSceneTable}


def scene_schema() -> dict[str, Any]:
    """JSON schema of a scene file, for editors."""
    return TypeAdapter(DiscSceneTable | ChainSceneTable).json_schema()


def load_scene(path: str | Path) -> Scene:
    """Read a scene file (TOML).

    Raises
    ------
    SceneError
        With the file's name, the key, the value and the cure.
    FileNotFoundError
        When there is no such file.
    """
    source = Path(path)
    try:
        table = tomllib.loads(source.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileNotFoundError(f"no scene file {str(source)!r}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"{source.name}: not a TOML file: {error}") from error
    except OSError as error:
        raise SceneError(f"{source.name}: cannot be read: {error}") from error
    except RecursionError as error:
        raise SceneError(f"{source.name}: nested too deeply") from error
    try:
        return parse_scene(table)
    except SceneError as error:
        raise SceneError(f"{source.name}: {error}") from error


def parse_scene(table: Mapping[str, Any]) -> Scene:
    """A `Scene` from a mapping shaped like a scene file; see `load_scene` for the errors."""
    matrix = table.get("matrix")
    kind = "chain" if isinstance(matrix, Mapping) and matrix.get("kind") == "chain" else "disc"
    try:
        parsed: Any = KINDS[kind].model_validate(dict(table))
    except ValidationError as error:
        raise SceneError("; ".join(explain(i, KINDS, kind) for i in error.errors())) from error
    try:
        return _chain_scene(parsed) if kind == "chain" else _scene(parsed)
    except SceneError:
        raise
    except CellsysError as error:
        raise SceneError(str(error)) from error


def _scene(parsed: DiscSceneTable) -> Scene:
    for name, value, least in (
        ("seed", parsed.seed, 0),
        ("training.runs", parsed.training.runs, 1),
        ("training.held_out", parsed.training.held_out, 1),
    ):
        if value < least:
            raise SceneError(f"{name} must be >= {least}, got {value}")
    for name in ("duration", "sample"):
        value = getattr(parsed.training, name)
        if not value > 0:
            raise SceneError(f"training.{name} must be > 0 s, got {value!r}")
    return Scene(
        name=parsed.name,
        duration=parsed.duration,
        sample=parsed.sample,
        step=parsed.step,
        seed=parsed.seed,
        matrix=_matrix(parsed.matrix),
        cells=tuple(
            CellScene(
                position=c.position,
                polarity=c.polarity,
                radius=c.radius,
                effects=_effects(c.effects) if c.effects is not None else {},
                commands=_commands(c.commands) if c.commands is not None else None,
            )
            for c in parsed.cells
        ),
        effects=_effects(parsed.effects),
        commands=_commands(parsed.commands),
        training=Training(**parsed.training.model_dump()),
    )


def _chain_scene(parsed: Any) -> Scene:
    matrix, cells = chain_parts(parsed)
    return Scene(
        name=parsed.name,
        duration=parsed.duration,
        sample=parsed.sample,
        matrix=matrix,
        cells=cells,
        effects=_effects(parsed.effects),
    )


def _matrix(table: DiscTable | None) -> MatrixScene | None:
    if table is None:
        return None
    for name in ("diameter", "thickness", "modulus"):
        value = getattr(table, name)
        if not value > 0:
            raise SceneError(f"matrix.{name} must be > 0, got {value!r}")
    inclusion = gradient = None
    if table.inclusion is not None:
        inclusion = Inclusion(**table.inclusion.model_dump())
        if not (inclusion.radius > 0 and inclusion.factor > 0):
            raise SceneError("matrix.inclusion needs radius > 0 um and factor > 0")
    if table.gradient is not None:
        gradient = Gradient(**table.gradient.model_dump())
        if abs(gradient.per_um) * 0.5 * table.diameter >= 1.0:
            raise SceneError(
                f"matrix.gradient.per_um = {gradient.per_um:g} makes the stiffness zero inside the "
                f"disc; keep it below {2.0 / table.diameter:.3g}"
            )
    return MatrixScene(
        table.kind,
        table.diameter,
        table.thickness,
        table.modulus,
        table.nodes,
        table.seed,
        inclusion,
        gradient,
    )


def _effects(table: BaseModel) -> dict[str, Effect]:
    effects = {}
    for name in EFFECTS:
        values = getattr(table, name)
        if values is None:
            continue
        given = {k: getattr(values, k) for k in type(values).model_fields}
        effects[name] = _effect(EFFECTS[name], given)
    return effects


def _effect(kind: type[Effect], given: Mapping[str, Any]) -> Effect:
    values = {}
    for key, value in given.items():
        if isinstance(value, BaseModel):
            values[key] = _as_history(value)
        elif isinstance(value, list):
            values[key] = tuple(_effect(kind, dict(item)) for item in value)
        elif value is not None:
            values[key] = value
    return kind(**values)


def _as_history(table: Any) -> History:
    return History(tuple(table.times), tuple(table.values))


def _commands(table: CommandsTable) -> Commands:
    return Commands(
        None if table.heading is None else _as_history(table.heading),
        None if table.amplitude is None else _as_history(table.amplitude),
    )


def scene_from_plain(table: Mapping[str, Any]) -> Scene:
    """A scene from what `Scene.canonical` gave (values in internal units)."""

    def history(value: Any) -> History | None:
        return None if value is None else History(tuple(value["times"]), tuple(value["values"]))

    def commands(value: Any) -> Commands | None:
        if value is None:
            return None
        return Commands(history(value["heading"]), history(value["amplitude"]))

    def effects(values: Mapping[str, Any]) -> dict[str, Effect]:
        return {name: effect(given) for name, given in values.items()}

    def effect(given: Mapping[str, Any]) -> Effect:
        fields = {k: v for k, v in given.items() if k != "effect"}
        if isinstance(fields.get("history"), Mapping):
            fields["history"] = history(fields["history"])
        if "patches" in fields:
            fields["patches"] = tuple(effect(p) for p in fields["patches"])
        return EFFECTS[given["effect"]](**fields)

    matrix = table["matrix"]
    chain = matrix is not None and matrix["kind"] == "chain"
    if chain:
        matrix = ChainScene(**matrix)
    elif matrix is not None:
        inclusion, gradient = matrix["inclusion"], matrix["gradient"]
        if inclusion is not None:
            inclusion = Inclusion(**{**inclusion, "center": tuple(inclusion["center"])})
        gradient = None if gradient is None else Gradient(**gradient)
        matrix = MatrixScene(**{**matrix, "inclusion": inclusion, "gradient": gradient})
    cells = tuple(
        Crawler(**c)
        if chain
        else CellScene(
            tuple(c["position"]),
            c["polarity"],
            c["radius"],
            effects(c["effects"]),
            commands(c["commands"]),
        )
        for c in table["cells"]
    )
    return Scene(
        name=table["name"],
        duration=table["duration"],
        sample=table["sample"],
        effects=effects(table["effects"]),
        cells=cells,
        matrix=matrix,
        commands=commands(table["commands"]) or Commands(),
        training=Training(**table["training"]),
        seed=table["seed"],
        step=table["step"],
    )
