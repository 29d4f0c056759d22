"""Tiny scenes for many runs: two small cells, or none, on a disc of 60 nodes."""

import copy

from cellsys.scene import Scene, build
from cellsys.scene.registry import EFFECTS

BASE = {
    "name": "tiny",
    "duration": "20 s",
    "sample": "5 s",
    "seed": 5,
    "matrix": {"diameter": "24 um", "nodes": 90, "modulus": "5 kPa"},
    "cells": [
        {"position": ["-4.2 um", "0.3 um"], "polarity": "20 deg", "radius": "4 um"},
        {"position": ["4.2 um", "-0.2 um"], "polarity": "150 deg", "radius": "4 um"},
    ],
    "effects": {"drag": {}},
}
# What an effect stands on when it is asked for alone.
GIVEN = {"focal_adhesion|stochastic_adhesion": "focal_adhesion"}


def closed(*names):
    """The effects with all that they need, in the registry's order."""
    wanted = {"drag"}

    def add(name):
        if name in wanted:
            return
        wanted.add(name)
        for need in EFFECTS[name].needs:
            choices = need.split("|")
            if not wanted.intersection(choices) and not set(names).intersection(choices):
                add(GIVEN.get(need, need))

    for name in names:
        add(name)
    return sorted(wanted, key=EFFECTS.place)


def tiny(*names, cells=2, matrix=True, **parameters):
    """Table of a scene with these effects, what they need, and their `parameters`."""
    out = copy.deepcopy(BASE)
    out["cells"] = out["cells"][:cells]
    if not matrix:
        out.pop("matrix")
    out["effects"] = {name: dict(parameters.get(name, {})) for name in closed(*names)}
    return out


def tiny_system(*names, cells=2, matrix=True, **parameters):
    """Built system of `tiny`."""
    return build(Scene.parse(tiny(*names, cells=cells, matrix=matrix, **parameters)))
