"""What an effect gives it takes: forces, couples and power of the pulling cell, and its start."""

import copy
import tomllib
from pathlib import Path

import numpy as np
import pytest

from cellsys.effects import protrusion_kernels
from cellsys.effects.footing import SurfaceBins
from cellsys.errors import SceneError
from cellsys.geometry.membrane import enclosed_volume
from cellsys.integrate import LinearlyImplicit, simulate
from cellsys.laws.clutch import reinforced_rate
from cellsys.laws.lamellipodium import protrusion
from cellsys.observe import tractions
from cellsys.scene import Scene, build, load_scene
from cellsys.scene.listing import effect_list
from cellsys.scene.registry import LISTED
from tests.mechanics.scenes import disturbed, element, small, table
from tests.mechanics.small_scenes import tiny, tiny_system

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
PULLING = {
    "lamellipodium": {"force": "600 pN", "reaction": "clutch"},
    "substrate_contact": {"support": "matrix"},
}


@pytest.fixture(scope="module")
def pulling():
    """The small cell that pushes itself off its clutches, on a matrix that carries it."""
    return small(**PULLING)


def pushed(system, seed):
    """A random state with bonds, loads and a heading, and the forces of every element."""
    x = disturbed(system, seed)
    x[np.isinf(system.drag())] = 0.0
    s = system.configuration(0.0, x)
    forces = {}
    for e in system.elements:
        forces[e.name] = {port.array: f for port, f in forces_of(s, e)}
    return s, forces


def forces_of(s, item):
    """Ports and inputs of an element, each with its force."""
    out = [np.zeros_like(s.nodes[p.array]) for p in (*item.ports, *item.inputs)]
    item.efforts(s, tuple(out[: len(item.ports)]))
    if item.inputs:
        item.force(s, tuple(out[len(item.ports) :]))
    return list(zip((*item.ports, *item.inputs), out, strict=True))


def in_place(system, s, array):
    return s.nodes[array] + (system.matrix.position if array == "matrix" else 0.0)


# Balance


def unbalanced(system, s, item):
    """Share of an element's forces that sums to something; an offset is no place."""
    total, scale = np.zeros(3), 0.0
    for port, part in forces_of(s, item):
        if port.array.endswith("cortex"):
            continue
        total, scale = total + part.sum(axis=0), scale + np.abs(part).sum()
    return np.abs(total).max() / scale if scale else 0.0


@pytest.mark.parametrize("name", sorted(LISTED))
def test_every_effect_balances_its_forces_or_says_who_takes_them_up(name):
    """At its default parameters; rounding of some thousand terms."""
    system = tiny_system(name)
    rng = np.random.default_rng(1)
    x = system.x0 + 0.05 * rng.standard_normal(system.states.size)
    for block in system.states:
        if block.name.endswith(".position"):
            system.states.view(x, block.name)[:, 2] -= 0.3
    told = {row["effect"]: row["outside work"] for row in effect_list()}[name]
    x, _ = system.between_steps(0.0, np.where(np.isinf(system.drag()), system.x0, x), 5.0, rng)
    s = system.configuration(0.0, x)
    for item in (e for e in system.elements if e.name.endswith(f".{name}")):
        assert item.outside == told
        if item.holds or (item.inputs and not item.ports):
            assert told, f"{item.name} pushes from outside and does not say so"
        if unbalanced(system, s, item) > 1e-12:
            assert told, f"{item.name} leaves a force and does not say who takes it up"


def test_the_unbalanced_forms_are_seen_to_leave_a_force(pulling):
    """What the test above would find in the literal forms if they did not say so."""
    s, forces = pushed(pulling, 0)
    rigid = small(substrate_contact={"support": "rigid"})
    wall = element(rigid, "cell1.substrate_contact")
    assert wall.outside
    assert unbalanced(rigid, pushed(rigid, 0)[0], wall) > 0.5
    source = element(rigid, "cell1.lamellipodium")
    assert source.inputs
    assert source.outside
    for name in ("cell1.lamellipodium", "cell1.substrate_contact", "cell1.focal_adhesion"):
        assert sum(np.abs(f).sum() for f in forces[name].values()) > 100.0
        assert unbalanced(pulling, s, element(pulling, name)) < 1e-14


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_cell_and_matrix_take_from_each_other_what_they_give(pulling, seed):
    """Sum of forces of all elements between them, and of their couples about the normal."""
    s, forces = pushed(pulling, seed)
    total, turn, size, arm = np.zeros(3), 0.0, 0.0, 0.0
    for name in ("cell1.lamellipodium", "cell1.substrate_contact", "cell1.focal_adhesion"):
        for array, f in forces[name].items():
            r = in_place(pulling, s, array)
            total += f.sum(axis=0)
            turn += (r[:, 0] * f[:, 1] - r[:, 1] * f[:, 0]).sum()
            size += np.abs(f).sum()
            arm += (np.abs(r[:, :2]).max(axis=1) * np.abs(f).max(axis=1)).sum()
    assert np.abs(total).max() < 1e-14 * size
    assert abs(turn) < 1e-13 * arm


