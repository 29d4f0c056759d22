"""All pairs of effects: allowed ones build, run 20 s and keep their invariants; others are refused.

A pair stands on what its two effects need, on a disc of 90 nodes with two cells of 4 um, except
that pairs without a cell (or without a matrix) are run without. Three pairs of every new effect run
by default, all of them with the slow tests.
"""

import itertools

import numpy as np
import pytest

from cellsys.errors import SceneError
from cellsys.geometry.membrane import enclosed_volume
from cellsys.integrate import LinearlyImplicit, simulate
from cellsys.scene import Scene, build
from cellsys.scene.registry import EFFECTS, LISTED
from tests.effects.test_effect_forces import port_forces
from tests.mechanics.small_scenes import closed, tiny

T = np.arange(0.0, 21.0, 10.0)
# Held by something outside the system: a support, a lamellipodium's ground, prescribed nodes.
OUTSIDE = {"substrate_contact", "foundation"}


def forbidden(a, b):
    """Whether one of the two, or something it needs, excludes something of the other."""
    names = closed(a, b)
    return any(other in EFFECTS[n].excludes for n in names for other in names)


PAIRS = [p for p in itertools.combinations(LISTED, 2) if not forbidden(*p)]
NEW = list(LISTED)[12:]
QUICK = [p for k, p in enumerate(PAIRS) if set(p) & set(NEW) and k % 8 == 0]


def table(a, b):
    names = closed(a, b)
    matrix = any(EFFECTS[n].acts_on == "matrix" or "matrix" in n for n in names)
    cells = 2 if any(EFFECTS[n].acts_on in ("cell", "cells") for n in names) else 0
    if not matrix and not cells:
        matrix = True
    out = tiny(a, b, cells=cells, matrix=matrix)
    if not cells:
        out.pop("cells")
    return out


def check(pair):
    system = build(Scene.parse(table(*pair)))
    run = simulate(system, LinearlyImplicit(step=0.5), T, seed=4)
    assert np.all(np.isfinite(run.x))
    present = set(closed(*pair))
    # Force and torque of every inner element, in the state the run ended in.
    for item in system.elements:
        if not item.ports or item.name.rpartition(".")[2] in OUTSIDE:
            continue
        forces, s = port_forces(system, item, run.x[-1])
        total, torque, scale = np.zeros(3), np.zeros(3), 0.0
        for array, f in forces.items():
            place = s.nodes[array] + (system.matrix.position if array == "matrix" else 0.0)
            total += 0.0 if array.endswith("cortex") else f.sum(axis=0)
            torque += np.cross(place, f).sum(axis=0)
            scale += float(np.abs(f).sum())
        assert np.abs(total).max() <= 1e-13 * scale + 1e-20, item.name
        # The clutch shares its force among nodes around the bond: no torque balance (design).
        if not item.name.endswith("focal_adhesion"):
            assert np.abs(torque).max() <= 1e-11 * scale + 1e-18, item.name
    if not any(EFFECTS[n].active for n in present):
        energy = [sum(system.energy(t, run.x[k].copy()).values()) for k, t in enumerate(run.t)]
        assert np.all(np.diff(energy) <= 1e-9 * max(1.0, abs(energy[0])))
    if run.p is not None:
        assert np.abs(np.linalg.norm(run.p, axis=2) - 1.0).max() < 1e-14
    if "volume" in present:
        for k, cell in enumerate(system.cells, start=1):
            now = enclosed_volume(run.block(f"cell{k}.position")[-1], cell.body.membrane.triangles)
            # K_V = 300 Pa holds 150 pN/um of tension at R = 4 um: 2 gamma/(R K_V) = 25 % at most.
            assert abs(now / cell.body.membrane.volume - 1.0) < 0.25
    # What was logged explains the motion [thesis 65].
    rate = np.diff(run.x, axis=0) / 10.0
    left = np.abs(rate - run.eta @ run.W_eta.T - run.u).max()
    assert left <= 1e-12 * max(1.0, np.abs(rate).max())


@pytest.mark.parametrize("pair", QUICK, ids="+".join)
def test_some_pairs_run_and_keep_their_invariants(pair):
    check(pair)


@pytest.mark.slow
def test_all_allowed_pairs_run_and_keep_their_invariants():
    failed = {}
    for pair in PAIRS:
        try:
            check(pair)
        except (AssertionError, ArithmeticError, RuntimeError, ValueError) as error:
            failed["+".join(pair)] = str(error).split("\n")[0]
    assert not failed
    assert len(PAIRS) > 200


FORBIDDEN = [(a, b) for a in LISTED for b in EFFECTS[a].excludes]


@pytest.mark.parametrize(("one", "other"), FORBIDDEN)
def test_forbidden_pairs_are_refused_with_both_names_and_the_rule(one, other):
    with pytest.raises(SceneError) as caught:
        Scene.parse(tiny(one, other))
    text = str(caught.value)
    assert f"effects.{one} and effects.{other} contradict each other: " in text
    assert EFFECTS[one].excludes[other] in text
    assert "leave one of them out" in text


def test_the_forbidden_pairs_are_the_stated_ones():
    together = set(itertools.combinations(LISTED, 2))
    assert len(together) == len(LISTED) * (len(LISTED) - 1) // 2
    assert set(FORBIDDEN) == {
        ("cortex", "cortical_tension"), ("stochastic_adhesion", "focal_adhesion"),
    }  # fmt: skip
    assert len(PAIRS) == len(together) - len(FORBIDDEN)


def test_a_need_of_one_of_two_is_met_by_either():
    for adhesion in ("focal_adhesion", "stochastic_adhesion"):
        Scene.parse(tiny("stress_fibres", adhesion))
    lacking = tiny("stress_fibres")
    lacking["effects"].pop("focal_adhesion")
    with pytest.raises(SceneError, match="needs focal_adhesion or stochastic_adhesion"):
        Scene.parse(lacking)
