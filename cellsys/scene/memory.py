"""What memory a run of a scene needs, told before anything of it is built.

The numbers are measured peaks of processes of their own: ``pytest -m slow
tests/scene/test_memory.py -s`` measures six scenes again and holds the estimates within 0.7 to
1.5 of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from cellsys.errors import MemoryBudgetError
from cellsys.geometry.membrane import NODES
from cellsys.integrate.simulate import SEGMENT
from cellsys.scene.plan import ScenePlan
from cellsys.store.memory import check_memory, mapping_room, resident, size_text

PROGRAM = 215e6  # interpreter, libraries, and the machine code of the laws
ADDRESSES = 0.15e9  # that the libraries ask for and do not touch
_NODE = 17e3  # fibres, assembly, factors and states of one node of a disc
_NODE_ADDRESSES = 61e3  # the solver of the network's modulus asks for its fill before it is known
_GEL_NODE = 11e3  # of one node of a gel: fibres, assembly of its modulus, vectors of RKC
_GEL_FILL = 180.0  # and of the factors of an implicit step, by the power 1.5
_CELL = 0.45e6  # equations, tangents and states of one membrane
_REACH = 720.0  # of a cell with adhesions, per node of the matrix: a nodal force of its own
_ADHESIONS = ("focal_adhesion", "stochastic_adhesion")
MOST_NODES = 10**30  # no float holds every integer


class MemoryNeed(NamedTuple):
    """Bytes that a process that runs a scene holds at its peak, all of it, and asks for.

    `record` are those of its rows, which lie in memory or in mapped files.
    """

    resident: float
    addresses: float
    record: float


def memory_need(scene: ScenePlan, *, on_disk: bool = True, run: bool = True) -> MemoryNeed:
    """Peak of one process that runs a scene.

    Parameters
    ----------
    on_disk : bool
        The record is mapped from a run folder, and dropped from memory at every checkpoint;
        otherwise all of it is kept.
    run : bool
        With what the integrator of the scene takes; False for the system alone.
    """
    return MemoryNeed(*scene.matrix_kind.memory(scene, on_disk=on_disk, run=run))


def kept(scene: ScenePlan, record: float, on_disk: bool) -> float:
    """Bytes of a record that lie in memory while the scene runs."""
    return record * min(SEGMENT / len(scene.times), 1.0) if on_disk else record


def plane_memory(scene: ScenePlan, nodes: int, *, on_disk: bool, run: bool) -> MemoryNeed:
    """Need of cells with a membrane on a flat network of so many nodes.

    Every cell whose volume is kept adds one direction to each solve, dense over all nodes, and
    every cell with adhesions a force on every node of the matrix: both grow with the square of
    the scene's size.
    """
    cells, count = float(len(scene.cells)), float(min(nodes, MOST_NODES))
    record = _plane_record(scene, count) if run else 0.0
    need = _NODE * count + _CELL * cells
    if "volume" in scene.effects:
        need += 2.0 * 8.0 * cells * 3.0 * (NODES * cells + count)
    if any(name in scene.effects for name in _ADHESIONS):
        need += _REACH * cells * count
    asked = need + (_NODE_ADDRESSES - _NODE) * count
    return MemoryNeed(PROGRAM + need + kept(scene, record, on_disk), ADDRESSES + asked, record)


def gel_memory(scene: ScenePlan, nodes: int, *, on_disk: bool, run: bool) -> MemoryNeed:
    """Need of cells inside a gel of so many nodes.

    Its cells share one force on its nodes. RKC keeps a dozen vectors; an implicit step factors
    matrices whose fill grows as the power 1.5 of the nodes.
    """
    cells, count = float(len(scene.cells)), float(min(nodes, MOST_NODES))
    laws = {
        place: sum(effect.acts_on == place for effect in scene.effects.values())
        for place in ("matrix", "cell", "cells")
    }
    states = 3.0 * count + 3.0 * NODES * cells * 2.4
    forces = 3.0 * count * (laws["matrix"] + 2.0)
    forces += 3.0 * NODES * cells * (laws["cell"] + laws["cells"])
    record = 8.0 * len(scene.times) * (3.0 * states + forces) if run else 0.0
    need = _GEL_NODE * count + _CELL * cells
    if run and scene.stepper not in (None, "auto", "RKC"):
        need += _GEL_FILL * count**1.5
        if "volume" in scene.effects:
            need += 2.0 * 8.0 * cells * 3.0 * (NODES * cells + count)
    held = PROGRAM + need + kept(scene, record, on_disk)
    return MemoryNeed(held, ADDRESSES + need + kept(scene, record, on_disk), record)


def plane_words(scene: ScenePlan, nodes: int, cure: str) -> tuple[str, str]:
    """Such a scene in words, and what makes it smaller; `cure` makes the matrix smaller."""
    cells = f"a scene of {len(scene.cells)} cells of {NODES} nodes"
    fewer = "take fewer cells, or couple reduced ones (cs.couple)"
    if nodes == 0:
        return cells, fewer
    matrix, smaller = f"a matrix of {nodes} nodes", "set fewer matrix.nodes"
    if not scene.cells:
        return matrix, f"{cure} or {smaller}"
    if len(scene.cells) == 1:
        return f"a cell on {matrix}", f"{cure} or {smaller}"
    return f"{cells} on {matrix}", f"{smaller}, {fewer}"


def _plane_record(scene: ScenePlan, nodes: float) -> float:
    """Bytes of states, forces, inputs and what the step leaves over, of all samples."""
    cells = float(len(scene.cells))
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


def check_scene_memory(scene: ScenePlan, at_a_time: int = 1, *, run: bool = True) -> None:
    """Refuse a scene that would not fit, or not as often as it is to be run at a time.

    `run` as for `memory_need`.

    Raises
    ------
    MemoryBudgetError
        With what it needs, what is free and what to change.
    """
    need = memory_need(scene, run=run)
    what, cure = scene.matrix_kind.words(scene)
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


def check_mapping(scenes: Iterable[ScenePlan]) -> None:
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
