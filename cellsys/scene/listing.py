"""What effects there are, and what a scene builds of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cellsys.mechanics.crawler import CrawlerSystem
from cellsys.scene.build import build, spreading
from cellsys.scene.load import load_scene
from cellsys.scene.registry import EFFECTS
from cellsys.scene.timing import effect_of, time_shares


def effect_table() -> list[dict[str, str]]:
    """One row per parameter of every effect: default, unit, source, meaning."""
    rows = []
    for name, effect in EFFECTS.items():
        needs, outside = ", ".join(effect.needs), effect().outside_work
        for item in dataclasses.fields(effect):
            meta = item.metadata
            if "unit" not in meta:
                continue
            if meta["choices"]:
                default, unit = str(item.default), "|".join(meta["choices"])
            elif meta["flag"]:
                default, unit = str(item.default).lower(), "true|false"
            else:
                default, unit = f"{item.default:.4g}", meta["unit"]
            rows.append(
                {
                    "effect": name,
                    "parameter": item.name,
                    "default": default,
                    "unit": unit,
                    "needs": needs,
                    "outside work": outside,
                    "source": meta["source"],
                    "meaning": meta["about"],
                }
            )
    return rows


def setting_text(row: Mapping[str, str]) -> tuple[str, str]:
    """A row of `effect_table` as a scene file has it, at its default, and what it means."""
    if "|" in row["unit"] or row["unit"] in ("true", "false"):
        options = row["unit"].replace("|", " | ")
        default = row["default"] if row["unit"] == "true|false" else f'"{row["default"]}"'
        return f"{row['parameter']} = {default}", f"{row['meaning']} ({options})"
    if row["unit"] == "1":
        return f"{row['parameter']} = {row['default']}", row["meaning"]
    return f'{row["parameter"]} = "{row["default"]} {row["unit"]}"', row["meaning"]


def effect_list() -> list[dict[str, str]]:
    """One row per effect: what it is, where it acts, what it needs and excludes.

    ``outside work`` says who takes up the forces that the effect, with its default parameters,
    leaves unbalanced; empty where it gives one array what it takes from another.
    """
    return [
        {
            "effect": name,
            "acts on": effect.acts_on,
            "needs": ", ".join(need.replace("|", " or ") for need in effect.needs),
            "excludes": ", ".join(effect.excludes),
            "outside work": effect().outside_work,
            "what it is": (effect.__doc__ or "").strip().partition("\n")[0],
        }
        for name, effect in EFFECTS.items()
    ]


def scene_effects(path: str | Path, seconds: float = 20.0) -> list[dict[str, float | str]]:
    """One row per effect of a scene: states, auxiliaries, columns of W_eta, share of the time.

    ``outside work``: who takes up the forces that the effect leaves unbalanced, "" for nobody.

    The shares come from `seconds` s of the scene, timed after as many to warm up; the last row
    is what no effect accounts for, the solve above all. On a chain: `scene_table`.
    """
    scene = load_scene(path)
    system = build(scene)
    if isinstance(system, CrawlerSystem):
        return scene_table(path)
    cells = spreading(system)
    empty = dict.fromkeys(
        ("elements", "states", "auxiliaries", "columns of W_eta", "input forces"), 0
    )
    acting = np.diff(system.W_eta.tocsc().indptr) > 0
    rows: dict[str, dict[str, int]] = {}
    for element in cells.elements:
        ports = [p.block for p in element.ports]
        inside = [f"{b.name}.rate" for b in element.internal]
        own = rows.setdefault(effect_of(element), dict(empty))
        own["elements"] += 1
        own["states"] += sum(b.size for b in element.internal)
        own["auxiliaries"] += sum(system.auxiliaries[b].size for b in (*ports, *inside))
        own["columns of W_eta"] += sum(
            int(acting[system.auxiliaries.slice(b)].sum()) for b in (*ports, *inside)
        )
        own["input forces"] += sum(cells.nodes_of(p.array) * 3 for p in element.inputs)
    for array in cells.arrays:
        if array.name.count("."):  # node arrays that an effect brings along
            rows[array.name.rpartition(".")[2]]["states"] += array.block.size
    shares = time_shares(cells, scene.step, seconds, scene.seed)
    outside = {e.name: e.outside_work for c in scene.membranes for e in c.effects.values()}
    outside |= {e.name: e.outside_work for e in scene.effects.values()}
    return [
        {
            "effect": name,
            **rows.get(name, empty),
            "outside work": outside.get(name, ""),
            "share of time": shares.get(name, 0.0),
        }
        for name in [*scene.effects, *(n for n in shares if n not in scene.effects)]
    ]


def scene_table(path: str | Path) -> list[dict[str, float | str]]:
    """One row per element of a scene: states, auxiliaries (columns of W_eta), input forces.

    On a chain: one row per cell and one for the chain.
    """
    system = build(load_scene(path))
    rows: list[dict[str, float | str]] = []
    if isinstance(system, CrawlerSystem):
        for name in (*(f"cell{k + 1}" for k in range(len(system.cells))), "chain"):
            states, auxiliaries = (
                sum(b.size for b in layout if b.name.startswith(f"{name}."))
                for layout in (system.states, system.auxiliaries)
            )
            rows.append(
                {"element": name, "states": states, "auxiliaries": auxiliaries, "input forces": 0}
            )
        return rows
    cells = spreading(system)
    for element in cells.elements:
        blocks = [p.block for p in element.ports] + [f"{b.name}.rate" for b in element.internal]
        rows.append(
            {
                "element": element.name,
                "states": sum(b.size for b in element.internal),
                "auxiliaries": sum(system.auxiliaries[b].size for b in blocks),
                "input forces": sum(cells.nodes_of(p.array) * 3 for p in element.inputs),
            }
        )
    return rows
