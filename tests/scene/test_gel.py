"""Gels in scene files: defaults, what is refused by name, the study of one."""

import dataclasses

import numpy as np
import pytest

import cellsys as cs
from cellsys.integrate.rkc import RKC
from tests.effects.test_embedded import EFFECTS, small


def test_defaults_of_a_gel_are_its_own():
    scene = small()
    assert scene.effects["matrix_elasticity"].buckling_ratio == 0.1
    assert scene.effects["focal_adhesion"].reach == 5.0
    assert scene.effects["focal_adhesion"].off_rate == 1 / 40
    assert isinstance(scene.matrix.method(scene).smooth, RKC)
    given = small({**EFFECTS, "matrix_elasticity": {"buckling_ratio": "0.3"}})
    assert given.effects["matrix_elasticity"].buckling_ratio == 0.3
    again = cs.scene.load.scene_from_plain(scene.canonical())
    assert again.fingerprint() == scene.fingerprint()


BAD = {
    "overlap": ({"cells": (-2.0, 2.0)}, "overlap"),
    "lateral": ({"diameter": "8 um"}, "lateral boundary"),
    "ends": ({"cells": (15.0,)}, "clamped ends"),
    "floppy": ({"coordination": 6}, "above 6.*fibre_bending"),
    "few": ({"nodes": 20}, "at least 50"),
    "memory": ({"nodes": 10**9}, "fewer matrix.nodes"),
    "size": ({"width": "3 um"}, "not a size of a cylinder"),
    "under": ({"effects": {**EFFECTS, "substrate_contact": {}}}, "matrix_contact"),
    "support": ({"effects": {**EFFECTS, "foundation": {}}}, "foundation has no meaning"),
    "zipper": ({"effects": {**EFFECTS, "focal_adhesion": {"zipper": "9 pN/um"}}}, "zipper"),
    "clusters": ({"effects": {**EFFECTS, "focal_adhesion": {"kinetics": "switching"}}}, "clutch"),
    "stochastic": ({"effects": {**EFFECTS, "stochastic_adhesion": {}}}, "flat matrix"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_gels_are_one_clear_error(case):
    given, told = BAD[case]
    with pytest.raises(cs.CellsysError, match=told):
        cs.build(small(**given))


def test_a_cavity_that_cuts_the_gel_is_refused():
    places = [
        {"center": ["0 um", f"{y} um", f"{z} um"], "radius": "6 um"}
        for y in (-7, 0, 7)
        for z in (-7, 0, 7)
    ]
    with pytest.raises(cs.SceneError, match="hanging in"):
        cs.build(small(cells=(-12.0,), cavities=places))


def test_a_step_needs_a_stepper_and_a_disc_has_no_third_place():
    with pytest.raises(cs.SceneError, match=r"run\.stepper"):
        cs.Scene.parse({**_table(), "step": "0.5 s"})
    table = _table()
    table["matrix"] = {"kind": "disc"}
    table["effects"] = {"drag": {}, "membrane_elasticity": {}}
    table["cells"] = [{"position": ["0 um", "0 um", "3 um"]}]
    with pytest.raises(cs.SceneError, match="out of the plane"):
        cs.Scene.parse(table)


def _table():
    return {
        "name": "gel",
        "duration": "10 s",
        "matrix": {"kind": "gel", "length": "40 um", "diameter": "20 um"},
        "cells": [{"radius": "4 um"}],
        "effects": EFFECTS,
    }


def test_steered_cells_sense_and_push_in_space():
    """A cone and a direction in space: with the polarity along z the push has no part across it."""
    effects = {**EFFECTS, "lamellipodium": {}, "stiffness_sensing": {}, "polarity": {}}
    scene = small(effects)
    up = dataclasses.replace(scene.cells[0], elevation=np.pi / 2)
    system = cs.build(dataclasses.replace(scene, cells=(up,)))
    push = system.states.view(system.u(0.0, system.x0), "cell1.position").sum(axis=0)
    assert push[2] > 0.0
    assert np.abs(push[:2]).max() < 0.05 * push[2]  # the mesh is no body of revolution
    d = system.observe(0.0, system.x0)["d"][0]
    assert 0.0 < np.linalg.norm(d) < 1.0
    assert abs(d[2]) > 0.0


def test_implicit_steps_and_rkc_agree():
    scene = small()
    t = np.array([0.0, 10.0])
    system = cs.build(scene)
    runs = [
        cs.simulate(system, method, t)
        for method in (cs.LinearlyImplicit(step=0.25), cs.RKC(rtol=1e-4, atol=1e-4))
    ]
    a, b = (run.block("matrix.displacement")[-1] for run in runs)
    # First order at 0.25 s: about 1 % (analysis/notes).
    assert np.linalg.norm(a - b) < 0.03 * np.linalg.norm(b)


@pytest.mark.slow
def test_study_of_two_cells_in_a_gel(tmp_path):
    scene = small(cells=(-5.0, 5.0))
    found = cs.study(scene, tmp_path / "out", workers=1, cache=tmp_path / "cache")
    assert {p.name for p in (tmp_path / "out" / "figures").iterdir()} == {
        "side.png", "section.png", "thickness.png"
    }  # fmt: skip
    assert len(found.controls) == 2
    assert found.contraction.integral_um > found.controls[0].integral_um > 0.0
    assert found.read_outs["all cells"]["contractile_force_nN"] > 0.0
    with pytest.raises(cs.SceneError, match="nothing is learned"):
        cs.training_scenes(scene)
