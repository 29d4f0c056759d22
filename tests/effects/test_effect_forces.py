"""Forces of every effect against the complex-step gradient of its energy; sums; majorants."""

import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.effects.protocol import Element
from cellsys.errors import ParameterError
from cellsys.scene.registry import LISTED
from tests.effects.test_majorant import bound, tangent
from tests.mechanics.energies import ENERGIES
from tests.mechanics.scenes import TABLE
from tests.mechanics.small_scenes import tiny_system

CASES = {
    **{name: {} for name in ENERGIES},
    "kelvin": {"matrix_creep": {"branch": "kelvin"}},
    "kelvin, stiffening": {
        "matrix_creep": {"branch": "kelvin"},
        "matrix_elasticity": {"law": "stiffening", "onset": "0.005"},
    },
    "anchored": {},
}
ALSO = {"kelvin": ("matrix_creep",), "kelvin, stiffening": ("matrix_creep",),
        "anchored": ("stress_fibres", "nucleus")}  # fmt: skip


def built(case, cells=2):
    """System, and the name of the effect that is looked at."""
    names = ALSO.get(case, (case,))
    return tiny_system(*names, cells=cells, **CASES[case]), names[0]


def disturbed(system, seed, size=0.1):
    """A random state: every node moved, every internal state off its rest."""
    rng = np.random.default_rng(seed)
    x = system.x0.copy()
    for block in system.states:
        part = system.states.view(x, block.name)
        if block.name.endswith(("position", "offset", "displacement")):
            part += (
                (0.03 if "displacement" in block.name else 1.0)
                * size
                * rng.standard_normal(part.shape)
            )
    for k, towards in ((1, 0.35), (2, -0.35)):  # touching each other and the substrate
        if f"cell{k}.position" in system.states:
            system.states.view(x, f"cell{k}.position")[:] += [towards, 0.0, -0.2]
    x[np.isinf(system.drag())] = system.x0[np.isinf(system.drag())]
    for name, (low, high) in {
        "bond_strength": (0, 1), "bond_stretch": (-0.05, 0.05), "creep": (-0.02, 0.02),
        "intact": (0.2, 1.0),
    }.items():  # fmt: skip
        for block in system.states:
            if block.name.endswith("." + name):
                part = system.states.view(x, block.name)
                part[...] = rng.uniform(low, high, part.shape)
    x, _ = system.between_steps(0.0, x, 20.0, rng)
    for block in system.states:
        if block.name.endswith("bond_length"):
            system.states.view(x, block.name)[...] *= 0.8
    return x


def of_effect(system, name):
    """Elements of one effect."""
    return [e for e in system.elements if e.name.endswith(f".{name}")]


def port_forces(system, item, x):
    s = system.configuration(0.0, x.copy())
    out = tuple(np.zeros_like(s.nodes[p.array]) for p in item.ports)
    item.efforts(s, out)
    total = {}
    for port, f in zip(item.ports, out, strict=True):
        total[port.array] = total.get(port.array, 0.0) + f
    return total, s


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", [0, 1])
def test_force_is_minus_the_gradient_of_the_stated_energy(case, seed):
    """Complex step: exact to rounding, 1e-11 of the forces' size.

    The energy that the element itself states agrees with the one written in the test up to a
    constant: their differences between two states agree.
    """
    system, name = built(case)
    rng, x = np.random.default_rng(seed), disturbed(system, seed)
    other = disturbed(system, seed + 10)
    for item in of_effect(system, name):
        forces, s = port_forces(system, item, x)
        h, seen = 1e-20, 0.0
        for _ in range(3):
            direction = {a: rng.standard_normal(f.shape) for a, f in forces.items()}
            nodes = {a: s.nodes[a] + 1j * h * direction.get(a, 0.0) for a in s.nodes}
            slope = ENERGIES[name](item, nodes, s.internal).imag / h
            power = sum(float((forces[a] * direction[a]).sum()) for a in forces)
            scale = sum(float(np.abs(forces[a] * direction[a]).sum()) for a in forces)
            assert abs(slope + power) <= 1e-11 * scale
            seen = max(seen, scale)
        assert seen > 1e-3, "no force in this state: nothing was compared"
        there = system.configuration(0.0, other)
        mine = [
            ENERGIES[name](item, {a: n + 0j for a, n in c.nodes.items()}, c.internal).real
            for c in (s, there)
        ]
        stated = [item.energy(c) for c in (s, there)]
        size = max(np.abs([*mine, *stated]))
        assert abs((mine[1] - mine[0]) - (stated[1] - stated[0])) < 1e-9 * size


