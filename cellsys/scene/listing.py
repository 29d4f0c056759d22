"""What effects there are, and what a scene builds of them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from cellsys.mechanics.crawler import CrawlerSystem
from cellsys.scene.build import build
from cellsys.scene.parse import load_scene
from cellsys.scene.registry import EFFECTS


def effect_table() -> list[dict[str, str]]:
    """One row per parameter of every effect: default, unit, source, meaning."""
    rows = []
    for name, effect in EFFECTS.items():
        needs = ", ".join(effect.needs)
        for item in dataclasses.fields(effect):
            meta = item.metadata
            if "unit" not in meta:
                continue
            rows.append(
                {
                    "effect": name,
                    "parameter": item.name,
                    "default": str(item.default) if meta["choices"] else f"{item.default:.4g}",
                    "unit": "|".join(meta["choices"]) if meta["choices"] else meta["unit"],
                    "needs": needs,
                    "source": meta["source"],
                    "meaning": meta["about"],
                }
            )
    return rows


def scene_table(path: Path) -> list[dict[str, int | str]]:
    """One row per element of a scene: states, auxiliaries (columns of W_eta), input forces.

    On a chain: one row per cell and one for the chain.
    """
    system = build(load_scene(path))
    rows: list[dict[str, int | str]] = []
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
    for element in system.elements:
        blocks = [p.block for p in element.ports] + [f"{b.name}.rate" for b in element.internal]
        rows.append(
            {
                "element": element.name,
                "states": sum(b.size for b in element.internal),
                "auxiliaries": sum(system.auxiliaries[b].size for b in blocks),
                "input forces": sum(system.nodes_of(p.array) * 3 for p in element.inputs),
            }
        )
    return rows