def test_without_the_couple_the_reaction_would_turn_the_pair(pulling):
    """Shares alone put the reaction aside of the push: what the clutches' couple is there for."""
    s, _ = pushed(pulling, 0)
    item = element(pulling, "cell1.lamellipodium")
    carried = item.carried(s)
    bare = oracle(pulling, s, couple=False)[1]
    x, place = s.nodes["cell1"], acting(pulling, s)
    cell, _ = item._shares(s)
    turn = (x[:, 0] * cell[:, 1] - x[:, 1] * cell[:, 0]).sum()
    for load, left in ((bare, True), (carried, False)):
        pull = element(pulling, "cell1.focal_adhesion").pulls(s)
        rest = turn - (place[:, 0] * load[:, 1] - place[:, 1] * load[:, 0]).sum()
        away = x[:, :2] - place
        rest += (away[:, 0] * pull[:, 1] - away[:, 1] * pull[:, 0]).sum()
        assert (abs(rest) > 1.0) == left


def acting(system, s):
    """Where each clutch acts on the matrix (n, 2), from the weights of a search of its own."""
    index, weight, count = SurfaceBins(system.matrix, 3.0).weights(s.nodes["cell1"])
    at = in_place(system, s, "matrix")[:, :2]
    return np.array([w[:c] @ at[i[:c]] if c else np.zeros(2)
                     for i, w, c in zip(index, weight, count, strict=True)])  # fmt: skip


def oracle(system, s, couple=True):
    """g_i f_i and r_j, written with numpy from the equations alone."""
    x, n = s.nodes["cell1"], s.internal["cell1.bond_strength"]
    f = protrusion(x, s.internal["cell1.polarity"], 600.0, 2.5, 0.1, 0.5, 0.3)
    _, _, count = SurfaceBins(system.matrix, 3.0).weights(x)
    d2 = ((x[:, None, :2] - x[None, :, :2]) ** 2).sum(axis=2)
    K = (n * (count > 0)) * np.clip(1.0 - d2 / 36.0, 0.0, None) ** 3
    phi = K / (K.sum(axis=1) + 0.5)[:, None]
    cell, carried = phi.sum(axis=1)[:, None] * f, phi.T @ f
    if couple:
        place, pull = acting(system, s), 2000.0 * s.internal["cell1.bond_stretch"]
        away = x[:, :2] - place
        turn = (np.cross(x[:, :2], cell[:, :2]) - np.cross(place, carried[:, :2])).sum()
        turn += np.cross(away, pull)[count > 0].sum()
        w = n * (count > 0)
        arm = place - (w @ place) / w.sum()
        omega = turn / (w @ (arm**2).sum(axis=1))
        carried[:, :2] += omega * (w[:, None] * np.column_stack([-arm[:, 1], arm[:, 0]]))
    return cell, carried


@pytest.mark.filterwarnings("ignore:Arrays of 2-dimensional vectors:DeprecationWarning")
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_push_against_numpy(pulling, seed):
    s, _ = pushed(pulling, seed)
    cell, carried = element(pulling, "cell1.lamellipodium")._shares(s)
    expected, load = oracle(pulling, s)
    assert np.abs(cell).max() > 10.0
    # The same sums in another order.
    assert np.allclose(cell, expected, rtol=1e-11, atol=1e-9)
    assert np.allclose(carried, load, rtol=1e-11, atol=1e-8)


def test_compiled_sector_is_the_law(pulling):
    s, _ = pushed(pulling, 4)
    for p in (np.array([0.6, 0.8, 0.0]), np.array([-2.0, 0.1, 0.4]), np.array([0.0, 0.0, 1.0])):
        out = np.empty((189, 3))
        protrusion_kernels.sector_push(s.nodes["cell1"], p, 600.0, 2.5, 0.1, 0.5, 0.3, out)
        assert np.allclose(out, protrusion(s.nodes["cell1"], p, 600.0, 2.5, 0.1, 0.5, 0.3),
                           rtol=1e-12, atol=1e-11)  # fmt: skip


def test_no_clutch_no_push(pulling):
    x = disturbed(pulling, 3)
    pulling.states.view(x, "cell1.bond_strength")[:] = 0.0
    pulling.states.view(x, "cell1.bond_stretch")[:] = 0.0
    s = pulling.configuration(0.0, x)
    cell, carried = element(pulling, "cell1.lamellipodium")._shares(s)
    assert not cell.any()
    assert not carried.any()


