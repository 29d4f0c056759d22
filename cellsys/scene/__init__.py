"""Scene files: schema, effect registry, build(scene) -> full-order system, ensembles."""

from cellsys.scene.build import build
from cellsys.scene.chain import ChainScene
from cellsys.scene.disc import MatrixScene
from cellsys.scene.ensemble import run_ensemble, run_scene
from cellsys.scene.gel import GelScene
from cellsys.scene.inherit import preset_names
from cellsys.scene.load import load_scene
from cellsys.scene.parse import scene_schema
from cellsys.scene.parts import CellScene, Training
from cellsys.scene.plane import Plane
from cellsys.scene.scene import Scene
from cellsys.scene.timing import StepCost, step_cost
from cellsys.scene.training import training_scenes, turning_scenes

__all__ = [
    "CellScene",
    "ChainScene",
    "GelScene",
    "MatrixScene",
    "Plane",
    "Scene",
    "StepCost",
    "Training",
    "build",
    "load_scene",
    "preset_names",
    "run_ensemble",
    "run_scene",
    "scene_schema",
    "step_cost",
    "training_scenes",
    "turning_scenes",
]
