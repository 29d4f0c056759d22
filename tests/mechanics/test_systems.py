"""Whole systems beside the shipped one: a free membrane, a passive disc, two cells, far corners."""

import numpy as np
import pytest

from cellsys.errors import IntegrationError, SceneError
from cellsys.integrate import LinearlyImplicit, simulate
from cellsys.laws.sensing import measure_moment
from cellsys.scene import Scene, build
from tests.mechanics.scenes import small, table

T = np.arange(0.0, 21.0, 5.0)


def test_a_free_membrane_keeps_its_centroid():
    """Internal forces and a translation-invariant majorant: the centroid stays to rounding."""
    keep = ("drag", "membrane_elasticity", "volume", "cortical_tension")
    spec = table()
    spec.pop("matrix")
    spec["effects"] = {k: spec["effects"][k] for k in keep}
    system = build(Scene.parse(spec))
    assert [b.name for b in system.states] == ["cell1.position"]
    x0 = system.x0.copy()
    cell = system.states.view(x0, "cell1.position")
    cell += 0.2 * np.random.default_rng(0).standard_normal(cell.shape)
    run = simulate(system, LinearlyImplicit(step=0.5), np.arange(0.0, 201.0, 10.0), x0=x0)
    x = run.block("cell1.position")
    assert np.abs(x.mean(axis=1) - x[0].mean(axis=0)).max() < 1e-12
    energy = [sum(system.energy(0.0, row.copy()).values()) for row in run.x]
    assert np.all(np.diff(energy) <= 1e-9 * energy[0])  # passive: energy only falls


def test_a_passive_disc_at_rest_stays_at_rest():
    spec = table()
    spec.pop("cells")
    keep = ("drag", "matrix_elasticity", "foundation")
    spec["effects"] = {k: spec["effects"][k] for k in keep}
    system = build(Scene.parse(spec))
    run = simulate(system, LinearlyImplicit(step=0.5), T)
    # Lengths are softened by 1e-12 um^2, so rest is met to 1e-12/(2 l) um.
    assert np.abs(run.x).max() < 1e-10
    u = 0.1 * np.random.default_rng(1).standard_normal(system.x0.shape)
    u[np.repeat(system.matrix.clamped, 3)] = 0.0
    run = simulate(system, LinearlyImplicit(step=0.5), T, x0=u)
    energy = [sum(system.energy(0.0, row.copy()).values()) for row in run.x]
    assert np.all(np.diff(energy) < 0)
    assert not run.x[:, np.repeat(system.matrix.clamped, 3)].any()


def test_two_cells_act_on_one_matrix():
    """Both cells act on one matrix: its force is the sum, and each has its own blocks."""
    spec = table()
    spec["matrix"].update(diameter="60 um", nodes=700)
    spec["cells"] = [
        {"position": ["-11 um", "0 um"], "polarity": "0 deg"},
        {"position": ["11 um", "0 um"], "polarity": "180 deg"},
    ]
    system = build(Scene.parse(spec))
    run = simulate(system, LinearlyImplicit(step=0.5), T)
    assert run.p.shape == (5, 2, 3)
    assert run.d.shape == (5, 2, 3)
    names = [b.name for b in run.auxiliaries]
    for k in (1, 2):
        assert f"cell{k}.focal_adhesion" in names
        assert f"matrix.focal_adhesion.cell{k}" in names
        given = run.auxiliary(f"cell{k}.focal_adhesion").sum(axis=1)
        taken = run.auxiliary(f"matrix.focal_adhesion.cell{k}").sum(axis=1)
        assert np.abs(given + taken).max() < 1e-12 * np.abs(given).max() + 1e-10
    alone = table()
    alone["matrix"].update(diameter="60 um", nodes=700)
    alone["cells"] = spec["cells"][:1]
    single = simulate(build(Scene.parse(alone)), LinearlyImplicit(step=0.5), T)
    apart = run.block("cell1.position")[-1] - single.block("cell1.position")[-1]
    assert 0 < np.abs(apart).max() < 0.05  # um: the neighbour acts through the matrix only


@pytest.mark.parametrize("measure", ["stiffness", "stress"])
def test_both_sensors_give_unit_directions(measure):
    system = small(stiffness_sensing={"measure": measure, "reach": "12 um", "unit": True})
    run = simulate(system, LinearlyImplicit(step=0.5), T)
    assert np.abs(np.linalg.norm(run.d[:, 0], axis=1) - 1.0).max() < 1e-14
    assert not run.d[:, 0, 2].any()


