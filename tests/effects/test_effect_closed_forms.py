"""Effects against solutions on paper: a lattice, one fibre, two fibres in line, a sphere."""

import numpy as np
import pytest

from cellsys.effects.noise import BOLTZMANN
from cellsys.geometry.disc import Disc
from cellsys.integrate import LinearlyImplicit, simulate
from cellsys.mechanics.spreading import build_spreading
from cellsys.scene.registry import EFFECTS
from tests.mechanics.small_scenes import tiny_system


def network(position, fibres, clamped, stiffness=1000.0):
    """A disc of given nodes and fibres, all of them at rest."""
    position = np.asarray(position, float)
    fibres = np.asarray(fibres, np.int64)
    length = np.linalg.norm(position[fibres[:, 1]] - position[fibres[:, 0]], axis=1)
    return Disc(
        radius=10.0,
        thickness=1.0,
        position=position,
        fibres=fibres,
        length=length,
        stiffness=np.full(len(fibres), stiffness),
        clamped=np.asarray(clamped, bool),
        surface=np.arange(len(position)),
    )


def on_network(disc, **effects):
    """Built system of effects that act on the matrix alone."""
    made = {n: EFFECTS[n](**p) for n, p in effects.items()}
    return build_spreading((), disc, made, EFFECTS["drag"]())


def run(system, t, step=0.5):
    return simulate(system, LinearlyImplicit(step=step), np.asarray(t, float), seed=1)


def held_at(value):
    """A history with one value for all times."""
    history = EFFECTS["external_strain"]().history
    return type(history)((0.0,), (value,))


def test_a_lattice_passes_the_patch_test_under_external_strain():
    """Nodes with opposite neighbours are in equilibrium in every affine shape.

    The slowest mode of nine rows relaxes at 0.1 1/s or faster: e^-30 is left after 300 s.
    """
    i, j = np.meshgrid(np.arange(-4, 5), np.arange(-4, 5))
    kept = np.abs(i + j) <= 4
    x = np.column_stack([(i + 0.5 * j)[kept], np.sqrt(0.75) * j[kept], np.zeros(kept.sum())])
    apart = np.linalg.norm(x[:, None] - x[None], axis=2)
    near = (apart > 0.5) & (apart < 1.1)
    fibres = np.argwhere(np.triu(near))
    rim = near.sum(axis=1) < 6
    assert (~rim).sum() == 37
    strain, angle = 0.03, np.radians(25.0)
    system = on_network(
        network(x, fibres, rim),
        matrix_elasticity={"law": "linear"},
        external_strain={"strain": strain, "direction": angle, "history": held_at(1.0)},
    )
    u = run(system, [0.0, 300.0], step=1.0).block("matrix.displacement")[-1]
    e = np.array([np.cos(angle), np.sin(angle), 0.0])
    assert np.abs(u - strain * np.outer(x @ e, e)).max() < 1e-9


@pytest.mark.parametrize("branch", ["maxwell", "kelvin"])
def test_one_held_fibre_relaxes_as_on_paper(branch):
    """maxwell: f = k d (1 + q e^(-t/tau)); kelvin: f = k d (1 - q/(1+q) (1 - e^(-(1+q) t/tau))).

    A held length makes the update of the branch exact: rounding, and the softened length (1e-12).
    """
    k, q, tau, d = 1000.0, 0.5, 20.0, 0.04
    system = on_network(
        network([[-1, 0, 0], [1, 0, 0]], [[0, 1]], [True, True], k),
        matrix_elasticity={"law": "linear"},
        matrix_creep={"branch": branch, "ratio": q, "time": tau},
        external_strain={"strain": d / 2.0, "history": held_at(1.0)},
    )
    result = run(system, np.arange(0.0, 61.0, 10.0))
    force = []
    for t, x in zip(result.t, result.x, strict=True):
        eta = system.efforts(t, x.copy())
        views = (system.auxiliaries.view(eta, f"matrix.{n}") for n in
                 ("matrix_elasticity", "matrix_creep"))  # fmt: skip
        force.append(float(sum(v[0, 0] for v in views)))
    past = np.exp(-result.t * (1.0 if branch == "maxwell" else 1.0 + q) / tau)
    expected = k * d * (1.0 + q * past if branch == "maxwell" else 1.0 - q / (1 + q) * (1 - past))
    assert np.abs(np.array(force) - expected).max() < 1e-9 * k * d


