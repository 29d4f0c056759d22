"""What a scene file may hold: one pydantic table per TOML table, quantities with their units."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from types import GenericAlias
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from pydantic import (
    AliasChoices,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    WithJsonSchema,
    create_model,
    model_validator,
)
from pydantic_core import ErrorDetails

from cellsys.effects.commands import History
from cellsys.effects.protocol import Effect
from cellsys.kinds import shown
from cellsys.scene.steppers import STEPPERS
from cellsys.units import quantity


class TomlTable(BaseModel):
    """A TOML table whose unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _taken_out(cls, values: object) -> object:
        """Without the tables that are set to false: what a scene extends had them."""
        if not isinstance(values, Mapping):
            return values
        return {k: v for k, v in values.items() if v is not False or not cls._may_go(k)}

    @classmethod
    def _may_go(cls, key: str) -> bool:
        """Whether a key names a table that may be left out."""
        field = cls.model_fields.get(key)
        return field is not None and not field.is_required() and bool(_models(field.annotation))


def _converter(unit: str) -> Callable[[str | float], float]:
    return lambda value: quantity(value, unit)


def amount(unit: str) -> Any:
    """Field type of a quantity: a string with a unit like `unit`, a float in internal units."""
    schema = {"type": "string", "description": f"number with unit, such as '1 {unit}'"}
    return Annotated[
        float,
        BeforeValidator(_converter(unit)),
        WithJsonSchema({"type": ["string", "number"]} if unit == "1" else schema),
    ]


if TYPE_CHECKING:
    _Length: TypeAlias = float
    Time: TypeAlias = float
    Angle: TypeAlias = float
    _Number: TypeAlias = float
    _Modulus: TypeAlias = float
    _PerLength: TypeAlias = float
else:  # what a type checker cannot look into: the unit is told by a call
    _Length, Time, Angle, _Number = amount("um"), amount("s"), amount("rad"), amount("1")
    _Modulus, _PerLength = amount("pN/um^2"), amount("1/um")
Sample = Annotated[
    Time,
    Field(description="number with unit, such as '1 s', between samples; divides the duration"),
]
# bool is an int to Python; a count must not be one.
Count = Annotated[int, Field(strict=True)]
Flag = Annotated[bool, Field(strict=True)]


def _history(unit: str, name: str) -> type[BaseModel]:
    fields: dict[str, Any] = {
        "times": (list[Time], Field(min_length=1)),
        "values": (GenericAlias(list, (amount(unit),)), Field(min_length=1)),
    }
    return create_model(name, __base__=TomlTable, **fields)


_AngleHistory = _history("rad", "HeadingHistory")
_FactorHistory = _history("1", "FactorHistory")


Extends = Annotated[
    str | None, Field(description="preset or scene file (toml) that this scene changes")
]


class CommandsTable(TomlTable):
    """Prescribed heading and amplitude."""

    heading: _AngleHistory | None = None  # type: ignore[valid-type]
    amplitude: _FactorHistory | None = None  # type: ignore[valid-type]


def parameter_table(effect: type) -> type[BaseModel]:
    """Table of the fields that `parameter` made, of an effect or of a matrix of one's own."""
    return _parameter_table(effect)


@lru_cache(maxsize=256)
def _parameter_table(effect: type) -> type[BaseModel]:
    fields: dict[str, Any] = {}
    for item in dataclasses.fields(effect):
        if isinstance(item.default, History):
            fields[item.name] = (_FactorHistory | None, None)
            continue
        if "unit" not in item.metadata:
            continue  # further patches, added below
        meta = item.metadata
        kind = Literal[meta["choices"]] if meta["choices"] else amount(meta["unit"])
        if meta["flag"]:
            kind = Flag
        told = f"{meta['about']} [{meta['unit']}] ({meta['source']})"
        names = AliasChoices(item.name, meta["once"]) if meta["once"] else None
        fields[item.name] = (
            kind | None,
            Field(default=None, description=told, validation_alias=names),
        )
    table = create_model(f"{effect.__name__}Table", __base__=TomlTable, **fields)
    table.__doc__ = (effect.__doc__ or effect.__name__).strip().split("\n")[0]
    if any(item.name == "patches" for item in dataclasses.fields(effect)):
        # Further ones of the same kind, which act together with the first.
        fields = {"patches": (GenericAlias(list, (table,)), [])}
        table = create_model(f"{effect.__name__}sTable", __base__=table, **fields)
    return table


def effects_table(names: Iterable[str], chosen: Iterable[type[Effect]]) -> type[TomlTable]:
    """[effects] that knows all `names` and can read the `chosen` effects.

    The tables of effects that a scene does not name are not made, nor their files imported.
    """
    fields: dict[str, Any] = {name: (Any, None) for name in names}
    fields |= {effect.name: (parameter_table(effect) | None, None) for effect in chosen}
    return create_model("EffectsTable", __base__=TomlTable, **fields)


class _InclusionTable(TomlTable):
    center: tuple[_Length, _Length]
    radius: _Length
    factor: _Number


class _GradientTable(TomlTable):
    direction: Angle
    per_um: _Number


class DiscTable(TomlTable):
    """[matrix] of kind disc."""

    kind: Literal["disc"] = "disc"
    diameter: _Length = 60.0
    thickness: _Length = 2.0
    modulus: _Modulus = 5000.0
    nodes: Count | None = None
    seed: Count | None = None
    inclusion: _InclusionTable | None = None
    gradient: _GradientTable | None = None


