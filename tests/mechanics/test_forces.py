"""Forces of every effect: gradient of the energy, vanishing sums, pairs, none if absent."""

import numpy as np
import pytest

from cellsys.effects.matrix import FibreElement
from cellsys.effects.protocol import Element
from tests.mechanics.scenes import clutch, disturbed, element, force, small, switching

STATES = {"cell1": "cell1.position", "matrix": "matrix.displacement"}
# The clutch's zipper spring has fixed weights only in the horizontal rest frame; its energy is
# checked along z below.
WITH_ENERGY = [
    "cell1.membrane_elasticity",
    "cell1.volume",
    "cell1.cortical_tension",
    "cell1.substrate_contact",
    "matrix.matrix_elasticity",
    "matrix.foundation",
]


def check_gradient(system, item, x, rng, axes=(0, 1, 2), rtol=2e-6):
    """dE along random directions against -F, by central differences.

    h = 1e-5 um: truncation h^2 E'''/6 is about 1e-7 of the force (lengths of 1 um, fibre blend
    of 0.003 um spread over hundreds of nodes), rounding 1e-16 E/h about as much.
    """
    h = 1e-5
    forces = force(system, item, x)
    for array, f in forces.items():
        for _ in range(4):
            direction = np.zeros_like(f)
            direction[:, axes] = rng.standard_normal((len(f), len(axes)))
            values = []
            for sign in (1, -1):
                moved = x.copy()
                system.states.view(moved, STATES[array])[:] += sign * h * direction
                values.append(item.energy(system.configuration(0.0, moved)))
            by_difference = (values[0] - values[1]) / (2 * h)
            scale = np.linalg.norm(f[:, axes]) * np.sqrt(len(axes)) + 1e-3
            assert (
                abs(by_difference + float((f * direction).sum()))
                < rtol * scale + 3e-16 * abs(values[0]) / h
            )


@pytest.mark.parametrize("name", WITH_ENERGY)
@pytest.mark.parametrize("seed", [0, 1])
def test_force_is_minus_the_gradient_of_the_energy(name, seed):
    system, rng = clutch(), np.random.default_rng(seed)
    check_gradient(system, element(system, name), disturbed(system, seed), rng)


@pytest.mark.parametrize("law", ["linear", "stiffening"])
def test_fibre_laws_are_gradients(law):
    system = small(matrix_elasticity={"law": law})
    rng = np.random.default_rng(2)
    for size in (0.05, 0.5):
        check_gradient(
            system, element(system, "matrix.matrix_elasticity"), disturbed(system, 2, size), rng
        )


def test_clusters_are_gradients_at_fixed_bonds():
    system, rng = switching(), np.random.default_rng(4)
    x = disturbed(system, 4)
    assert (system.states.view(x, "cell1.bond_partner") >= 0).sum() > 5
    check_gradient(system, element(system, "cell1.focal_adhesion"), x, rng)


def test_zipper_is_a_gradient_along_the_vertical():
    """Weights depend on horizontal positions only, so along z they are constant."""
    system, rng = clutch(), np.random.default_rng(5)
    x = disturbed(system, 5)
    check_gradient(system, element(system, "cell1.focal_adhesion"), x, rng, axes=(2,))


def test_every_effect_with_an_energy_is_checked():
    covered = {*WITH_ENERGY, "cell1.focal_adhesion"}
    for system in (clutch(), switching()):
        for item in system.elements:
            if type(item).energy is not Element.energy:
                assert item.name in covered


def squeezed(x):
    """A cell whose triangles have both grown and shrunk by a factor of about two."""
    return x * np.array([1.6, 0.9, 0.4])


@pytest.mark.parametrize("name", ["membrane_elasticity", "cortical_tension", "volume"])
def test_area_and_line_forces_hold_far_from_rest(name):
    system, rng = clutch(), np.random.default_rng(6)
    x = disturbed(system, 6, 0.1)
    cell = system.states.view(x, "cell1.position")
    cell[:] = squeezed(cell)
    check_gradient(system, element(system, f"cell1.{name}"), x, rng)


INTERNAL = ["cell1.membrane_elasticity", "cell1.volume", "cell1.cortical_tension",
            "matrix.matrix_elasticity"]  # fmt: skip


@pytest.mark.parametrize("name", INTERNAL)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_internal_forces_and_torques_sum_to_zero(name, seed):
    system = clutch()
    x = disturbed(system, seed)
    item = element(system, name)
    ((array, f),) = force(system, item, x).items()
    position = system.states.view(x, STATES[array]).copy()
    if array == "matrix":
        position += system.matrix.position
    # Sums of a few thousand terms: rounding of each times the square root of their number.
    scale = np.abs(f).sum() * 1e-15
    assert np.abs(f.sum(axis=0)).max() < scale
    assert np.abs(np.cross(position, f).sum(axis=0)).max() < scale * np.abs(position).max()


