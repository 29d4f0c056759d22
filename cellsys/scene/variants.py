"""Scenes made from a scene: with other values, or with one effect left out."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cellsys.errors import SceneError
from cellsys.kinds import shown
from cellsys.scene.inherit import MOST_PARTS, find_scene, inherited, parse_toml, read_table
from cellsys.scene.memory import memory_need
from cellsys.scene.scene import Scene, parse_scene
from cellsys.store.memory import size_text

MOST_SCENES = 10_000  # of one sweep: as many take half a minute to be read alone


def without(scene: Scene, name: str) -> tuple[Scene, tuple[str, ...]]:
    """The scene without an effect, and the effects that went with it because they need it.

    Raises
    ------
    SceneError
        When the scene does not have the effect, or is none without it.
    """
    if name not in scene.effects:
        raise SceneError(
            f"the scene has no effect {name!r}; it has {', '.join(scene.effects) or 'none'}"
        )
    gone = {name}
    while True:
        left = {n: e for n, e in scene.effects.items() if n not in gone}
        more = {
            n
            for n, e in left.items()
            for need in e.requires
            if not any(choice in left for choice in need.split("|"))
        }
        if not more:
            break
        gone |= more
    cells = tuple(
        dataclasses.replace(c, effects={n: e for n, e in c.effects.items() if n not in gone})
        for c in scene.membranes
    )
    return dataclasses.replace(scene, effects=left, cells=cells), tuple(sorted(gone - {name}))


def split_values(text: str) -> list[str]:
    """Values between commas; commas inside brackets, braces or quotes belong to a value."""
    values, depth, quote, start = [], 0, "", 0
    for place, sign in enumerate(text):
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "\"'":
            quote = sign
        elif sign in "[{":
            depth += 1
        elif sign in "]}":
            depth -= 1
        elif sign == "," and depth == 0:
            values.append(text[start:place].strip())
            start = place + 1
    return [*values, text[start:].strip()]


def read_value(text: str) -> object:
    """A TOML value, or the text itself: `3` is a number, `100 pN` a string."""
    try:
        table = parse_toml(f"value = {text}")
    except SceneError as error:
        if isinstance(error.__cause__, tomllib.TOMLDecodeError):
            return text
        raise
    return table["value"] if len(table) == 1 else text  # two lines with two keys are a text


def read_setting(text: str) -> tuple[str, list[str]]:
    """``key=value,value`` as the key and its values.

    Raises
    ------
    SceneError
        Without a key, an equals sign or a value.
    """
    key, equals, values = text.partition("=")
    listed = split_values(values)
    if not (equals and key.strip() and all(listed)):
        raise SceneError(
            f"--set {shown(text)} must read key=value,value such as "
            "effects.lamellipodium.force='100 pN,200 pN'"
        )
    return key.strip(), listed


def with_value(table: Mapping[str, object], key: str, value: object) -> dict[str, object]:
    """A copy of a scene table with the entry at a dotted key set; cells by number from 0.

    Raises
    ------
    SceneError
        When the key leads through something that is no table, or to a cell that does not exist.
    """
    out = copy.deepcopy(dict(table))
    place: Any = out
    parts = key.split(".")
    if not all(parts) or len(parts) > MOST_PARTS:
        raise SceneError(
            f"key {shown(key)} must be 1 to {MOST_PARTS} names between dots, none of them empty"
        )
    for depth, part in enumerate(parts):
        last = depth == len(parts) - 1
        if isinstance(place, list):
            if not (part.isdecimal() and len(part) < 9 and int(part) < len(place)):
                raise SceneError(
                    f"key {shown(key)}: {shown('.'.join(parts[:depth]))} has entries 0 to "
                    f"{len(place) - 1}, not {shown(part)}"
                )
            key_here: int | str = int(part)
        elif isinstance(place, dict):
            key_here = part
        else:
            raise SceneError(
                f"key {shown(key)}: {shown('.'.join(parts[:depth]))} is a value, not a table"
            )
        if last:
            place[key_here] = value
        else:
            if isinstance(place, dict):
                place.setdefault(key_here, {})
            place = place[key_here]
    return out


def _size(table: Mapping[str, object], folder: Path, count: int) -> str:
    """What so many runs of the scene as it stands take on the disk; empty where it is none."""
    try:
        record = memory_need(parse_scene(table, folder=folder)).record
    except SceneError:
        return ""  # it lacks what the settings give
    return f" ({size_text(count * record)} in all)"


def variants(
    path: str | Path, settings: Sequence[tuple[str, Sequence[str]]]
) -> list[tuple[dict[str, str], Scene]]:
    """All combinations of the values of some keys, each as (values by key, scene).

    Parameters
    ----------
    path : path or str
        Scene file or preset.
    settings : sequence of (key, values)
        Dotted keys of the scene file, values as they would stand in it.

    Raises
    ------
    SceneError
        For the first combination that is no scene, before anything is run.
    """
    source = find_scene(path)
    table = inherited(read_table(source), source.parent)
    keys = [key for key, _ in settings]
    if twice := sorted(key for key, times in Counter(keys).items() if times > 1):
        raise SceneError(f"key {shown(twice[0])} is set twice; list its values once")
    counts = [len(v) for _, v in settings]
    if math.prod(counts) > MOST_SCENES:
        raise SceneError(
            f"{' x '.join(map(str, counts))} values are {math.prod(counts)} combinations, each a "
            f"run{_size(table, source.parent, math.prod(counts))}; at most {MOST_SCENES} are taken "
            "at once: set fewer keys or values"
        )
    out = []
    for values in itertools.product(*(v for _, v in settings)):
        changed = table
        chosen = dict(zip(keys, values, strict=True))
        for key, value in chosen.items():
            changed = with_value(changed, key, read_value(value))
        label = ", ".join(f"{k} = {v}" for k, v in chosen.items())
        try:
            scene = parse_scene(changed, folder=source.parent)
        except SceneError as error:
            cut = label if len(label) <= 200 else f"{label[:200]}..."
            raise SceneError(f"{source.name} with {cut}: {error}") from error
        out.append((chosen, dataclasses.replace(scene, name=f"{scene.name}: {label}")))
    return out