@pytest.mark.parametrize("measure", ["stiffness", "stress"])
def test_both_graded_cues_are_shorter_than_one(measure):
    system = small(stiffness_sensing={"measure": measure, "reach": "12 um"})
    run = simulate(system, LinearlyImplicit(step=0.5), T)
    size = np.linalg.norm(run.d[:, 0], axis=1)
    assert np.all((size > 0.0) & (size < 1.0))
    assert not run.d[:, 0, 2].any()


def test_nodal_stress_and_stiffness_are_stored_where_a_cell_senses():
    """Against a loop over fibres; the direction stored beside them is that of the measure."""
    system = small(stiffness_sensing={"measure": "stress", "inner": "2 um", "unit": True})
    run = simulate(system, LinearlyImplicit(step=0.5), T)
    disc, n = system.matrix, len(system.matrix.position)
    assert run.virial.shape == run.stiffness.shape == (len(T), n)
    fibres = next(e for e in system.elements if e.name == "matrix.matrix_elasticity")
    slope, tension = fibres.slopes(system.configuration(T[-1], run.x[-1].copy()))
    virial, stiff = np.zeros(n), np.zeros(n)
    for (i, j), t, length, g, k in zip(
        disc.fibres, tension, disc.length, slope, disc.stiffness, strict=True
    ):
        for node in (i, j):
            virial[node] += max(t, 0.0) * length
            stiff[node] += g * k
    assert virial.max() > 1.0
    np.testing.assert_allclose(run.virial[-1], virial, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(run.stiffness[-1], stiff, rtol=1e-12)
    place = run.block("cell1.position")[-1].mean(axis=0)
    at = disc.position + run.block("matrix.displacement")[-1]
    sensing = system.cells[0].effects["stiffness_sensing"]
    q, total = measure_moment(at, virial, place, sensing.inner, sensing.reach)
    assert np.hypot(*q) > sensing.threshold * total
    np.testing.assert_allclose(run.d[-1, 0, :2], q / np.hypot(*q), atol=1e-12)


def test_nothing_is_stored_that_no_cell_reads():
    spec = table()
    for name in ("stiffness_sensing", "polarity"):
        spec["effects"].pop(name, None)
    run = simulate(build(Scene.parse(spec)), LinearlyImplicit(step=0.5), T[:2])
    assert run.virial is None
    assert run.stiffness is None


@pytest.mark.parametrize("law", ["linear", "buckling", "stiffening"])
def test_every_fibre_law_runs_and_logs_consistently(law):
    run = simulate(small(matrix_elasticity={"law": law}), LinearlyImplicit(step=0.5), T)
    rate = np.diff(run.x, axis=0) / 5.0
    assert np.abs(rate - run.eta @ run.W_eta.T - run.u).max() < 1e-13


def test_a_cell_out_of_reach_of_the_matrix_only_relaxes():
    """No node within the height of binding, no contact: nothing pulls, nothing is NaN."""
    system = small(lamellipodium=None, stiffness_sensing=None, polarity=None)
    x0 = system.x0.copy()
    system.states.view(x0, "cell1.position")[:, 2] += 20.0
    run = simulate(system, LinearlyImplicit(step=0.5), T, x0=x0)
    center = run.block("cell1.position").mean(axis=1)
    assert np.abs(center - center[0]).max() < 1e-9
    assert np.abs(run.block("matrix.displacement")).max() < 1e-9


def test_polarity_normal_to_the_substrate_means_no_leading_edge():
    system = small()
    x0 = system.x0.copy()
    system.states.view(x0, "cell1.polarity")[:] = [0.0, 0.0, 1.0]
    assert not system.u(0.0, x0).any()


def test_a_turned_out_cell_fails_with_a_typed_error():
    """A membrane thrown over itself is no start: a typed failure, or a run that stays finite."""
    system = small()
    x0 = system.x0.copy()
    cell = system.states.view(x0, "cell1.position")
    cell += 4.0 * np.random.default_rng(0).standard_normal(cell.shape)
    try:
        run = simulate(system, LinearlyImplicit(step=0.5), T, x0=x0)
    except IntegrationError:
        return
    assert np.all(np.isfinite(run.x))


def test_a_load_on_the_clamped_rim_is_refused():
    spec = table(external_load={"x": "16.9 um", "radius": "0.3 um"})
    with pytest.raises(SceneError, match="covers no free matrix node"):
        build(Scene.parse(spec))
