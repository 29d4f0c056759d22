"""The l = 0 cell of a gel beside the full-order one, and a clutch in closed form."""

import numpy as np
import pytest

import cellsys as cs
from tests.effects.test_embedded import small

METHOD = cs.RKC(rtol=1e-3, atol=1e-3)


def test_two_states_a_cell_on_the_same_gel():
    full = cs.build(small(cells=(-5.0, 5.0)))
    radial = cs.RadialCell().of(full)
    inner = [b.name for b in radial.states if "bond" in b.name]
    assert inner == [f"cell{k}.bond_{w}" for k in (1, 2) for w in ("strength", "stretch")]
    assert sum(radial.states[name].size for name in inner) == 4
    assert radial.matrix is full.matrix


def test_it_moves_the_gel_as_the_full_cell_does():
    full = cs.build(small(nodes=1000))
    t = np.array([0.0, 100.0])
    a, b = (cs.simulate(s, METHOD, t) for s in (full, cs.RadialCell().of(full)))
    u, v = (run.block("matrix.displacement")[-1] for run in (a, b))
    # The network's disorder leaves some 30 % of a nodal load beside its mean (0.23 here).
    assert np.linalg.norm(u - v) < 0.3 * np.linalg.norm(u)
    # naive: another pull would be seen
    assert np.linalg.norm(u - 0.5 * v) > 0.3 * np.linalg.norm(u)


def test_its_rates_are_those_of_one_clutch():
    scene = small()
    system = cs.RadialCell().of(cs.build(scene))
    x = system.x0.copy()
    system.states.view(x, "cell1.bond_strength")[:] = 0.5
    system.states.view(x, "cell1.bond_stretch")[:] = 0.1
    law = scene.effects["focal_adhesion"]
    rate = system.laws(0.0, x)[2]
    load = law.stiffness * 0.1
    off = law.off_rate * (1 + (load / ((0.5 + 0.02) * law.force_scale)) ** 2)
    clutch = next(e for e in system.elements if e.name == "cell1.focal_adhesion")
    s = system.configuration(0.0, x)
    index, weight, count = clutch.footing.weights(s)
    W = np.zeros((len(count), len(system.matrix.position)))
    for i, k in enumerate(count):
        W[i, index[i, :k]] = weight[i, :k]
    v = system.states.view(rate, "matrix.displacement")
    drive = np.einsum("ij,ij->i", W @ v, clutch.outward).mean()
    expected = 0.5 * (drive + law.retrograde_speed) - off * 0.1
    assert system.states.view(rate, "cell1.bond_stretch")[0] == pytest.approx(expected, rel=1e-9)
    total = W.sum(1)
    found = 0.02 * total / (1 - total)  # W = q/(q + 0.02)
    on = law.on_rate * (found / (found + 0.1)).mean()
    grown = on * 0.5 - off * 0.5
    assert system.states.view(rate, "cell1.bond_strength")[0] == pytest.approx(grown, rel=1e-9)


def test_a_disc_has_no_radial_cell():
    scene = cs.load_scene("examples/spreading.toml")
    with pytest.raises(cs.SceneError, match=r"matrix\.kind"):
        cs.RadialCell().of(cs.build(scene))
