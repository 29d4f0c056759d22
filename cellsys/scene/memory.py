"""What memory a run of a scene needs, told before anything of it is built.

The numbers are measured peaks of processes of their own: ``pytest -m slow
tests/scene/test_memory.py -s`` measures six scenes again and holds the estimates within 0.7 to
1.5 of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from cellsys.errors import MemoryBudgetError
from cellsys.integrate.simulate import SEGMENT
from cellsys.mechanics.geometry.disc import DENSITY
from cellsys.mechanics.geometry.membrane import NODES
from cellsys.scene.chain import ChainScene
from cellsys.scene.parts import MatrixScene
from cellsys.scene.scene import Scene
from cellsys.store.memory import check_memory, mapping_room, resident, size_text

PROGRAM = 215e6  # interpreter, libraries, and the machine code of the laws
_ADDRESSES = 0.15e9  # that the libraries ask for and do not touch
_CHAIN_NODE = 3e3  # states, W_eta while it is assembled, work arrays of the integrator
_NODE = 17e3  # fibres, assembly, factors and states of one node of a disc
_NODE_ADDRESSES = 61e3  # the solver of the network's modulus asks for its fill before it is known
_CELL = 0.45e6  # equations, tangents and states of one membrane
_REACH = 720.0  # of a cell with adhesions, per node of the matrix: a nodal force of its own
_ADHESIONS = ("focal_adhesion", "stochastic_adhesion")
_MOST = 10**30  # no float holds every integer


class MemoryNeed(NamedTuple):
    """Bytes that a process that runs a scene holds at its peak, all of it, and asks for.

    `record` are those of its rows, which lie in memory or in mapped files.
    """

    resident: float
    addresses: float
    record: float


def matrix_nodes(spec: MatrixScene) -> int:
    """Number of matrix nodes a scene asks for."""
    if spec.nodes is not None:
        return spec.nodes
    return round(DENSITY * np.pi * (0.5 * spec.diameter) ** 2 * spec.thickness)


def memory_need(scene: Scene, *, on_disk: bool = True, run: bool = True) -> MemoryNeed:
    """Peak of one process that runs a scene.

    Every cell whose volume is kept adds one direction to each solve, dense over all nodes, and
    every cell with adhesions a force on every node of the matrix: both grow with the square of
    the scene's size.

    Parameters
    ----------
    on_disk : bool
        The record is mapped from a run folder, and dropped from memory at every checkpoint;
        otherwise all of it is kept.
    run : bool
        With what the integrator of the scene takes; False for the system alone.
    """
    record = _record(scene) if run else 0.0
    kept = record * min(SEGMENT / len(scene.times), 1.0) if on_disk else record
    if isinstance(scene.matrix, ChainScene):
        nodes = float(min(scene.matrix.nodes, _MOST))
        # LSODA finds a whole run at once, and asks for a dense Jacobian that it touches only
        # where the chain is stiff.
        held = PROGRAM + _CHAIN_NODE * nodes + record + kept
        dense = 8.0 * nodes**2 if run else 0.0
        return MemoryNeed(held, _ADDRESSES + held - PROGRAM + dense, record)
    cells = float(len(scene.cells))
    nodes = 0.0 if scene.matrix is None else float(min(matrix_nodes(scene.matrix), _MOST))
    need = _NODE * nodes + _CELL * cells
    if "volume" in scene.effects:
        need += 2.0 * 8.0 * cells * 3.0 * (NODES * cells + nodes)
    if any(name in scene.effects for name in _ADHESIONS):
        need += _REACH * cells * nodes
    asked = need + (_NODE_ADDRESSES - _NODE) * nodes
    return MemoryNeed(PROGRAM + need + kept, _ADDRESSES + asked, record)


def _record(scene: Scene) -> float:
    """Bytes of states, forces, inputs and what the step leaves over, of all samples."""
    if isinstance(scene.matrix, ChainScene):
        return 8.0 * len(scene.times) * 4.0 * float(min(scene.matrix.nodes, _MOST))
    cells = float(len(scene.cells))
    nodes = 0.0 if scene.matrix is None else float(min(matrix_nodes(scene.matrix), _MOST))
    laws = {
        place: sum(effect.acts_on == place for effect in scene.effects.values())
        for place in ("matrix", "cell")
    }
    # Every law has a force on every node of its own, an adhesion one on every node of the matrix
    # besides, and states for its bonds.
    adhere = any(name in scene.effects for name in _ADHESIONS)
    states = 3.0 * nodes + 3.0 * NODES * cells * (2.0 if adhere else 1.0)
    forces = 3.0 * nodes * laws["matrix"] + 3.0 * NODES * cells * laws["cell"]
    if adhere:
        forces += 3.0 * nodes * cells
    return 8.0 * len(scene.times) * (3.0 * states + forces)


def check_scene_memory(scene: Scene, at_a_time: int = 1, *, run: bool = True) -> None:
    """Refuse a scene that would not fit, or not as often as it is to be run at a time.

    `run` as for `memory_need`.

    Raises
    ------
    MemoryBudgetError
        With what it needs, what is free and what to change.
    """
    need = memory_need(scene, run=run)
    what, cure = _words(scene)
    if at_a_time > 1:
        check_memory(
            at_a_time * need.resident,
            f"{at_a_time} runs at a time, each of {what}, need about",
            f"use fewer workers, or {cure}",
            addresses=need.addresses,
        )
        return
    # What the program itself takes is here already.
    held = min(resident(), PROGRAM)
    check_memory(need.resident - held, f"{what} needs about", cure, addresses=need.addresses)


def check_mapping(scenes: Iterable[Scene]) -> None:
    """Refuse runs that cannot all be mapped into this process when they are read back.

    Raises
    ------
    MemoryBudgetError
    """
    each = [memory_need(scene).record for scene in scenes]
    left = mapping_room()
    if sum(each) > left.bytes:
        raise MemoryBudgetError(
            f"{len(each)} runs map {size_text(sum(each))} of files when they are read, and "
            f"{size_text(left.bytes)} of addresses are free ({left.bound}); raise the limit, "
            "sample less often, or take fewer runs"
        )


def _words(scene: Scene) -> tuple[str, str]:
    """A scene in words, and what makes it smaller."""
    if isinstance(scene.matrix, ChainScene):
        return f"a chain of {scene.matrix.nodes} nodes", "make the chain shorter"
    cells = f"a scene of {len(scene.cells)} cells of {NODES} nodes"
    fewer = "take fewer cells, or couple reduced ones (cs.couple)"
    if scene.matrix is None:
        return cells, fewer
    matrix, smaller = f"a matrix of {matrix_nodes(scene.matrix)} nodes", "set fewer matrix.nodes"
    if not scene.cells:
        return matrix, f"make the disc smaller or {smaller}"
    if len(scene.cells) == 1:
        return f"a cell on {matrix}", f"make the disc smaller or {smaller}"
    return f"{cells} on {matrix}", f"{smaller}, {fewer}"
