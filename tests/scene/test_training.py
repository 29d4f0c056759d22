"""Training commands: what is drawn, that it is repeatable, and several loads on one matrix."""

import dataclasses

import numpy as np
import pytest

import cellsys as cs
from cellsys.scene.headings import AMPLITUDE, TURN
from cellsys.scene.load import scene_from_plain


def table(**training):
    return {
        "name": "t",
        "duration": "20 s",
        "seed": 3,
        "matrix": {"diameter": "40 um", "nodes": 300},
        "cells": [{"position": ["0 um", "0 um"]}],
        "effects": {
            "drag": {},
            "membrane_elasticity": {},
            "volume": {},
            "lamellipodium": {},
            "substrate_contact": {},
            "matrix_elasticity": {},
            "focal_adhesion": {},
            "polarity": {},
            "stiffness_sensing": {},
        },
        "training": {"duration": "1500 s", **training},
    }


def turning(**training):
    return cs.Scene.parse(table(commands="turning", runs=6, loaded=2, scatter="2 um", **training))


def test_commands_stay_in_their_range_and_change():
    train, held = cs.training_scenes(turning(held_out=3))
    assert len(train) == 6
    assert len(held) == 3
    for scene in train + held:
        (cell,) = scene.cells
        heading, amplitude = cell.commands.heading, cell.commands.amplitude
        assert "polarity" not in scene.effects
        assert np.ptp(heading.values) > 0
        assert np.max(np.abs(np.diff(heading.values))) <= TURN
        assert AMPLITUDE[0] <= min(amplitude.values) <= max(amplitude.values) <= AMPLITUDE[1]
        assert np.max(np.abs(cell.position)) <= 2.0
        assert cell.polarity == heading.values[0]
    assert ["external_load" in s.effects for s in train] == [False] * 4 + [True] * 2
    assert len({s.fingerprint() for s in train + held}) == 9  # no run twice, none leaks


def test_same_seed_same_scenes_and_more_runs_keep_the_first():
    first, _ = cs.training_scenes(turning())
    again, _ = cs.training_scenes(turning())
    assert [s.fingerprint() for s in first] == [s.fingerprint() for s in again]
    few = cs.turning_scenes(turning(), 2, seed=5)
    many = cs.turning_scenes(turning(), 4, seed=5)
    assert [s.fingerprint() for s in few] == [s.fingerprint() for s in many[:2]]


def test_scene_with_several_loads_survives_its_record():
    train, _ = cs.training_scenes(turning())
    again = scene_from_plain(train[-1].canonical())
    assert again.fingerprint() == train[-1].fingerprint()


def test_patches_add_up():
    """Two patches pull with the sum of what each would: one element, one known input."""
    plain = table()
    one = {"force": "3000 pN", "x": "10 um", "radius": "4 um", "direction": "30 deg"}
    two = {"force": "5000 pN", "y": "-9 um", "radius": "4 um"}
    unloaded = cs.build(cs.Scene.parse(plain))
    forces = []
    for load in (one, two, {**one, "patches": [two]}):
        scene = cs.Scene.parse({**plain, "effects": {**plain["effects"], "external_load": load}})
        system = cs.build(scene)
        forces.append(system.u(0.0, system.x0) - unloaded.u(0.0, unloaded.x0))
    np.testing.assert_allclose(forces[2], forces[0] + forces[1], atol=1e-12)
    assert np.abs(forces[0]).max() > 0


@pytest.mark.parametrize(
    ("training", "word"),
    [
        ({"commands": "wild"}, "commands"),
        ({"loaded": 2}, "turning"),
        ({"commands": "turning", "runs": 2, "loaded": 3}, "loaded"),
        ({"commands": "turning", "scatter": "-1 um"}, "scatter"),
    ],
)
def test_contradictory_plans_are_refused(training, word):
    with pytest.raises(cs.SceneError, match=word):
        cs.Scene.parse(table(**training))


def test_chain_has_no_headings():
    scene = dataclasses.replace(
        cs.load_scene("examples/crawler.toml"),
    )
    with pytest.raises(cs.SceneError, match="chain"):
        cs.turning_scenes(scene, 2, seed=0)
