"""What each new effect is for: known solutions, statistics, and who feels what."""

import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.effects.noise import BOLTZMANN
from cellsys.effects.streams import stream
from cellsys.errors import ParameterError, SceneError
from cellsys.geometry.disc import StiffnessAssembly
from cellsys.geometry.membrane import sphere
from cellsys.integrate import DOP853, LinearlyImplicit, simulate
from cellsys.scene import Scene, build
from tests.effects.test_effect_forces import disturbed
from tests.mechanics.small_scenes import tiny, tiny_system

KT = BOLTZMANN * 310.0


def run(system, t, step=0.5, seed=1, x0=None):
    return simulate(system, LinearlyImplicit(step=step), np.asarray(t, float), x0, seed=seed)


def matrix_only(*names, **parameters):
    table = tiny(*names, cells=0, **parameters)
    table.pop("cells")
    return build(Scene.parse(table))


# Noise


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.5, 0.05])
def test_thermal_energy_is_shared_equally(step):
    """<k z^2> = k_B T/(1 + dt k/(2 C)): implicit Euler's own bias, 12 % at 0.5 s, 1.2 % at 0.05 s.

    79 free nodes, 400 (30 at the short step) samples 5 relaxation times apart: N values of chi
    squared, a standard error of sqrt(2/N) = 0.8 % (2.9 %); four of them.
    """
    system = matrix_only("foundation", "noise")
    t = np.arange(0.0, 4001.0, 10.0) if step == 0.5 else np.arange(0.0, 301.0, 10.0)
    u = run(system, t, step).block("matrix.displacement")[1:, ~system.matrix.clamped]
    energy = 500.0 * float((u[..., 2] ** 2).mean())
    expected = KT / (1.0 + step * 500.0 / 2000.0)
    assert energy == pytest.approx(expected, rel=4 * np.sqrt(2.0 / u[..., 2].size))
    # The plane has no spring: free diffusion, <x^2> = 2 k_B T t/C.
    spread = (u[..., :2] ** 2).mean(axis=(1, 2)) / (2.0 * KT * t[1:] / 1000.0)
    assert spread[-1] == pytest.approx(1.0, rel=4 * np.sqrt(2.0 / u[0, :, :2].size))


@pytest.mark.slow
def test_thermal_energy_of_a_network_is_half_kt_per_degree_of_freedom():
    """Linear fibres and foundation: <E> = (dof/2) k_B T, less the bias of stiff modes at 0.01 s."""
    system = matrix_only(
        "matrix_elasticity", "foundation", "noise", matrix_elasticity={"law": "linear"},
        foundation={"spring": "50 pN/um"},
    )  # fmt: skip
    dof = 3 * int((~system.matrix.clamped).sum())
    # The fibres of a disc of 90 nodes relax at 80 1/s or less, which asks for short steps.
    result = simulate(system, LinearlyImplicit(step=0.002, refresh=10**6), np.arange(0, 12.1, 0.1))
    energy = [
        sum(system.energy(0.0, x.copy()).values()) for x in result.x[40:]
    ]  # fmt: skip
    assert np.mean(energy) == pytest.approx(0.5 * dof * KT, rel=0.15)


def test_noise_is_none_at_zero_kelvin_and_on_held_nodes():
    system = matrix_only("foundation", "noise", external_strain={}, noise={"temperature": "300 K"})
    result = run(system, [0, 5, 10])
    force = result.block("matrix.thermal_force")
    assert force[1:, ~system.matrix.clamped].std() == pytest.approx(
        np.sqrt(2 * BOLTZMANN * 300 * 1000 / 0.5), rel=0.2
    )
    assert not force[:, system.matrix.clamped].any()
    assert not run(matrix_only("noise", noise={"temperature": "0 K"}), [0, 5]).x.any()


def test_noise_asks_for_a_method_with_steps():
    with pytest.raises(ParameterError, match="use LinearlyImplicit or ExplicitEuler"):
        simulate(matrix_only("noise"), DOP853(rtol=1e-6, atol=1e-6), np.array([0.0, 1.0]))