def test_two_fibres_in_line_bend_as_on_paper():
    """E = kappa theta^2/(2 l), end force kappa theta/(l l2) across the bent fibre.

    The angle is softened by 1e-3 rad: 1 % of energy and force at 0.3 rad.
    """
    kappa, theta = 20.0, 0.3
    l1, l2 = 1.0, 1.5
    mean = 0.5 * (l1 + l2)
    x = np.array([[0.0, 0, 0], [l1, 0, 0], [l1 + l2, 0, 0]])
    system = on_network(
        network(x, [[0, 1], [1, 2]], [False] * 3),
        matrix_elasticity={"law": "linear"},
        fibre_bending={"rigidity": kappa},
    )
    state = system.x0.copy()
    along = np.array([np.cos(theta), 0.0, np.sin(theta)])
    across = np.array([-np.sin(theta), 0.0, np.cos(theta)])
    system.states.view(state, "matrix.displacement")[2] = x[1] + l2 * along - x[2]
    energy = system.energy(0.0, state)
    assert energy["matrix.fibre_bending"] == pytest.approx(kappa * theta**2 / (2 * mean), rel=0.01)
    force = system.auxiliaries.view(system.efforts(0.0, state), "matrix.fibre_bending")
    assert force[2] @ across == pytest.approx(-kappa * theta / (mean * l2), rel=0.01)
    assert abs(force[2] @ along) < 1e-9
    assert force[0, 2] == pytest.approx(-kappa * theta / (mean * l1), rel=0.01)


def test_free_nodes_diffuse_by_fluctuation_and_dissipation():
    """<dx^2> = 2 k_B T t/C over every interval, at two temperatures and two drags.

    Increments are independent: a standard error of sqrt(2/N); four of them, 4 % of 2 x 9480.
    """
    for kelvin, drag in ((310.0, 1000.0), (77.0, 250.0)):
        effects = {"noise": EFFECTS["noise"](temperature=kelvin)}
        rng = np.random.default_rng(0)
        x = rng.uniform(-3, 3, (30, 3))
        disc = network(x, [[0, 1]], np.zeros(30, bool))
        system = build_spreading((), disc, effects, EFFECTS["drag"](matrix=drag))
        u = run(system, np.arange(0.0, 501.0, 5.0)).block("matrix.displacement")
        for lag in (1, 20):
            steps = u[lag::lag] - u[:-lag:lag]
            mean = (steps**2).mean() / (2.0 * BOLTZMANN * kelvin * 5.0 * lag / drag)
            assert mean == pytest.approx(1.0, abs=4 * np.sqrt(2 / steps.size)), (kelvin, lag)


def test_intact_shares_decay_by_distance_as_on_paper():
    """w = least + (1 - least) exp(-rate c t), c = 1/(1 + exp((d - reach)/width)); nothing moves."""
    rate, least, reach, width = 0.02, 0.15, 2.0, 0.5
    system = tiny_system(
        "matrix_degradation", cells=1,
        matrix_degradation={"rate": f"{rate} 1/s", "least": least},
    )  # fmt: skip
    result = run(system, [0.0, 30.0, 60.0])
    disc, cell = system.matrix, result.block("cell1.position")
    assert np.array_equal(cell[0], cell[-1])
    middle = disc.position[disc.fibres].mean(axis=1)
    d = np.linalg.norm(middle[:, None] - cell[0][None], axis=2).min(axis=1)
    exposed = np.where(d < reach + 8 * width, 1 / (1 + np.exp((d - reach) / width)), 0.0)
    expected = least + (1 - least) * np.exp(-rate * np.outer(result.t, exposed))
    assert np.abs(result.block("matrix.intact") - expected).max() < 1e-12


