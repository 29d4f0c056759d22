"""Scenes that the mechanics tests share: a small disc, quick to build, with every effect on it."""

import copy
from functools import lru_cache

import numpy as np

from cellsys.scene import Scene, build

TABLE = {
    "name": "small",
    "duration": "20 s",
    "sample": "5 s",
    "seed": 3,
    "matrix": {"diameter": "34 um", "nodes": 320, "modulus": "5 kPa"},
    "cells": [{"position": ["0.5 um", "-0.3 um"], "polarity": "30 deg"}],
    "effects": {
        "drag": {},
        "membrane_elasticity": {},
        "volume": {},
        "cortical_tension": {},
        "focal_adhesion": {"kinetics": "clutch"},
        "lamellipodium": {"force": "600 pN"},
        "substrate_contact": {},
        "matrix_elasticity": {"law": "buckling"},
        "foundation": {},
        "stiffness_sensing": {},
        "polarity": {"kappa": "1/60 1/s"},
    },
}


def table(**effects):
    """The table with effects changed: a dict replaces the parameters, None leaves it out."""
    out = copy.deepcopy(TABLE)
    for name, parameters in effects.items():
        if parameters is None:
            out["effects"].pop(name, None)
        else:
            out["effects"][name] = parameters
    return out


def small(**effects):
    """A built system of `table(**effects)`."""
    return build(Scene.parse(table(**effects)))


@lru_cache(maxsize=4)
def clutch():
    """The small system with the motor clutch."""
    return small()


@lru_cache(maxsize=4)
def switching():
    """The small system with Bell clusters that bind at once."""
    return small(
        focal_adhesion={"kinetics": "switching", "bind_rate": "5 1/s", "bind_distance": "2.5 um"}
    )


def disturbed(system, seed, size=0.15):
    """A random state near the start: nodes moved, bonds closed and loaded, cell pressed down."""
    rng = np.random.default_rng(seed)
    x = system.x0.copy()
    cell = system.states.view(x, "cell1.position")
    cell += size * rng.standard_normal(cell.shape)
    cell[:, 2] -= 0.3
    if system.matrix is not None:
        u = system.states.view(x, "matrix.displacement")
        u += 0.3 * size * rng.standard_normal(u.shape)
        u[system.matrix.clamped] = 0.0
    if "cell1.bond_strength" in system.states:
        system.states.view(x, "cell1.bond_strength")[:] = rng.uniform(0, 1, 189)
        system.states.view(x, "cell1.bond_stretch")[:] = 0.05 * rng.standard_normal((189, 2))
    if "cell1.bond_number" in system.states:
        x, _ = system.between_steps(0.0, x, 10.0, rng)
        bound = system.states.view(x, "cell1.bond_partner") >= 0
        system.states.view(x, "cell1.bond_number")[bound] = rng.uniform(1, 50, bound.sum())
        system.states.view(x, "cell1.bond_length")[bound] *= rng.uniform(0.3, 1.1, bound.sum())
    return x


def element(system, name):
    """The element called `name`."""
    return next(e for e in system.elements if e.name == name)


def force(system, item, x):
    """Port forces of one element: array name -> (n, 3), pN."""
    s = system.configuration(0.0, x.copy())
    out = tuple(np.zeros_like(s.nodes[p.array]) for p in item.ports)
    item.efforts(s, out)
    return {p.array: f for p, f in zip(item.ports, out, strict=True)}
