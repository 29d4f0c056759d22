"""The JSON schema of scene files in the form that editors complete from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cellsys.scene.inherit import preset_names


def for_editors(schema: Mapping[str, object]) -> dict[str, object]:
    """A pydantic schema without null (TOML has none), with presets and ``table = false``.

    A scene that extends another one may leave out its name and duration.
    """
    out = _without_null(schema)
    tables = out.get("$defs", {})
    for name, table in tables.items():
        properties = table.get("properties", {})
        effects = name.startswith("EffectsTable")
        needed = table.get("required", [])
        for key, value in properties.items():
            if effects or (key not in needed and _is_table(value)):
                properties[key] = {"anyOf": [value, {"const": False}]}
        if "extends" in properties:
            properties["extends"]["examples"] = preset_names()
            needed = table.pop("required", [])
            table["anyOf"] = [{"required": needed}, {"required": ["extends"]}]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "cellsys scene",
        "description": "A scene of cells on a matrix. In the first line of the TOML file: "
        "#:schema ./scene.schema.json",
        **out,
    }


def _is_table(value: Mapping[str, object]) -> bool:
    """Whether a key holds a table, which ``false`` takes out of what a scene extends."""
    options = value.get("anyOf", [value])
    return isinstance(options, list) and any("$ref" in option for option in options)


def _without_null(value: Any) -> Any:
    if isinstance(value, Mapping):
        out = {k: _without_null(v) for k, v in value.items() if not (k == "default" and v is None)}
        options = out.get("anyOf")
        if isinstance(options, list):
            options = [o for o in options if o != {"type": "null"}]
            if len(options) == 1 and isinstance(options[0], Mapping):
                out.pop("anyOf")
                return {**options[0], **out}
            out["anyOf"] = options
        return out
    if isinstance(value, list):
        return [_without_null(v) for v in value]
    return value
