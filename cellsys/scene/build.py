"""build(scene): from a scene to the full-order system."""

from __future__ import annotations

from cellsys.arguments import checked
from cellsys.errors import SceneError
from cellsys.mechanics.spreading import SpreadingSystem
from cellsys.scene.memory import check_scene_memory
from cellsys.scene.scene import Scene
from cellsys.system import OdeSystem


@checked
def build(scene: Scene) -> OdeSystem:
    """The full-order system of a scene: only the effects that the scene names.

    A `SpreadingSystem`, the `CrawlerSystem` of a scene on a chain, or what a matrix of your own
    builds.

    Raises
    ------
    MemoryBudgetError
        When the scene would not fit into memory.
    """
    check_scene_memory(scene, run=False)
    return scene.matrix_kind.build(scene)


def spreading(system: OdeSystem) -> SpreadingSystem:
    """The system of cells with a membrane on a network, or on nothing.

    Raises
    ------
    SceneError
        A system of another kind: of a scene on a chain, or of a matrix of one's own.
    """
    if not isinstance(system, SpreadingSystem):
        raise SceneError(
            f"this needs cells with a membrane on a network, and the scene makes a "
            f"{type(system).__name__}"
        )
    return system
