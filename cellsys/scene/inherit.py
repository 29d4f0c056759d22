"""Where a scene file comes from: a path, a preset by name, and what it `extends`.

A scene with ``extends = "two_cells"`` (a preset) or ``extends = "base.toml"`` (a file beside it)
starts from that scene. Its tables are merged key by key; a number, a string or a list, [[cells]]
among them, replaces the older one. ``effect = false`` under [effects] takes an effect out, and
so does ``false`` a table that may be left out: ``matrix.inclusion = false``, ``training = false``.
"""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path

from cellsys.arguments import checked
from cellsys.errors import FileFormatError, SceneError
from cellsys.kinds import shown
from cellsys.store.regular import open_regular

_MOST_BYTES = 1e6  # of a scene file: the presets have a few kB
_MOST_BASES = 32  # scenes that extend each other
MOST_PARTS = 16  # of a dotted key: tables of a scene lie within five others
_PART = r"""(?:[A-Za-z0-9_-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(
    rf"(?<![A-Za-z0-9_\-.\"']){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MOST_PARTS},}}"
)
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


def read_table(source: Path) -> dict[str, object]:
    """The TOML table in a file; SceneError when it cannot be read."""
    try:
        with open_regular(source, _MOST_BYTES) as file:
            text = file.read().decode("utf-8")
        return parse_toml(text)
    except FileFormatError as error:  # it has the name
        raise SceneError(str(error)) from error
    except SceneError as error:
        raise SceneError(f"{source.name}: {error}") from error
    except UnicodeDecodeError as error:
        raise SceneError(f"{source.name}: not a TOML file: {error}") from error
    except OSError as error:
        raise SceneError(f"{source.name}: cannot be read: {error}") from error


def parse_toml(text: str) -> dict[str, object]:
    """A TOML text as a table; SceneError where it is none, or too deep, or holds a huge number."""
    if found := _LONG_KEY.search(text):
        # The parser takes a time that grows with the square of the parts of a key.
        line = text.count("\n", 0, found.start()) + 1
        raise SceneError(f"line {line}: a key of more than {MOST_PARTS} parts")
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"not a TOML file: {error}") from error
    except ValueError as error:  # a whole number of more digits than Python reads
        raise SceneError(f"a number that cannot be read: {error}") from error
    except RecursionError as error:
        raise SceneError("nested too deeply") from error
    level: list[object] = [table]
    for _ in range(MOST_PARTS + 1):
        level = [entry for value in level for entry in _entries(value)]
    if level:
        raise SceneError(f"nested too deeply: tables and lists more than {MOST_PARTS} deep")
    return table


def _entries(value: object) -> Iterable[object]:
    """What a table or a list holds."""
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list) else ()


def inherited(table: Mapping[str, object], folder: Path) -> dict[str, object]:
    """The table merged into what it extends, without the effects that were set to false.

    Raises
    ------
    SceneError
        When ``extends`` is not a name, does not exist, or leads back to itself.
    """
    merged = _merged(table, folder, ())
    effects = merged.get("effects")
    if isinstance(effects, Mapping):
        merged["effects"] = {k: v for k, v in effects.items() if v is not False}
    return merged


def _merged(table: Mapping[str, object], folder: Path, seen: tuple[Path, ...]) -> dict[str, object]:
    own = {key: value for key, value in table.items() if key != "extends"}
    base = table.get("extends")
    if base is None:
        return own
    if not isinstance(base, str) or not base:
        raise SceneError(f"extends must be a preset or a scene file, got {shown(base)}")
    beside = folder / base
    try:
        source = find_scene(beside if beside.exists() else base).resolve()
    except (OSError, ValueError) as error:
        raise SceneError(f"extends = {shown(base)}: {error}") from error
    if len(seen) >= _MOST_BASES:
        raise SceneError(
            f"extends = {base!r}: more than {_MOST_BASES} scenes extend each other; put some of "
            "them into one"
        )
    if source in seen:
        chain = " -> ".join(path.name for path in (*seen[seen.index(source) :], source))
        raise SceneError(f"extends = {base!r} leads back to itself: {chain}")
    older = _merged(read_table(source), source.parent, (*seen, source))
    return _joined(_own_steps(older, own), own)


def _own_steps(older: Mapping[str, object], newer: Mapping[str, object]) -> dict[str, object]:
    """The older scene without the settings of its stepper that the newer one says anew.

    A stepper's settings go with it, and ``step`` and ``run.step`` are one number.
    """
    run, before = newer.get("run"), older.get("run")
    run, before = (r if isinstance(r, Mapping) else {} for r in (run, before))
    gone = {"step", "tolerance"} if "stepper" in run else set()
    if "step" in newer or "step" in run:
        gone |= {"step"}
    out = {key: value for key, value in older.items() if key not in gone & {"step"}}
    if before:
        out["run"] = {key: value for key, value in before.items() if key not in gone}
    return out


def _joined(older: Mapping[str, object], newer: Mapping[str, object]) -> dict[str, object]:
    out = dict(older)
    for key, value in newer.items():
        before = out.get(key)
        if isinstance(value, Mapping) and isinstance(before, Mapping):
            out[key] = _joined(before, value)
        else:
            out[key] = value
    return out
