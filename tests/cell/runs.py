"""Short runs of a small scene, made once per test session."""

from functools import cache

import cellsys as cs

SCENE = {
    "name": "small",
    "duration": "150 s",
    "sample": "5 s",
    "seed": 11,
    "matrix": {"diameter": "46 um", "nodes": 420},
    "cells": [{"position": ["0 um", "0 um"]}],
    "effects": {
        "drag": {},
        "membrane_elasticity": {},
        "volume": {},
        "cortical_tension": {},
        "focal_adhesion": {},
        "lamellipodium": {},
        "substrate_contact": {},
        "matrix_elasticity": {},
        "foundation": {},
        "stiffness_sensing": {},
        "polarity": {},
    },
    "training": {
        "runs": 5,
        "held_out": 1,
        "duration": "150 s",
        "commands": "turning",
        "scatter": "2 um",
    },
}


@cache
def scene() -> cs.Scene:
    return cs.Scene.parse(SCENE)


@cache
def runs() -> tuple[list[cs.Trajectory], list[cs.Trajectory]]:
    """Training and held-out runs; 150 s hold no turn, so the second half is turned by hand."""
    train, held = cs.training_scenes(scene())
    return [cs.scene.run_scene(s) for s in train], [cs.scene.run_scene(s) for s in held]


@cache
def data() -> tuple[cs.Snapshots, cs.Snapshots]:
    train, held = runs()
    return cs.snapshots(train), cs.snapshots(held)


@cache
def model(order: int = 16) -> cs.EquivariantModel:
    train, held = data()
    return cs.reduce(train, order=order, method=cs.Equivariant(iterations=40), test=held)
