"""Scene files: TOML in, `Scene` out; every unknown key refused with the nearest known one."""

from __future__ import annotations

import dataclasses
import difflib
import math
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    WithJsonSchema,
    create_model,
)

from cellsys.errors import CellsysError, SceneError
from cellsys.mechanics.commands import Commands, History
from cellsys.mechanics.effects.protocol import Effect
from cellsys.scene.registry import EFFECTS
from cellsys.scene.scene import (
    CellScene,
    Gradient,
    Inclusion,
    MatrixScene,
    Scene,
    Training,
)
from cellsys.units import quantity


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


def _converter(unit: str) -> Callable[[Any], float]:
    return lambda value: quantity(value, unit)


def _amount(unit: str) -> Any:
    schema = {"type": "string", "description": f"number with unit, such as '1 {unit}'"}
    return Annotated[
        float,
        BeforeValidator(_converter(unit)),
        WithJsonSchema({"type": ["string", "number"]} if unit == "1" else schema),
    ]


_Length, _Time, _Angle, _Number = _amount("um"), _amount("s"), _amount("rad"), _amount("1")
_Modulus, _PerLength = _amount("pN/um^2"), _amount("1/um")
# bool is an int to Python; a count must not be one.
_Count = Annotated[int, Field(strict=True)]


def _history(unit: str, name: str) -> type[BaseModel]:
    return create_model(
        name,
        __base__=_Table,
        times=(list[_Time], Field(min_length=1)),
        values=(list[_amount(unit)], Field(min_length=1)),
    )


_AngleHistory = _history("rad", "HeadingHistory")
_FactorHistory = _history("1", "FactorHistory")


class _CommandsTable(_Table):
    heading: _AngleHistory | None = None  # type: ignore[valid-type]
    amplitude: _FactorHistory | None = None  # type: ignore[valid-type]


def _effect_table(effect: type[Effect]) -> type[BaseModel]:
    fields: dict[str, Any] = {}
    for item in dataclasses.fields(effect):
        if isinstance(item.default, History):
            fields[item.name] = (_FactorHistory | None, None)
            continue
        meta = item.metadata
        kind = Literal[meta["choices"]] if meta["choices"] else _amount(meta["unit"])
        fields[item.name] = (
            kind | None,
            Field(default=None, description=f"{meta['about']} [{meta['unit']}] ({meta['source']})"),
        )
    return create_model(f"{effect.__name__}Table", __base__=_Table, **fields)


_EffectsTable = create_model(
    "EffectsTable",
    __base__=_Table,
    **{name: (_effect_table(effect) | None, None) for name, effect in EFFECTS.items()},
)


class _InclusionTable(_Table):
    center: tuple[_Length, _Length]
    radius: _Length
    factor: _Number


class _GradientTable(_Table):
    direction: _Angle
    per_um: _Number


class _MatrixTable(_Table):
    kind: Literal["disc"] = "disc"
    diameter: _Length = 60.0
    thickness: _Length = 2.0
    modulus: _Modulus = 5000.0
    nodes: _Count | None = None
    seed: _Count | None = None
    inclusion: _InclusionTable | None = None
    gradient: _GradientTable | None = None


class _CellTable(_Table):
    position: tuple[_Length, _Length] = (0.0, 0.0)
    polarity: _Angle = 0.0
    radius: _Length = 8.0
    effects: _EffectsTable | None = None  # type: ignore[valid-type]
    commands: _CommandsTable | None = None


class _TrainingTable(_Table):
    runs: _Count = 8
    held_out: _Count = 2
    duration: _Time = 1500.0
    sample: _Time = 5.0


class _SceneTable(_Table):
    name: Annotated[str, Field(min_length=1)]
    duration: _Time
    sample: _Time = 5.0
    step: _Time = 0.5
    seed: _Count = 0
    matrix: _MatrixTable | None = None
    cells: list[_CellTable] = []
    effects: _EffectsTable = _EffectsTable()  # type: ignore[valid-type]
    commands: _CommandsTable = _CommandsTable()
    training: _TrainingTable = _TrainingTable()


def scene_schema() -> dict[str, Any]:
    """JSON schema of a scene file, for editors."""
    return _SceneTable.model_json_schema()


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
    try:
        parsed = _SceneTable.model_validate(dict(table))
    except ValidationError as error:
        raise SceneError("; ".join(_explain(item) for item in error.errors())) from error
    try:
        return _scene(parsed)
    except SceneError:
        raise
    except CellsysError as error:
        raise SceneError(str(error)) from error


def _scene(parsed: _SceneTable) -> Scene:
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


def _matrix(table: _MatrixTable | None) -> MatrixScene | None:
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
        given = {k: v for k, v in given.items() if v is not None}
        effects[name] = EFFECTS[name](
            **{k: _as_history(v) if isinstance(v, BaseModel) else v for k, v in given.items()}
        )
    return effects


def _as_history(table: Any) -> History:
    return History(tuple(table.times), tuple(table.values))


def _commands(table: _CommandsTable) -> Commands:
    return Commands(
        None if table.heading is None else _as_history(table.heading),
        None if table.amplitude is None else _as_history(table.amplitude),
    )


def _known_keys(location: tuple) -> list[str]:
    """Keys allowed in the table at `location` of a scene file."""
    model: Any = _SceneTable
    for part in location:
        if isinstance(part, int):
            continue
        field = model.model_fields.get(part) if hasattr(model, "model_fields") else None
        if field is None:
            return []
        model = next((m for m in _models(field.annotation)), None)
        if model is None:
            return []
    return list(model.model_fields)


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for a in getattr(annotation, "__args__", ()) for m in _models(a)]


def _explain(item: Mapping[str, Any]) -> str:
    location = tuple(item["loc"])
    path = ""
    for part in location:
        path += f"[{part}]" if isinstance(part, int) else f".{part}" if path else str(part)
    if item["type"] == "extra_forbidden":
        known = _known_keys(location[:-1])
        near = difflib.get_close_matches(str(location[-1]), known, 1, 0.5)
        hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}"
        return f"unknown key {path!r}; {hint}"
    if item["type"] == "missing":
        return f"{path} is missing"
    message = item["msg"].removeprefix("Value error, ").removeprefix("value ")
    value = item.get("input")
    shown = repr(value) if len(repr(value)) < 60 else type(value).__name__
    if isinstance(value, float) and not math.isfinite(value):
        shown = f"{value}"
    return f"{path}: {message} (got {shown})"


def scene_from_plain(table: Mapping[str, Any]) -> Scene:
    """A scene from what `Scene.canonical` gave (values in internal units)."""

    def history(value: Any) -> History | None:
        return None if value is None else History(tuple(value["times"]), tuple(value["values"]))

    def commands(value: Any) -> Commands | None:
        if value is None:
            return None
        return Commands(history(value["heading"]), history(value["amplitude"]))

    def effects(values: Mapping[str, Any]) -> dict[str, Effect]:
        out = {}
        for name, given in values.items():
            fields = {k: v for k, v in given.items() if k != "effect"}
            if isinstance(fields.get("history"), Mapping):
                fields["history"] = history(fields["history"])
            out[name] = EFFECTS[given["effect"]](**fields)
        return out

    matrix = table["matrix"]
    if matrix is not None:
        inclusion, gradient = matrix["inclusion"], matrix["gradient"]
        if inclusion is not None:
            inclusion = Inclusion(**{**inclusion, "center": tuple(inclusion["center"])})
        gradient = None if gradient is None else Gradient(**gradient)
        matrix = MatrixScene(**{**matrix, "inclusion": inclusion, "gradient": gradient})
    cells = tuple(
        CellScene(
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