@pytest.mark.parametrize("seed", [0, 1])
def test_clusters_pull_equally_and_oppositely(seed):
    """Force and torque of a pair vanish [thesis eq. 61]; free nodes feel exactly nothing [62]."""
    system = switching()
    x = disturbed(system, seed)
    item = element(system, "cell1.focal_adhesion")
    f = force(system, item, x)
    partner = system.states.view(x, "cell1.bond_partner").astype(int)
    bound = np.flatnonzero(partner >= 0)
    assert np.array_equal(f["cell1"][bound], -f["matrix"][partner[bound]])
    assert np.abs(f["cell1"][bound]).max() > 1.0
    assert not f["cell1"][partner < 0].any()
    free = np.setdiff1d(np.arange(len(f["matrix"])), partner[bound])
    assert not f["matrix"][free].any()
    cell = system.states.view(x, "cell1.position")
    matrix = system.matrix.position + system.states.view(x, "matrix.displacement")
    torque = np.cross(cell, f["cell1"]).sum(0) + np.cross(matrix, f["matrix"]).sum(0)
    assert np.abs(torque).max() < 1e-13 * np.abs(f["cell1"]).sum() * 20
    assert len(set(partner[bound])) == len(bound)  # one to one


@pytest.mark.parametrize("seed", [0, 1])
def test_clutch_gives_the_matrix_what_it_takes_from_the_cell(seed):
    system = clutch()
    f = force(system, element(system, "cell1.focal_adhesion"), disturbed(system, seed))
    total = f["cell1"].sum(axis=0) + f["matrix"].sum(axis=0)
    assert np.abs(total).max() < 1e-14 * np.abs(f["cell1"]).sum()
    assert np.abs(f["cell1"]).max() > 1.0


@pytest.mark.parametrize("seed", [0, 1])
def test_clutch_is_power_conjugate(seed):
    """Power on cell and matrix = -force . slip, with the slip through the same weights."""
    system, rng = clutch(), np.random.default_rng(seed)
    x = disturbed(system, seed)
    item = element(system, "cell1.focal_adhesion")
    f = force(system, item, x)
    s = system.configuration(0.0, x)
    index, weight, count = item.footing.weights(s)
    v_cell = rng.standard_normal(f["cell1"].shape)
    v_matrix = rng.standard_normal(f["matrix"].shape)
    under = (weight[:, :, None] * v_matrix[index]).sum(axis=1)
    slip = np.where(count[:, None] > 0, under - v_cell, 0.0)
    power = (f["cell1"] * v_cell).sum() + (f["matrix"] * v_matrix).sum()
    assert power == pytest.approx(-(f["cell1"] * slip).sum(), rel=1e-12)
    assert weight.sum(axis=1)[count > 0] == pytest.approx(1.0, rel=1e-14)


def test_absent_effects_have_no_states_and_no_columns():
    bare = small(
        focal_adhesion=None, lamellipodium=None, stiffness_sensing=None, polarity=None,
        cortical_tension=None, foundation=None,
    )  # fmt: skip
    assert [b.name for b in bare.states] == ["cell1.position", "matrix.displacement"]
    names = [b.name for b in bare.auxiliaries]
    assert names == [
        "matrix.matrix_elasticity", "cell1.membrane_elasticity", "cell1.volume",
        "cell1.substrate_contact",
    ]  # fmt: skip
    assert not bare.inputs
    assert bare.W_eta.shape[1] == 320 * 3 + 3 * 189 * 3
    assert not bare.u(0.0, bare.x0).any()


def test_absent_effects_are_never_called(monkeypatch):
    from cellsys.effects import clutch_kernels, steering, switching

    def refuse(*args):
        raise RuntimeError("the law of an absent effect was called")

    for name in ("clutch_loads", "clutch_rates", "surface_weights", "clutch_advance"):
        monkeypatch.setattr(clutch_kernels, name, refuse)
    for name in ("cluster_loads", "bind_nearest"):
        monkeypatch.setattr(switching, name, refuse)
    for name in ("protrusion", "stiffest_direction", "exact_step", "rate"):
        monkeypatch.setattr(steering, name, refuse)
    bare = small(focal_adhesion=None, lamellipodium=None, stiffness_sensing=None, polarity=None)
    x = bare.x0.copy()
    bare.rhs(0.0, x)
    bare.majorant(0.0, x, 0.5)
    bare.between_steps(0.0, x, 0.5, np.random.default_rng(0))
    bare.observe(0.0, x)
    with pytest.raises(RuntimeError, match="absent effect"):
        clutch().rhs(0.0, clutch().x0.copy())


def test_parameters_reach_the_force():
    """Twice the stiffness, twice the force: every linear parameter, effect by effect."""
    for name, parameter, value, port in (
        ("cortical_tension", "tension", "300 pN/um", "cell1"),
        ("substrate_contact", "stiffness", "2000 pN/um", "cell1"),
        ("foundation", "spring", "1000 pN/um", "matrix"),
    ):
        changed = small(**{name: {parameter: value}})
        x = disturbed(clutch(), 7)
        label = f"{port}.{name}"
        one = force(clutch(), element(clutch(), label), x)[port]
        two = force(changed, element(changed, label), x)[port]
        assert np.abs(one).max() > 0
        assert two == pytest.approx(2.0 * one, rel=1e-14)
    one, two = (
        force(s, element(s, "cell1.volume"), disturbed(s, 7))["cell1"]
        for s in (
            small(volume={"modulus": k, "pressure": "zero"}) for k in ("300 pN/um^2", "600 pN/um^2")
        )
    )
    assert two == pytest.approx(2.0 * one, rel=1e-14)


def test_slopes_are_shared_by_sensor_and_majorant():
    system = clutch()
    s = system.configuration(0.0, disturbed(system, 1))
    fibres = next(e for e in system.elements if isinstance(e, FibreElement))
    assert fibres.slopes(s)[0] is fibres.slopes(s)[0]
