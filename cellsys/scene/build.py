"""build(scene): from a scene to the full-order system."""

from __future__ import annotations

import dataclasses

import numpy as np

from cellsys.arguments import checked
from cellsys.mechanics.crawler import CrawlerSystem, build_crawlers
from cellsys.mechanics.effects.protocol import CellBody, Effect
from cellsys.mechanics.geometry.disc import Disc, disc
from cellsys.mechanics.geometry.membrane import sphere
from cellsys.mechanics.spreading import CellSpec, SpreadingSystem, build_spreading
from cellsys.scene.chain import ChainScene
from cellsys.scene.memory import check_scene_memory
from cellsys.scene.memory import matrix_nodes as matrix_nodes
from cellsys.scene.parts import MatrixScene
from cellsys.scene.registry import EFFECTS
from cellsys.scene.scene import Scene

START_GAP = 0.05  # um between the lowest point of a cell and the top of the matrix


@checked
def build(scene: Scene) -> SpreadingSystem | CrawlerSystem:
    """The full-order system of a scene: only the effects that the scene names.

    A `SpreadingSystem`, or the `CrawlerSystem` of a scene on a chain.

    Raises
    ------
    MemoryBudgetError
        When the scene would not fit into memory.
    """
    check_scene_memory(scene, run=False)
    if isinstance(scene.matrix, ChainScene):
        return build_crawlers(scene.cells, scene.matrix)
    matrix = _matrix(scene.matrix, scene.seed) if scene.matrix is not None else None
    effects = {n: e for n, e in _ordered(scene.effects) if e.acts_on != "cell"}
    cells = []
    for k, cell in enumerate(scene.cells, start=1):
        height = cell.radius + START_GAP
        body = CellBody(
            f"cell{k}",
            sphere(cell.radius, (*cell.position, height)),
            np.array([np.cos(cell.polarity), np.sin(cell.polarity), 0.0]),
        )
        own = {n: e for n, e in _ordered({**scene.effects, **cell.effects}) if e.acts_on == "cell"}
        cells.append(CellSpec(body, own, cell.commands or scene.commands))
    return build_spreading(tuple(cells), matrix, effects, scene.effects["drag"])


def _ordered(effects: dict[str, Effect]) -> list[tuple[str, Effect]]:
    """Effects in the registry's order, so that one scene has one layout of x and eta.

    A scene read back from a run folder names its effects in another order than its file did.
    """
    return sorted(effects.items(), key=lambda item: EFFECTS.place(item[0]))


def _matrix(spec: MatrixScene, seed: int) -> Disc:
    built = disc(
        0.5 * spec.diameter,
        spec.modulus,
        thickness=spec.thickness,
        n_nodes=spec.nodes,
        seed=seed if spec.seed is None else spec.seed,
    )
    if spec.inclusion is None and spec.gradient is None:
        return built
    middle = 0.5 * (built.position[built.fibres[:, 0]] + built.position[built.fibres[:, 1]])
    factor = np.ones(len(middle))
    if spec.gradient is not None:
        along = np.array([np.cos(spec.gradient.direction), np.sin(spec.gradient.direction)])
        factor *= 1.0 + spec.gradient.per_um * (middle[:, :2] @ along)
    if spec.inclusion is not None:
        inside = np.hypot(*(middle[:, :2] - spec.inclusion.center).T) < spec.inclusion.radius
        factor[inside] *= spec.inclusion.factor
    return dataclasses.replace(built, stiffness=factor * built.stiffness)