def scaled(system, factor):
    """State with every node of the first cell scaled about its middle."""
    x = system.x0.copy()
    middle = system.states.view(x, "cell1.position").mean(axis=0)
    for name in ("cell1.position", "cell1.nucleus.position"):
        if name in system.states:
            part = system.states.view(x, name)
            part[:] = middle + factor * (part - middle)
    return x, middle


@pytest.mark.parametrize("factor", [0.9, 1.2])
def test_a_scaled_nucleus_has_the_energy_on_paper(factor):
    """Edges and filaments stretch by f - 1, areas by f^2 - 1, the volume by f^3 - 1.

    Lengths are softened by 1e-6 um^2: 1e-4 of the energy.
    """
    system = tiny_system("nucleus", cells=1, matrix=False)
    (item,) = (e for e in system.elements if e.name == "cell1.nucleus")
    e, m, s = item.effect, item.mesh, factor - 1.0
    line = 0.5 * s**2 * (1.0 + 0.5 * e.stiffening * s**2)
    J = factor**2
    area = 0.5 * (J - 1.0) ** 2 if J >= 1.0 else 0.5 * (1.0 / J - 1.0) ** 2
    expected = (
        line * (e.line * (m.edge_length**2).sum() + e.filament * (item.link_length**2).sum())
        + e.area * area * m.triangle_area.sum()
        + 0.5 * e.modulus * m.volume * (factor**3 - 1.0) ** 2
    )
    x, _ = scaled(system, factor)
    assert system.energy(0.0, x)["cell1.nucleus"] == pytest.approx(expected, rel=1e-4)


def test_a_cortex_pulls_with_twice_its_tension_times_its_area():
    """sum F . r = -dE/d(ln f) = -2 gamma A (Young and Laplace); an offset fades at k/C_cort."""
    system = tiny_system("cortex", cells=1, matrix=False)
    (item,) = (e for e in system.elements if e.name == "cell1.cortex")
    x, middle = scaled(system, 1.1)
    place = system.states.view(x, "cell1.position")
    force = system.auxiliaries.view(system.efforts(0.0, x), "cell1.cortex")
    total = 1.1**2 * item.mesh.triangle_area.sum()
    assert (force * (place - middle)).sum() == pytest.approx(
        -2.0 * item.effect.tension * total, rel=1e-5
    )
    free = tiny_system("cortex", cells=1, matrix=False, cortex={"tension": "0 pN/um"})
    x = free.x0.copy()
    free.states.view(x, "cell1.cortex.offset")[:] = [0.03, -0.02, 0.01]
    method = LinearlyImplicit(step=0.05, corrections=9, tolerance=1e-6)
    result = simulate(free, method, np.array([0.0, 5.0]), x)
    # k/C = 0.1 1/s; first order: 0.25 % at a twentieth of a second.
    left = result.block("cell1.cortex.offset")[-1] / [0.03, -0.02, 0.01]
    assert np.abs(left / np.exp(-0.5) - 1.0).max() < 0.005
    moved = result.block("cell1.position")[-1] - result.block("cell1.position")[0]
    assert np.abs(moved).max() < 1e-12


def test_stress_fibres_of_a_sphere_pull_each_node_to_the_middle():
    """T R/sqrt(R^2 + soft^2) towards the middle where all bonds are closed; sum zero."""
    system = tiny_system("stress_fibres", cells=1, stress_fibres={"tension": "80 pN"})
    x = system.x0.copy()
    system.states.view(x, "cell1.bond_strength")[:] = 1.0
    place = system.states.view(x, "cell1.position")
    offset = place - place.mean(axis=0)
    force = system.auxiliaries.view(system.efforts(0.0, x), "cell1.stress_fibres")
    R = np.linalg.norm(offset, axis=1)
    inward = -(force * offset).sum(axis=1) / R
    # The anchor's reaction is shared among the nodes: the pulls of a sphere nearly cancel.
    assert np.abs(inward - 80.0 * R / np.sqrt(R**2 + 0.25)).max() < 80.0 * 0.02
    assert np.abs(force.sum(axis=0)).max() < 1e-10