def test_streams_belong_to_their_label_and_step():
    run_ = np.random.default_rng(np.random.SeedSequence(3))
    first = stream(run_, "cell1", 1.0, 0.5).random(4)
    run_.random(100)  # what others drew does not matter
    assert np.array_equal(stream(run_, "cell1", 1.0, 0.5).random(4), first)
    for label, t, dt in (("cell2", 1.0, 0.5), ("cell1", 1.5, 0.5), ("cell1", 1.0, 0.25)):
        assert not np.array_equal(stream(run_, label, t, dt).random(4), first)
    other = np.random.default_rng(np.random.SeedSequence(4))
    assert not np.array_equal(stream(other, "cell1", 1.0, 0.5).random(4), first)


# Stochastic adhesion


def test_bond_numbers_follow_the_binomial_kinetics():
    """Unloaded bonds: n -> Binomial(n_max, p), p = gain/(gain + loss) of one step, var n p (1-p).

    a = 1 - exp(-k_on dt), b = 1 - exp(-k_off dt): a bond is closed with p = a/(a + b).
    """
    system = tiny_system(
        "stochastic_adhesion", cells=1,
        stochastic_adhesion={
            "bind_rate": "50 1/s", "bind_distance": "3 um", "gain_rate": "0.5 1/s",
            "loss_rate": "0.5 1/s", "contraction_speed": "0 um/s",
        },
        matrix_elasticity={},
    )  # fmt: skip
    a = b = -np.expm1(-0.25)
    result = run(system, np.arange(0.0, 401.0, 10.0))
    number = result.block("cell1.bond_number")[2:]
    bound = result.block("cell1.bond_partner")[2:] >= 0
    values = number[bound]
    assert len(values) > 200
    assert np.array_equal(values, np.round(values))
    assert values.max() <= 50
    mean, variance = 50 * a / (a + b), 50 * a * b / (a + b) ** 2
    # Samples 10 s apart are 20 relaxation times apart: independent.
    assert values.mean() == pytest.approx(mean, abs=4 * np.sqrt(variance / len(values)))
    assert values.var() == pytest.approx(variance, rel=4 * np.sqrt(2 / len(values)))


def test_a_further_cell_changes_no_draw_of_the_first():
    one = tiny_system("stochastic_adhesion", cells=1)
    two = tiny_system("stochastic_adhesion", cells=2)
    t = [0.0, 2.0]
    first, both = run(one, t, seed=9), run(two, t, seed=9)
    number = "cell1.bond_number"
    assert (first.block(number)[-1] > 0).any()
    assert np.array_equal(first.block(number)[-1], both.block(number)[-1])
    assert not np.array_equal(first.block(number)[-1], run(one, t, seed=10).block(number)[-1])


def test_bonds_come_whole():
    with pytest.raises(SceneError, match="whole number"):
        tiny_system("stochastic_adhesion", stochastic_adhesion={"bonds": 2.5})


# External strain


def test_a_strained_rim_is_where_it_should_be_and_the_log_explains_it():
    history = {"times": ["0 s", "10 s", "15 s"], "values": [0, 1, 0.5]}
    strain = {"strain": 0.04, "direction": "90 deg", "history": history}
    system = matrix_only("matrix_elasticity", "external_strain", external_strain=strain)
    result = run(system, np.arange(0.0, 21.0, 5.0))
    u, rim = result.block("matrix.displacement"), system.matrix.clamped
    y = system.matrix.position[rim, 1]
    for k, factor in enumerate((0.0, 0.5, 1.0, 0.5, 0.5)):
        assert np.abs(u[k, rim] - factor * 0.04 * np.outer(y, [0, 1, 0])).max() < 1e-15
    # Held nodes: no force in the rows of W_eta, the mean velocity in u, nothing left over.
    rows = np.repeat(rim, 3)
    assert not np.abs(result.W_eta[rows, : system.auxiliaries.size]).sum()
    residual = result.auxiliary("step_residual")[:, rows]
    assert np.abs(residual).max() < 1e-14


