"""Scene files as the arguments of `Scene`; unknown keys are refused with the nearest known one."""

from __future__ import annotations

import functools
import operator
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from cellsys.arguments import checked
from cellsys.effects.protocol import Effect
from cellsys.errors import CellsysError, ParameterError, SceneError
from cellsys.scene.forms import Form, forms
from cellsys.scene.inherit import inherited
from cellsys.scene.registry import Registry
from cellsys.scene.schema import for_editors
from cellsys.scene.tables import TomlTable, effects_table, explain, with_effects


@lru_cache(maxsize=64)
def _tables(
    names: tuple[str, ...],
    chosen: tuple[type[Effect], ...],
    scenes: tuple[tuple[str, type[TomlTable]], ...],
) -> dict[str, type[TomlTable]]:
    table = effects_table(names, chosen)
    return {kind: with_effects(scene, table) for kind, scene in scenes}


def _scenes(known: Mapping[str, Form]) -> tuple[tuple[str, type[TomlTable]], ...]:
    return tuple((kind, form.table) for kind, form in known.items())


@checked
def scene_schema(
    effects: Iterable[type[Effect]] = (), matrices: Iterable[type] = ()
) -> dict[str, Any]:
    """JSON schema of a scene file, for editors; `effects` and `matrices` as in `load_scene`."""
    registry = Registry(effects)
    known = forms(matrices, asked=None)
    tables = _tables(tuple(registry), tuple(registry.values()), _scenes(known))
    either = functools.reduce(operator.or_, tables.values())
    return for_editors(TypeAdapter(either).json_schema())


def scene_fields(
    table: Mapping[str, object],
    *,
    effects: Iterable[type[Effect]] = (),
    matrices: Iterable[type] = (),
    folder: Path | None = None,
) -> dict[str, Any]:
    """Arguments of `Scene` from a mapping shaped like a scene file; see `parse_scene`."""
    table = inherited(table, Path() if folder is None else folder)
    matrix = table.get("matrix")
    kind = matrix.get("kind", "disc") if isinstance(matrix, Mapping) else "disc"
    try:
        known = forms(matrices, kind if isinstance(kind, str) else "disc")
        if not (isinstance(kind, str) and kind in known):
            *first, last = map(repr, known)
            raise SceneError(f"matrix.kind: must be {', '.join(first)} or {last} (got {kind!r})")
        registry = Registry(effects)
        named = [n for n in _named_effects(table) if n in registry]
        tables = _tables(
            registry.names(named), tuple(registry[name] for name in named), _scenes(known)
        )
        parsed = tables[kind].model_validate(dict(table))
    except ValidationError as error:
        raise SceneError("; ".join(explain(i, tables, kind) for i in error.errors())) from error
    except SceneError:
        raise
    except ParameterError as error:
        raise SceneError(str(error)) from error
    try:
        return known[kind].fields(parsed, registry)
    except SceneError:
        raise
    except CellsysError as error:
        raise SceneError(str(error)) from error


def _named_effects(table: Mapping[str, object]) -> list[str]:
    """Names under [effects] and under the effects of any cell, each once."""
    cells = table.get("cells")
    places = [table, *(cells if isinstance(cells, list) else ())]
    tables = [p.get("effects") for p in places if isinstance(p, Mapping)]
    names = {name: None for t in tables if isinstance(t, Mapping) for name in t}
    return [name for name in names if isinstance(name, str)]
