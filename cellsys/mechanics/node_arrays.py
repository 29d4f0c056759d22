"""The node arrays that a scene starts with: the membranes of its cells, and its matrix."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cellsys.effects.commands import Commands
from cellsys.effects.matrix import MATRIX, Drag
from cellsys.effects.protocol import CellBody, Effect, Element, JunctionArray
from cellsys.errors import SceneError
from cellsys.geometry.network import FibreNetwork
from cellsys.system import Block


@dataclass(frozen=True)
class CellSpec:
    """A cell with its own effects and commands."""

    body: CellBody
    effects: dict[str, Effect]
    commands: Commands = field(default_factory=Commands)


def node_arrays(
    cells: tuple[CellSpec, ...], matrix: FibreNetwork | None, drag: Drag
) -> tuple[JunctionArray, ...]:
    """The membranes of all cells and the matrix, each node with its drag."""
    nodes = []
    for cell in cells:
        at, name = cell.body.membrane.position, cell.body.name
        taken = {r for effect in cell.effects.values() for r in effect.replaces}
        c = np.full(at.shape, drag.medium + (0.0 if "drag.cortex" in taken else drag.cortex))
        nodes.append(JunctionArray(name, Block(f"{name}.position", at.shape, "um"), at, c))
    if matrix is not None:
        shape = matrix.position.shape
        c = np.where(matrix.clamped, np.inf, drag.matrix)[:, None] * np.ones(3)
        block = Block("matrix.displacement", shape, "um", role="field")
        nodes.append(JunctionArray(MATRIX, block, np.zeros(shape), c))
    if not nodes:
        raise SceneError("a scene needs at least one cell or a matrix")
    return tuple(nodes)


def held(array: JunctionArray, elements: list[Element]) -> JunctionArray:
    """The array with the nodes held by an element at their place at t = 0, their drag inf."""
    for element in elements:
        if any(h.array == array.name for h in element.holds):
            start, drag = array.start.copy(), array.drag.copy()
            for h, place in zip(element.holds, element.place(0.0), strict=True):
                if h.array == array.name:
                    start[h.nodes], drag[h.nodes] = place, np.inf
            array = array._replace(start=start, drag=drag)
    return array
