"""How scene files hold each kind of matrix: disc, chain, those of other packages and of scripts.

Another package adds a kind of matrix by

    [project.entry-points."cellsys.matrices"]
    sheet = "my_package.sheet:Sheet"

and a script by `load_scene(path, matrices=[Sheet])`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache, partial
from importlib.metadata import entry_points
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel, create_model

from cellsys.contracts import MatrixKind
from cellsys.effects.commands import Commands, History
from cellsys.effects.protocol import Effect
from cellsys.errors import ParameterError, SceneError
from cellsys.kinds import parts_of
from cellsys.scene.chain import ChainScene, ChainSceneTable, chain_parts
from cellsys.scene.disc import MatrixScene
from cellsys.scene.gel import GelScene
from cellsys.scene.parts import CellScene, Gradient, Inclusion, Training
from cellsys.scene.plan import Kind
from cellsys.scene.registry import Registry
from cellsys.scene.steppers import step_told, stepper_told
from cellsys.scene.tables import (
    CommandsTable,
    DiscSceneTable,
    DiscTable,
    GelSceneTable,
    GelTable,
    TomlTable,
    parameter_table,
)

GROUP = "cellsys.matrices"


class Form(NamedTuple):
    """A kind of matrix in a file: table of its scenes, and what is made of them.

    `fields` gives the arguments of `Scene` of a parsed table, `restore` a matrix from what
    `Scene.canonical` says of it.
    """

    table: type[TomlTable]
    fields: Callable[[Any, Registry], dict[str, Any]]
    restore: Callable[[Mapping[str, Any]], Kind]


def forms(given: Iterable[type] = (), asked: str | None = "disc") -> dict[str, Form]:
    """Forms by the name of their kind; other packages are looked through for an unknown `asked`.

    `given` are classes of a script; `asked` None takes all there are.

    Raises
    ------
    ParameterError
        A class that is no kind of matrix, or a name that is taken.
    """
    out = dict(SHIPPED)
    for cls in given:
        _add(out, cls, repr(cls))
    if asked not in out:
        for point in sorted(entry_points(group=GROUP)):
            try:
                cls = point.load()
            except (ImportError, AttributeError) as error:
                raise ParameterError(
                    f"matrix {point.name!r} = {point.value!r} does not load: {error}"
                ) from error
            _add(out, cls, point.value)
    return out


def _add(out: dict[str, Form], cls: object, label: str) -> None:
    kind = check_matrix(cls, label)
    if kind in out:
        raise ParameterError(f"there is a matrix kind {kind!r} already; give yours another name")
    out[kind] = _own(cls, kind)


def check_matrix(cls: object, label: str) -> str:
    """Kind of a class of matrices; ParameterError for anything else, with what it lacks."""
    if not (isinstance(cls, type) and dataclasses.is_dataclass(cls)):
        raise ParameterError(f"{label} is not a dataclass of a matrix's parameters")
    members = {name for base in cls.__mro__ for name in vars(base)}
    lacks = [name for name in parts_of(MatrixKind) if name not in members]
    if lacks:
        raise ParameterError(f"{label} is no kind of matrix: it has no {', '.join(lacks)}")
    kind = vars(cls).get("kind")
    if not (isinstance(kind, str) and kind.isidentifier()):
        raise ParameterError(f"{label} needs a kind of its own, a word such as 'sheet'")
    return kind


@lru_cache(maxsize=64)
def _own(cls: type, kind: str) -> Form:
    """Form of a matrix of one's own: its parameters with units, under cells with a membrane."""
    parameters = parameter_table(cls)
    name = cls.__name__
    fields: dict[str, Any] = {"kind": (Literal.__getitem__(kind), kind)}
    matrix = create_model(f"{name}MatrixTable", __base__=parameters, **fields)
    table = create_model(f"{name}SceneTable", __base__=DiscSceneTable, matrix=(matrix, ...))

    def made(values: BaseModel) -> Kind:
        given = {k: getattr(values, k) for k in parameters.model_fields}
        return cls(**{k: v for k, v in given.items() if v is not None})

    def restored(values: Mapping[str, Any]) -> Kind:
        return cls(**{k: v for k, v in values.items() if k not in ("kind", "origin")})

    return Form(table, partial(_plane_fields, matrix=made), restored)