def test_unbinding_sees_the_load_that_is_carried(pulling):
    """k_off of the total |k_b S + r|, against the same state with the push commanded to zero."""
    s, _ = pushed(pulling, 1)
    clutch = element(pulling, "cell1.focal_adhesion")
    r = element(pulling, "cell1.lamellipodium").carried(s)
    total = 2000.0 * s.internal["cell1.bond_stretch"] + r[:, :2]
    assert np.allclose(clutch._loads(s), np.hypot(*total.T), rtol=1e-12)
    bare = np.hypot(*(2000.0 * s.internal["cell1.bond_stretch"]).T)
    assert np.abs(clutch._loads(s) - bare).max() > 1.0


def test_power_goes_from_one_to_the_other_or_into_the_drag(pulling):
    """Power of all ports on moving nodes = sum C v^2; of the push = its effort times its slip."""
    s, forces = pushed(pulling, 2)
    state = disturbed(pulling, 2)
    state[np.isinf(pulling.drag())] = 0.0
    rate = pulling.rhs(0.0, state)
    blocks = {"cell1": "cell1.position", "matrix": "matrix.displacement"}
    v = {array: pulling.states.view(rate, block) for array, block in blocks.items()}
    given = sum((f * v[a]).sum() for parts in forces.values() for a, f in parts.items())
    C = np.where(np.isfinite(pulling.drag()), pulling.drag(), 0.0)
    lost = sum((C[pulling.states.slice(b)] * rate[pulling.states.slice(b)] ** 2).sum()
               for b in ("cell1.position", "matrix.displacement"))  # fmt: skip
    assert given == pytest.approx(lost, rel=1e-11)
    cell, carried = element(pulling, "cell1.lamellipodium")._shares(s)
    index, weight, count = SurfaceBins(pulling.matrix, 3.0).weights(s.nodes["cell1"])
    under = np.array([w[:c] @ v["matrix"][i[:c]] if c else np.zeros(3)
                      for i, w, c in zip(index, weight, count, strict=True)])  # fmt: skip
    push = forces["cell1.lamellipodium"]
    power = (push["cell1"] * v["cell1"]).sum() + (push["matrix"] * v["matrix"]).sum()
    assert power == pytest.approx((cell * v["cell1"]).sum() - (carried * under).sum(), rel=1e-11)


def test_tractions_of_a_run_are_the_drag_of_the_medium(pulling):
    """Sum of tractions = -N C V, to the step residual; 0.2 % of the sum of magnitudes is asked."""
    run = simulate(pulling, LinearlyImplicit(step=0.5), np.arange(0.0, 81.0, 5.0))
    found = tractions(run)
    assert found.sum_pN > 1000.0
    assert found.imbalance_share < 2e-3
    V = np.diff(run.block("cell1.position").mean(axis=1), axis=0)[-1] / 5.0
    assert np.allclose(found.drag, -189 * 2000.0 * V, rtol=1e-9)
    assert np.trace(found.dipole_pN_um) < 0
    front, rear = found.front_rear_pN
    assert front < 0 < rear
    literal = small()
    old = tractions(simulate(literal, LinearlyImplicit(step=0.5), np.arange(0.0, 81.0, 5.0)))
    assert old.imbalance_share > 0.2


def test_a_push_off_clutches_needs_clutches():
    for change in ({"focal_adhesion": None}, {"focal_adhesion": {"kinetics": "switching"}}):
        with pytest.raises(SceneError, match="needs focal_adhesion"):
            small(**PULLING, **change)
    with pytest.raises(SceneError, match="needs a matrix"):
        tiny_system("substrate_contact", matrix=False, substrate_contact={"support": "matrix"})
    alone = tiny("lamellipodium", "membrane_elasticity", matrix=False)
    alone["effects"]["lamellipodium"] = {"reaction": "clutch"}
    with pytest.raises(SceneError, match="matrix"):
        build(Scene.parse(alone))


# Literal form


def test_the_literal_scene_runs_as_it_did():
    """60 s against arrays stored from version 0.2.0 before the reaction: to 1e-12 of a micrometre.

    `tests/mechanics/literal.npz` holds ``examples/spreading.toml`` of that version.
    """
    known = np.load(Path(__file__).with_name("literal.npz"))
    system = build(load_scene(EXAMPLES / "spreading_literal.toml"))
    run = simulate(system, LinearlyImplicit(step=0.5), known["t"])
    for name in ("cell1.position", "matrix.displacement", "cell1.bond_strength",
                 "cell1.bond_stretch", "cell1.polarity"):  # fmt: skip
        stored = known[name.replace(".", "_")]
        assert np.abs(run.block(name)[1:] - stored).max() <= 1e-12, name