def test_a_linear_network_follows_its_rim():
    """As far as K u = 0 inside says (11 rim nodes hold this coarse disc: less than affine)."""
    strain = {"strain": 0.04, "history": {"times": ["0 s"], "values": [1]}}
    system = matrix_only(
        "matrix_elasticity", "external_strain", matrix_elasticity={"law": "linear"},
        external_strain=strain,
    )  # fmt: skip
    u = run(system, [0.0, 1000.0], step=2.0).block("matrix.displacement")[-1]
    inside = ~system.matrix.clamped
    d = system.matrix
    K = StiffnessAssembly(len(d.position), d.fibres)(
        d.position, d.stiffness, np.full(len(d.fibres), 1e-6)
    ).toarray()
    free, held = np.repeat(inside, 3), np.repeat(d.clamped, 3)
    flat = system.x0.copy()
    flat[free] = sla.solve(K[np.ix_(free, free)], -K[np.ix_(free, held)] @ flat[held])
    found = (u, flat.reshape(-1, 3))
    slopes = [np.polyfit(d.position[inside, 0], v[inside, 0], 1)[0] for v in found]
    assert 0.01 < slopes[1] < 0.04
    assert slopes[0] == pytest.approx(slopes[1], rel=0.1)  # 4 % strain turns the fibres


def test_a_patch_may_be_moved_and_starts_where_its_history_does():
    history = {"times": ["0 s", "10 s"], "values": [1, 2]}
    patch = {"region": "patch", "strain": 0, "displacement": "0.2 um", "radius": "4 um",
             "history": history}  # fmt: skip
    system = matrix_only("matrix_elasticity", "external_strain", external_strain=patch)
    held = np.hypot(*system.matrix.position[:, :2].T) <= 4.0
    u = run(system, [0, 5, 10]).block("matrix.displacement")
    assert np.abs(u[:, held, 0] - np.array([[0.2], [0.3], [0.4]])).max() < 1e-15
    assert np.abs(u[-1, ~held & ~system.matrix.clamped]).max() > 0.05
    whole = {"region": "patch", "strain": 0.01, "radius": "20 um", "history": history}
    system = matrix_only("matrix_elasticity", "external_strain", external_strain=whole)
    u = run(system, [0, 5]).block("matrix.displacement")[-1]  # no node is left to solve for
    inside = np.hypot(*system.matrix.position[:, :2].T) <= 20.0
    assert inside.all()
    assert np.abs(u[:, 0] - 0.015 * system.matrix.position[:, 0]).max() < 1e-15
    with pytest.raises(SceneError, match="covers no matrix node"):
        matrix_only("external_strain", external_strain={"region": "patch", "x": "30 um"})


# Creep


@pytest.mark.parametrize(("branch", "end"), [("maxwell", 1.0), ("kelvin", 1.0 / 1.5)])
def test_stress_relaxes_like_the_standard_linear_solid(branch, end):
    """A strained linear network keeps its shape while every fibre relaxes alike.

    maxwell: f/f0 = (1 + q exp(-t/tau))/1 over the elastic force; kelvin: 1/(1 + q) at the end,
    with the rate (1 + q)/tau. The force is read on the rim, held at 2 %.
    """
    tau, q = 20.0, 0.5
    system = matrix_only(
        "matrix_elasticity", "matrix_creep", "external_strain",
        matrix_elasticity={"law": "linear"},
        matrix_creep={"branch": branch, "ratio": q, "time": f"{tau} s"},
        external_strain={"strain": 0.02, "history": {"times": ["0 s"], "values": [1]}},
    )  # fmt: skip
    # Start in the relaxed elastic shape: proportional loading of one material keeps it.
    elastic = matrix_only(
        "matrix_elasticity", "external_strain", matrix_elasticity={"law": "linear"},
        external_strain={"strain": 0.02, "history": {"times": ["0 s"], "values": [1]}},
    )  # fmt: skip
    shape = run(elastic, [0.0, 2000.0], step=5.0).x[-1]
    x0 = system.x0.copy()
    x0[: shape.size] = shape
    result = run(system, np.arange(0.0, 61.0, 10.0), step=0.25, x0=x0)
    force = []
    for k, t in enumerate(result.t):
        eta = system.efforts(t, result.x[k].copy())
        total = sum(
            system.auxiliaries.view(eta, f"matrix.{n}")[:, 0] for n in
            ("matrix_elasticity", "matrix_creep")
        )  # fmt: skip
        side = system.matrix.clamped & (system.matrix.position[:, 0] > 0)
        force.append(float(total[side].sum()))
    ratio = np.array(force) / force[-1] if branch == "maxwell" else np.array(force) / force[0]
    if branch == "maxwell":
        past = np.exp(-result.t / tau)
        expected = (1.0 + q * past) / (1.0 + q * past[-1])
    else:
        expected = end + (1.0 - end) * np.exp(-result.t * (1.0 + q) / tau)
    # Geometry at 2 % strain and the first-order step.
    assert np.abs(ratio - expected).max() < 0.02