class _CavityTable(TomlTable):
    center: tuple[_Length, _Length, _Length]
    radius: _Length


class GelTable(TomlTable):
    """[matrix] of kind gel."""

    kind: Literal["gel"]
    shape: Literal["cylinder", "box"] = "cylinder"
    length: _Length = 100.0
    diameter: _Length | None = None
    width: _Length | None = None
    height: _Length | None = None
    modulus: _Modulus = 500.0
    nodes: Count | None = None
    coordination: _Number = 9.0
    ends: Literal["clamped", "free"] = "clamped"
    cavities: list[_CavityTable] = []
    seed: Count | None = None


class _CellTable(TomlTable):
    position: tuple[_Length, _Length] | tuple[_Length, _Length, _Length] = (0.0, 0.0)
    polarity: Angle = 0.0
    elevation: Angle = 0.0
    radius: _Length = 8.0
    effects: dict[str, object] | None = None
    commands: CommandsTable | None = None


class _TrainingTable(TomlTable):
    runs: Count = 8
    held_out: Count = 2
    duration: Time = 1500.0
    sample: Sample = 5.0
    commands: Literal["constant", "turning"] = "constant"
    loaded: Count = 0
    scatter: _Length = 0.0


class _RunTable(TomlTable):
    """What steps the scene through time."""

    stepper: Annotated[
        str | None,
        Field(
            description="auto: what suits the scene; BDF2: second order; RKC: explicit, by a "
            "tolerance; LinearlyImplicit: first order (the default)",
            json_schema_extra={"enum": list(STEPPERS)},
        ),
    ] = None
    step: Annotated[Time | None, Field(description="longest step, number with unit")] = None
    tolerance: Annotated[
        _Number | None,
        Field(description="local error of RKC; share of a rate that the others leave over"),
    ] = None


class DiscSceneTable(TomlTable):
    """A scene with a disc, or without a matrix."""

    extends: Extends = None
    name: Annotated[str, Field(min_length=1)]
    duration: Time
    sample: Sample = 5.0
    step: Time = 0.5
    run: _RunTable = _RunTable()
    until: Annotated[
        Literal["contact"] | None, Field(description="ends the run where two cells touch")
    ] = None
    seed: Count = 0
    matrix: DiscTable | None = None
    cells: list[_CellTable] = []
    effects: dict[str, object] = Field(default_factory=dict)
    commands: CommandsTable = CommandsTable()
    training: _TrainingTable = _TrainingTable()


class GelSceneTable(DiscSceneTable):
    """A scene in a gel."""

    matrix: GelTable  # type: ignore[assignment]


def with_effects(scene: type[TomlTable], effects: type[TomlTable]) -> type[TomlTable]:
    """A scene table whose [effects], and those of its cells, are read by `effects`."""
    fields: dict[str, Any] = {"effects": (effects, effects())}
    (cell,) = _models(scene.model_fields["cells"].annotation)
    if "effects" in cell.model_fields:
        name = cell.__name__.lstrip("_")
        own: dict[str, Any] = {"effects": (effects | None, None)}
        cell = create_model(name, __base__=cell, **own)
        fields["cells"] = (GenericAlias(list, (cell,)), [])
    return create_model(scene.__name__, __base__=scene, **fields)


def _known_keys(location: tuple, scene: type[TomlTable]) -> list[str]:
    """Keys allowed in the table at `location` of a scene file."""
    model: type[BaseModel] = scene
    for part in location:
        if isinstance(part, int):
            continue
        field = model.model_fields.get(part)
        if field is None:
            return []
        inside = _models(field.annotation)
        if not inside:
            return []
        model = inside[0]
    return list(model.model_fields)


def _models(annotation: object) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for a in getattr(annotation, "__args__", ()) for m in _models(a)]


_LONGEST = 60  # characters of a key or a value that a message shows


def explain(item: ErrorDetails, kinds: Mapping[str, type[TomlTable]], kind: str) -> str:
    """One mistake of a scene file in words; `kinds` are the scene tables by matrix.kind."""
    location = tuple(item["loc"])
    path = ""
    for part in location:
        path += f"[{part}]" if isinstance(part, int) else f".{part}" if path else str(part)
    path = path if len(path) <= 4 * _LONGEST else f"{path[: 4 * _LONGEST]}..."
    if item["type"] == "extra_forbidden":
        known = _known_keys(location[:-1], kinds[kind])
        near = difflib.get_close_matches(str(location[-1])[:_LONGEST], known, 1, 0.5)
        hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}"
        for other, table in kinds.items():
            if other != kind and location[-1] in _known_keys(location[:-1], table):
                hint = f"it belongs to matrix.kind = {other!r}, not to {kind!r}; {hint}"
        return f"unknown key {path!r}; {hint}"
    if item["type"] == "missing":
        return f"{path} is missing"
    message = item["msg"].removeprefix("Value error, ").removeprefix("value ")
    value = item.get("input")
    got = shown(value)
    if isinstance(value, (list, tuple, dict)) and len(value) < 8 and len(repr(value)) < _LONGEST:
        got = repr(value)
    return f"{path}: {message} (got {got})"