# Effects whose forces are not the gradient of an energy alone, each with the reason.
NO_ENERGY = {
    "drag": "dissipates",
    "focal_adhesion": "shares forces by weights; its gradient parts are in test_forces",
    "lamellipodium": "feeds energy in",
    "external_load": "feeds energy in",
    "external_strain": "prescribes places",
    "noise": "feeds energy in",
    "stiffness_sensing": "no force",
    "polarity": "no force",
}


def test_every_effect_has_a_second_energy_or_a_reason():
    """A new effect belongs to one of the two."""
    assert set(ENERGIES) | set(NO_ENERGY) == set(LISTED)
    assert not set(ENERGIES) & set(NO_ENERGY)
    for name in NO_ENERGY.keys() - {"focal_adhesion"}:
        for item in of_effect(tiny_system(name), name):
            assert type(item).energy is Element.energy, name


def test_every_bound_of_a_tangent_is_compared_with_it():
    """Here, or among the standard effects of test_majorant."""
    for name in set(LISTED) - set(TABLE["effects"]) - set(NEW):
        for item in of_effect(tiny_system(name), name):
            for method in ("stiffness", "low_rank"):
                assert getattr(type(item), method) is getattr(Element, method), (name, method)


INTERNAL = [c for c in CASES if c not in ("substrate_contact", "foundation")]


@pytest.mark.parametrize("case", INTERNAL)
@pytest.mark.parametrize("seed", [2, 3])
def test_forces_and_torques_of_inner_elements_vanish(case, seed):
    """Sum over all arrays that an element touches; an offset turns with the cell, it has no place.

    Rounding of a few thousand terms.
    """
    system, name = built(case)
    x = disturbed(system, seed)
    for item in of_effect(system, name):
        forces, s = port_forces(system, item, x)
        total, torque, scale = np.zeros(3), np.zeros(3), 0.0
        for array, f in forces.items():
            place = s.nodes[array] + (system.matrix.position if array == "matrix" else 0.0)
            total += 0.0 if array.endswith("cortex") else f.sum(axis=0)
            torque += np.cross(place, f).sum(axis=0)
            scale += np.abs(f).sum()
        assert np.abs(total).max() <= 1e-14 * scale
        assert np.abs(torque).max() <= 1e-12 * scale


NEW = ["fibre_bending", "matrix_creep", "kelvin", "kelvin, stiffening", "cortex", "nucleus",
       "stochastic_adhesion", "stress_fibres", "anchored", "cell_contact",
       "matrix_degradation", "matrix_contact"]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("case", NEW)
def test_majorant_bounds_the_tangent(case):
    """M - 3/4 K >= 0 with K the tangent of one step by central differences (see test_majorant)."""
    system, _ = built(case, cells=2 if case == "cell_contact" else 1)
    x = disturbed(system, 7)
    free = np.flatnonzero(np.isfinite(system.drag()) & (system.drag() > 0))
    M = bound(system, 0.0, x)[np.ix_(free, free)]
    K = tangent(system, 0.0, x, free)
    K = 0.5 * (K + K.T)
    lowest = sla.eigvalsh(M - 0.75 * K, subset_by_index=[0, 0])[0]
    # Differences of 1e-6 um leave 1e-4 pN/um or so of forces of a hundred pN.
    assert lowest > -1e-3 * max(1.0, np.abs(K).max() * 1e-3)


def test_an_element_without_an_energy_says_so():
    system = tiny_system("membrane_elasticity")

    class Motor(Element):
        name = "motor"

    with pytest.raises(ParameterError, match="motor is not the gradient of an energy"):
        Motor().energy(system.configuration(0.0, system.x0))