# Cortex, nucleus, stress fibres


def test_a_stiff_link_makes_the_cortex_one_with_the_membrane():
    """link -> infinity: C_c v = F + F_T, a membrane without cortical drag that has the tension."""
    parts = ("membrane_elasticity", "volume")
    sphere = {"volume": {"pressure": "zero", "modulus": "300 Pa"}}  # that gives in to its tension
    cortex = tiny_system(
        *parts, "cortex", cells=1, matrix=False, **sphere, cortex={"link": "1e6 pN/um"}
    )
    merged = tiny_system(
        *parts, "cortical_tension", cells=1, matrix=False, **sphere, drag={"cortex": "0 pN s/um"}
    )
    t = [0.0, 20.0]
    a = run(cortex, t, 0.1).block("cell1.position")[-1]
    b = run(merged, t, 0.1).block("cell1.position")[-1]
    moved = np.abs(b - merged.x0.reshape(-1, 3)[: len(b)]).max()
    assert moved > 0.05
    assert np.abs(a - b).max() < 0.02 * moved
    loose = tiny_system(
        *parts, "cortex", cells=1, matrix=False, **sphere, cortex={"link": "1 pN/um"}
    )
    c = run(loose, t, 0.1).block("cell1.position")[-1]
    assert np.abs(c - b).max() > 5 * np.abs(a - b).max()


def test_a_nucleus_stays_inside_and_follows_its_cell():
    system = tiny_system("membrane_elasticity", "volume", "nucleus", "lamellipodium", cells=1)
    result = run(system, [0.0, 60.0])
    cell, inner = result.block("cell1.position"), result.block("cell1.nucleus.position")
    shift = cell[-1].mean(axis=0) - cell[0].mean(axis=0)
    assert np.linalg.norm(shift) > 0.5
    lag = inner[-1].mean(axis=0) - inner[0].mean(axis=0) - shift
    assert np.linalg.norm(lag) < 0.5 * np.linalg.norm(shift)
    with pytest.raises(SceneError, match=r"does not fit into cell1"):
        tiny_system("nucleus", nucleus={"radius": "3.9 um"})


def test_stress_fibres_pull_the_matrix_inwards():
    rest = ("membrane_elasticity", "volume", "focal_adhesion", "substrate_contact")
    pulled = []
    for names in (rest, (*rest, "stress_fibres")):
        system = tiny_system(*names, cells=1, stress_fibres={"tension": "200 pN"})
        u = run(system, [0.0, 60.0]).block("matrix.displacement")[-1]
        offset = system.matrix.position - system.x0[: 3 * 189].reshape(-1, 3).mean(axis=0)
        near = np.hypot(*offset[:, :2].T)
        pulled.append(float(-(u[:, :2] * offset[:, :2]).sum() / near.sum()))
    assert pulled[1] > 1.2 * pulled[0] > 0