def test_shipped_and_literal_scenes_differ_in_the_forms_alone():
    new, old = (
        tomllib.loads((EXAMPLES / f).read_text())
        for f in ("spreading.toml", "spreading_literal.toml")
    )
    for spec in (new, old):
        spec.pop("name")
        for name in ("volume", "focal_adhesion", "lamellipodium", "substrate_contact",
                     "stiffness_sensing"):  # fmt: skip
            spec["effects"].pop(name)
    assert old.pop("run") == {"stepper": "LinearlyImplicit", "step": "0.5 s"}  # as it was recorded
    assert new == old


# Bonds


def test_reinforced_bonds_live_longer_where_the_matrix_is_stiff():
    system = small(focal_adhesion={"reinforcement": 3}, **PULLING)
    s, _ = pushed(system, 0)
    clutch, fibres = (element(system, f"{n}") for n in ("cell1.focal_adhesion",
                                                        "matrix.matrix_elasticity"))  # fmt: skip
    index, weight, count = SurfaceBins(system.matrix, 3.0).weights(s.nodes["cell1"])
    k = fibres.nodal(s)["stiffness"]
    under = np.array([w[:c] @ k[i[:c]] for i, w, c in zip(index, weight, count, strict=True)])
    expected = (1.0 / 80.0) * (1.0 + 3.0 * 12000.0 / (under + 12000.0))
    assert np.allclose(clutch.off_rates(s), expected, rtol=1e-12)
    assert reinforced_rate(0.1, 0.0, 3.0, 1.0) == pytest.approx(0.4)
    assert reinforced_rate(0.1, 1e12, 3.0, 1.0) == pytest.approx(0.1)
    with pytest.raises(SceneError, match=r"reinforcement = 3"):
        small(focal_adhesion={"kinetics": "switching", "reinforcement": 3})


# Volume


FREE = {
    "name": "free cell", "duration": "20 s",
    "cells": [{"position": ["0 um", "0 um"]}],
    "effects": {"drag": {}, "membrane_elasticity": {}, "volume": {}, "cortical_tension": {}},
}  # fmt: skip


def free(radius=8.0, tension=150.0, **effects):
    spec = copy.deepcopy(FREE)
    spec["cells"][0]["radius"] = f"{radius} um"
    spec["effects"]["cortical_tension"] = {"tension": f"{tension} pN/um"}
    for name, parameters in effects.items():
        if parameters is None:
            spec["effects"].pop(name)
        else:
            spec["effects"][name] = parameters
    return build(Scene.parse(spec))


@pytest.mark.parametrize(
    ("radius", "tension", "more"),
    [
        (8.0, 150.0, {}),
        (4.0, 600.0, {}),
        (15.0, 50.0, {}),
        (8.0, 150.0, {"nucleus": {}}),
        (8.0, 0.0, {"cortical_tension": None, "cortex": {}}),
    ],
)
def test_the_free_cell_starts_at_rest_under_laplaces_pressure(radius, tension, more):
    system = free(radius, tension, **more)
    x = system.states.view(system.x0, "cell1.position")
    mesh = system.cells[0].body.membrane
    gamma = tension or 150.0
    # A mesh of flat triangles has a little more than Laplace's pressure of the sphere.
    assert element(system, "cell1.volume").pressure == pytest.approx(2 * gamma / radius, rel=0.02)
    # Without the balance nodes would start at 30 pN/2000 pN s/um.
    assert np.abs(system.rhs(0.0, system.x0.copy())).max() < 1e-6
    assert x[:, 2].min() == pytest.approx(mesh.position[:, 2].min(), abs=1e-12)
    assert 0.99 < enclosed_volume(x, mesh.triangles) / mesh.volume < 1.01
    zero = free(radius, tension, volume={"pressure": "zero"}, **more)
    assert np.abs(zero.rhs(0.0, zero.x0.copy())).max() > 1e-3
    assert np.array_equal(zero.states.view(zero.x0, "cell1.position"), mesh.position)


def test_stress_fibres_and_clutches_start_at_rest_too():
    system = small(nucleus={}, stress_fibres={}, **PULLING)
    cell = system.states.slice("cell1.position")
    assert np.abs(system.rhs(0.0, system.x0.copy())[cell]).max() < 1e-6


def test_a_cell_without_rest_is_refused():
    with pytest.raises(SceneError, match="no equilibrium of the free cell"):
        free(8.0, 0.0, cortical_tension=None, cortex={"tension": "20000 pN/um"})


def test_where_a_cell_starts_does_not_change_its_shape():
    spec = table(**PULLING)
    moved = copy.deepcopy(spec)
    moved["cells"][0]["position"] = ["3.1 um", "-2.2 um"]
    a, b = (build(Scene.parse(t)) for t in (spec, moved))
    shape = [s.states.view(s.x0, "cell1.position") for s in (a, b)]
    shape = [x - x[0] for x in shape]
    assert np.abs(shape[0] - shape[1]).max() < 1e-9
