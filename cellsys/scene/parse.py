"""Scene files as the arguments of `Scene`; unknown keys are refused with the nearest known one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import BaseModel, TypeAdapter, ValidationError

from cellsys.arguments import checked
from cellsys.errors import CellsysError, ParameterError, SceneError
from cellsys.mechanics.commands import Commands, History
from cellsys.mechanics.effects.protocol import Effect
from cellsys.scene.chain import ChainSceneTable, chain_parts
from cellsys.scene.inherit import inherited
from cellsys.scene.parts import CellScene, Gradient, Inclusion, MatrixScene, Training
from cellsys.scene.registry import Registry
from cellsys.scene.schema import for_editors
from cellsys.scene.tables import (
    CommandsTable,
    DiscSceneTable,
    DiscTable,
    TomlTable,
    effects_table,
    explain,
    with_effects,
)

KINDS: dict[str, type[TomlTable]] = {"disc": DiscSceneTable, "chain": ChainSceneTable}


@lru_cache(maxsize=64)
def _kinds(names: tuple[str, ...], chosen: tuple[type[Effect], ...]) -> dict[str, type[TomlTable]]:
    table = effects_table(names, chosen)
    return {kind: with_effects(scene, table) for kind, scene in KINDS.items()}


@checked
def scene_schema(effects: Iterable[type[Effect]] = ()) -> dict[str, Any]:
    """JSON schema of a scene file, for editors; `effects` as in `load_scene`."""
    registry = Registry(effects)
    kinds = _kinds(tuple(registry), tuple(registry.values()))
    return for_editors(TypeAdapter(kinds["disc"] | kinds["chain"]).json_schema())


def scene_fields(
    table: Mapping[str, Any],
    *,
    effects: Iterable[type[Effect]] = (),
    folder: Path | None = None,
) -> dict[str, Any]:
    """Arguments of `Scene` from a mapping shaped like a scene file; see `parse_scene`."""
    table = inherited(table, Path() if folder is None else folder)
    matrix = table.get("matrix")
    kind = "chain" if isinstance(matrix, Mapping) and matrix.get("kind") == "chain" else "disc"
    try:
        registry = Registry(effects)
        named = [n for n in _named_effects(table) if n in registry]
        known = registry.names(named)
        kinds = _kinds(known, tuple(registry[name] for name in named))
        parsed: Any = kinds[kind].model_validate(dict(table))
    except ValidationError as error:
        raise SceneError("; ".join(explain(i, kinds, kind) for i in error.errors())) from error
    except ParameterError as error:
        raise SceneError(str(error)) from error
    try:
        return _chain_scene(parsed, registry) if kind == "chain" else _scene(parsed, registry)
    except SceneError:
        raise
    except CellsysError as error:
        raise SceneError(str(error)) from error


def _named_effects(table: Mapping[str, Any]) -> list[str]:
    """Names under [effects] and under the effects of any cell, each once."""
    cells = table.get("cells")
    places = [table, *(cells if isinstance(cells, list) else ())]
    tables = [p.get("effects") for p in places if isinstance(p, Mapping)]
    names = {name: None for t in tables if isinstance(t, Mapping) for name in t}
    return [name for name in names if isinstance(name, str)]


def _scene(parsed: Any, registry: Registry) -> dict[str, Any]:
    for name, value, least in (
        ("seed", parsed.seed, 0),
        ("training.runs", parsed.training.runs, 1),
        ("training.held_out", parsed.training.held_out, 1),
    ):
        if value < least:
            raise SceneError(f"{name} must be >= {least}, got {value}")
    return dict(
        name=parsed.name,
        duration=parsed.duration,
        sample=parsed.sample,
        step=parsed.step,
        seed=parsed.seed,
        until=parsed.until,
        matrix=_matrix(parsed.matrix),
        cells=tuple(
            CellScene(
                position=c.position,
                polarity=c.polarity,
                radius=c.radius,
                effects=_effects(c.effects, registry) if c.effects is not None else {},
                commands=_commands(c.commands) if c.commands is not None else None,
            )
            for c in parsed.cells
        ),
        effects=_effects(parsed.effects, registry),
        commands=_commands(parsed.commands),
        training=Training(**parsed.training.model_dump()),
    )


def _chain_scene(parsed: Any, registry: Registry) -> dict[str, Any]:
    matrix, cells = chain_parts(parsed)
    return dict(
        name=parsed.name,
        duration=parsed.duration,
        sample=parsed.sample,
        matrix=matrix,
        cells=cells,
        effects=_effects(parsed.effects, registry),
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


def _effects(table: BaseModel, registry: Registry) -> dict[str, Effect]:
    effects = {}
    for name in sorted(table.model_fields_set, key=registry.place):
        values = getattr(table, name)
        if values is None:
            continue
        given = {k: getattr(values, k) for k in type(values).model_fields}
        effects[name] = _effect(registry[name], given)
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