def _plane_fields(
    parsed: Any, registry: Registry, matrix: Callable[[Any], Kind | None]
) -> dict[str, Any]:
    kind = "none" if parsed.matrix is None else parsed.matrix.kind
    for name, value, least in (
        ("seed", parsed.seed, 0),
        ("training.runs", parsed.training.runs, 1),
        ("training.held_out", parsed.training.held_out, 1),
    ):
        if value < least:
            raise SceneError(f"{name} must be >= {least}, got {value}")
    steps = {
        "step": parsed.step if "step" in parsed.model_fields_set else None,
        "run.step": parsed.run.step,
    }
    stepper = stepper_told(steps, parsed.run.stepper, parsed.run.tolerance)
    return dict(
        name=parsed.name,
        duration=parsed.duration,
        sample=parsed.sample,
        step=step_told(steps, stepper),
        stepper=stepper,
        tolerance=parsed.run.tolerance,
        seed=parsed.seed,
        until=parsed.until,
        matrix=matrix(parsed.matrix),
        cells=tuple(
            CellScene(
                position=c.position,
                polarity=c.polarity,
                elevation=c.elevation,
                radius=c.radius,
                effects=_effects(c.effects, registry, kind) if c.effects is not None else {},
                commands=_commands(c.commands) if c.commands is not None else None,
            )
            for c in parsed.cells
        ),
        effects=_effects(parsed.effects, registry, kind),
        commands=_commands(parsed.commands),
        training=Training(**parsed.training.model_dump()),
        learn="training" in parsed.model_fields_set,
    )


def _chain_fields(parsed: Any, registry: Registry) -> dict[str, Any]:
    matrix, cells = chain_parts(parsed)
    return dict(
        name=parsed.name,
        duration=parsed.duration,
        sample=parsed.sample,
        matrix=matrix,
        cells=cells,
        effects=_effects(parsed.effects, registry, "chain"),
    )


def _gel_fields(parsed: Any, registry: Registry) -> dict[str, Any]:
    """As of a disc, stepped by RKC unless the scene names another method."""
    run = parsed.run
    if run.stepper is None:
        told = {"step": "step" in parsed.model_fields_set, "run.step": run.step is not None}
        for key in (k for k, given in told.items() if given):
            raise SceneError(
                f"{key} is given and a gel is stepped by RKC, which finds its own; leave it out, "
                "or name run.stepper"
            )
        if run.tolerance is None:
            parsed = parsed.model_copy(update={"run": run.model_copy(update={"stepper": "auto"})})
    return _plane_fields(parsed, registry, _gel)


def _gel(table: GelTable) -> GelScene:
    values = table.model_dump(exclude={"cavities"})
    cavities = tuple((*c.center, c.radius) for c in table.cavities)
    return GelScene(**values, cavities=cavities)


def _disc(table: DiscTable | None) -> MatrixScene | None:
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
        kind=table.kind,
        diameter=table.diameter,
        thickness=table.thickness,
        modulus=table.modulus,
        nodes=table.nodes,
        seed=table.seed,
        inclusion=inclusion,
        gradient=gradient,
    )


def _effects(table: BaseModel, registry: Registry, matrix: str) -> dict[str, Effect]:
    """Effects of a table, at their defaults on this kind of matrix where it says nothing."""
    effects = {}
    for name in sorted(table.model_fields_set, key=registry.place):
        values = getattr(table, name)
        if values is None:
            continue
        given = {k: getattr(values, k) for k in type(values).model_fields}
        for item in dataclasses.fields(registry[name]):
            other = item.metadata.get("elsewhere", {}).get(matrix)
            if other is not None and given.get(item.name) is None:
                given[item.name] = other
        effects[name] = _effect(registry[name], given)
    return effects


def _effect(kind: type[Effect], given: Mapping[str, object]) -> Effect:
    values: dict[str, object] = {}
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


def _restored_disc(values: Mapping[str, Any]) -> MatrixScene:
    inclusion, gradient = values["inclusion"], values["gradient"]
    if inclusion is not None:
        inclusion = Inclusion(**{**inclusion, "center": tuple(inclusion["center"])})
    gradient = None if gradient is None else Gradient(**gradient)
    return MatrixScene(**{**values, "inclusion": inclusion, "gradient": gradient})


def _restored_gel(values: Mapping[str, Any]) -> GelScene:
    cavities = tuple(tuple(c) for c in values["cavities"])
    return GelScene(**{**values, "cavities": cavities})


def _restored_chain(values: Mapping[str, Any]) -> ChainScene:
    return ChainScene(**values)


SHIPPED = {
    "disc": Form(DiscSceneTable, partial(_plane_fields, matrix=_disc), _restored_disc),
    "gel": Form(GelSceneTable, _gel_fields, _restored_gel),
    "chain": Form(ChainSceneTable, _chain_fields, _restored_chain),
}