# Contact


def enclosed(points, surface, triangles):
    """Which points lie inside a closed surface: its solid angle there is 4 pi."""
    a, b, c = (surface[triangles[:, i]][None] - points[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    volume = np.einsum("ijk,ijk->ij", a, np.cross(b, c))
    rest = la * lb * lc + (a * b).sum(2) * lc + (b * c).sum(2) * la + (c * a).sum(2) * lb
    return 2.0 * np.arctan2(volume, rest).sum(axis=1) > 2.0 * np.pi


def test_cells_pushed_together_do_not_pass_through_each_other():
    parts = ("membrane_elasticity", "volume", "lamellipodium")
    table = tiny(*parts, "cell_contact", matrix=False)
    table["cells"][0]["polarity"], table["cells"][1]["polarity"] = "0 deg", "180 deg"
    table["effects"]["lamellipodium"] = {"force": "100 pN", "height": "20 um"}
    inside = {}
    for contact in (True, False):
        if not contact:
            table["effects"].pop("cell_contact")
        result = run(build(Scene.parse(table)), [0.0, 120.0])
        a, b = (result.block(f"cell{k}.position")[-1] for k in (1, 2))
        inside[contact] = enclosed(a, b, sphere(4.0, (0, 0, 0)).triangles).sum()
    assert inside[False] > 10, "the naive version: without contact they end inside each other"
    assert inside[True] == 0


def test_far_cells_are_not_looked_at(monkeypatch):
    from cellsys.effects import cell_contact

    table = tiny("membrane_elasticity", "cell_contact", matrix=False)
    table["cells"][1]["position"] = ["40 um", "0 um"]
    monkeypatch.setattr(cell_contact, "surface_contact", None)  # a call would be an error
    system = build(Scene.parse(table))
    run(system, [0.0, 5.0])
    assert not tiny_system("cell_contact", cells=1).auxiliaries.size  # one cell: nothing to build


# Degradation and bending


def test_fibres_soften_near_the_cell_only_and_the_sensor_knows():
    system = tiny_system(
        "matrix_degradation", "stiffness_sensing", cells=1,
        matrix_degradation={"rate": "0.1 1/s", "least": 0.2},
    )  # fmt: skip
    result = run(system, [0.0, 20.0, 60.0])
    intact = result.block("matrix.intact")
    assert np.all(np.diff(intact, axis=0) <= 0)
    d = system.matrix
    middle = 0.5 * (d.position[d.fibres[:, 0]] + d.position[d.fibres[:, 1]])
    cell = result.block("cell1.position")[0]
    far = np.linalg.norm(middle[:, None] - cell[None], axis=2).min(axis=1)
    assert intact[-1][far < 1.5].max() < 0.3
    assert intact[-1].min() >= 0.2
    assert intact[-1][far > 6.5].min() == 1.0
    # The sensed direction points away from what was lost.
    for side in (1.0, -1.0):
        x = result.x[-1].copy()
        lost = side * (middle[:, 1] - 0.3) > 0
        system.states.view(x, "matrix.intact")[:] = np.where(lost, 0.2, 1.0)
        assert side * system.observe(0.0, x)["d"][0, 1] < -0.4


def test_bending_stiffens_a_network_against_shear_out_of_its_fibres():
    """Stiffness against a random smooth displacement: with bending above without, by its energy."""
    system = matrix_only("fibre_bending", fibre_bending={"rigidity": "2000 pN um^2"})
    x = disturbed(system, 3, 1.0)
    energy = system.energy(0.0, x)
    assert energy["matrix.fibre_bending"] > 0.0
    assert system.energy(0.0, system.x0.copy())["matrix.fibre_bending"] < 1e-20
    soft = matrix_only("matrix_elasticity")
    ends = [
        sum(e.energy(0.0, run(e, [0.0, 50.0], x0=x).x[-1].copy()).values()) for e in (system, soft)
    ]
    assert ends[0] < energy["matrix.fibre_bending"] + energy["matrix.matrix_elasticity"]
