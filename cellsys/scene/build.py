"""build(scene): from a scene to the full-order system."""

from __future__ import annotations

import dataclasses

import numpy as np

from cellsys.errors import BudgetError
from cellsys.integrate.simulate import available_memory
from cellsys.mechanics.crawler import CrawlerSystem
from cellsys.mechanics.effects.protocol import CellBody, Effect
from cellsys.mechanics.geometry.disc import DENSITY, Disc, disc
from cellsys.mechanics.geometry.membrane import NODES, sphere
from cellsys.mechanics.spreading import CellSpec, SpreadingSystem, build_spreading
from cellsys.scene.chain import ChainScene, build_chain
from cellsys.scene.registry import EFFECTS
from cellsys.scene.scene import MatrixScene, Scene

START_GAP = 0.05  # um between the lowest point of a cell and the top of the matrix
_BYTES_PER_MEMBRANE_NODE = 12_000.0  # equations, tangents, one state, measured at 150 cells
_BYTES_PER_NODE = 30_000.0  # fibres, assembly, factors and one state, measured at 2000 nodes


def build(scene: Scene) -> SpreadingSystem | CrawlerSystem:
    """The full-order system of a scene: only the effects that the scene names.

    A `SpreadingSystem`, or the `CrawlerSystem` of a scene on a chain.

    Raises
    ------
    BudgetError
        When the matrix alone, or the cells alone, would not fit into memory.
    """
    if isinstance(scene.matrix, ChainScene):
        return build_chain(scene.matrix, scene.cells)
    need, free = _BYTES_PER_MEMBRANE_NODE * NODES * len(scene.cells), available_memory()
    if need > free:
        raise BudgetError(
            f"{len(scene.cells)} cells of {NODES} nodes need about {need / 1e9:.1f} GB and "
            f"{free / 1e9:.1f} GB are free; take fewer, or couple reduced ones (cs.couple)"
        )
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


def matrix_nodes(spec: MatrixScene) -> int:
    """Number of matrix nodes a scene asks for."""
    if spec.nodes is not None:
        return spec.nodes
    return round(DENSITY * np.pi * (0.5 * spec.diameter) ** 2 * spec.thickness)


def _matrix(spec: MatrixScene, seed: int) -> Disc:
    nodes = min(matrix_nodes(spec), 10**30)  # more are no doubles
    need, free = _BYTES_PER_NODE * nodes, available_memory()
    if need > free:
        raise BudgetError(
            f"a matrix of {nodes} nodes needs about {need / 1e9:.1f} GB and "
            f"{free / 1e9:.1f} GB are free; make the disc smaller or set matrix.nodes"
        )
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
