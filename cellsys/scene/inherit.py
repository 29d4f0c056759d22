"""Where a scene file comes from: a path, a preset by name, and what it `extends`.

A scene with ``extends = "two_cells"`` (a preset) or ``extends = "base.toml"`` (a file beside it)
starts from that scene. Its tables are merged key by key; a number, a string or a list, [[cells]]
among them, replaces the older one. ``effect = false`` under [effects] takes an effect out.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cellsys.arguments import checked
from cellsys.errors import SceneError

PRESETS = Path(__file__).parent / "presets"


@checked
def preset_names() -> list[str]:
    """Scenes that come with cellsys and can be named instead of a file."""
    return sorted(path.stem for path in PRESETS.glob("*.toml"))


def find_scene(path: str | Path) -> Path:
    """The file of a scene: the path itself, or the preset of that name.

    Raises
    ------
    FileNotFoundError
        When there is neither; the nearest preset is offered.
    """
    source = Path(path)
    if source.exists():
        return source
    presets = preset_names()
    if str(path) in presets:
        return PRESETS / f"{path}.toml"
    near = difflib.get_close_matches(str(path), presets, 1, 0.5)
    hint = f"did you mean {near[0]!r}?" if near else f"presets: {', '.join(presets)}"
    raise FileNotFoundError(f"no scene file {str(source)!r} and no preset of that name; {hint}")


def read_table(source: Path) -> dict[str, Any]:
    """The TOML table in a file; SceneError when it cannot be read."""
    try:
        return tomllib.loads(source.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"{source.name}: not a TOML file: {error}") from error
    except OSError as error:
        raise SceneError(f"{source.name}: cannot be read: {error}") from error
    except RecursionError as error:
        raise SceneError(f"{source.name}: nested too deeply") from error


def inherited(table: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The table merged into what it extends, without the effects that were set to false.

    Raises
    ------
    SceneError
        When ``extends`` is not a name, does not exist, or leads back to itself.
    """
    merged = _merged(table, folder, ())
    if isinstance(merged.get("effects"), Mapping):
        merged["effects"] = {k: v for k, v in merged["effects"].items() if v is not False}
    return merged


def _merged(table: Mapping[str, Any], folder: Path, seen: tuple[Path, ...]) -> dict[str, Any]:
    own = {key: value for key, value in table.items() if key != "extends"}
    base = table.get("extends")
    if base is None:
        return own
    if not isinstance(base, str) or not base:
        raise SceneError(f"extends must be a preset or a scene file, got {base!r}")
    beside = folder / base
    try:
        source = find_scene(beside if beside.is_file() else base).resolve()
    except (OSError, ValueError) as error:
        raise SceneError(f"extends = {base!r}: {error}") from error
    if source in seen:
        chain = " -> ".join(path.name for path in (*seen[seen.index(source) :], source))
        raise SceneError(f"extends = {base!r} leads back to itself: {chain}")
    older = _merged(read_table(source), source.parent, (*seen, source))
    return _joined(older, own)


def _joined(older: Mapping[str, Any], newer: Mapping[str, Any]) -> dict[str, Any]:
    out = dict(older)
    for key, value in newer.items():
        if isinstance(value, Mapping) and isinstance(out.get(key), Mapping):
            out[key] = _joined(out[key], value)
        else:
            out[key] = value
    return out
