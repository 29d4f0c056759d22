"""Tractions against sums written here, on forces whose answer is known."""

import numpy as np
import pytest

from cellsys.errors import DataError, ParameterError
from cellsys.integrate import LinearlyImplicit, simulate
from cellsys.observe import Tractions, contact_area, read_outs, tractions, volume_course
from tests.mechanics.scenes import small


def of(force, place, displacement=None, centre=(0.0, 0.0, 0.0), polarity=(0.0, 1.0, 0.0)):
    force, place = np.asarray(force, float), np.asarray(place, float)
    displacement = np.zeros_like(place) if displacement is None else np.asarray(displacement, float)
    return Tractions(
        force=force, place=place, displacement=displacement, centre=np.asarray(centre, float),
        polarity=None if polarity is None else np.asarray(polarity, float), drag=np.zeros(3),
    )  # fmt: skip


def test_a_contractile_pair():
    """Two nodes 10 um apart pulled together by 100 pN, as a dipole of the textbook."""
    found = of([[0, -100, 0], [0, 100, 0]], [[0, 5, 0], [0, -5, 0]],
               [[0, -0.1, 0], [0, 0.1, 0]])  # fmt: skip
    assert found.sum_pN == 200.0
    assert found.net_share == 0.0
    assert np.array_equal(found.dipole_pN_um, [[0, 0], [0, -1000]])
    assert found.front_rear_pN == (-100.0, 100.0)
    assert found.torque_share == 0.0
    # 1/2 sum t.u = 10 pN um = 0.01 fJ
    assert found.strain_energy_fJ == pytest.approx(0.01)


def test_a_couple_and_a_net_force():
    turning = of([[0, 50, 0], [0, -50, 0]], [[2, 0, 0], [-2, 0, 0]])
    assert turning.torque_share == 1.0
    assert turning.torque_imbalance_share == 1.0
    pulling = of([[30, 40, 7]], [[1, 0, 0]])
    assert pulling.net_share == 1.0
    assert pulling.imbalance_share == 1.0
    with pytest.raises(DataError, match="polarity"):
        _ = of([[1, 0, 0]], [[1, 0, 0]], polarity=None).front_rear_pN


def test_the_map_keeps_the_force():
    """Its integral is the sum of nodal forces; the peak under one node is 4 F/(pi h^2)."""
    rng = np.random.default_rng(0)
    place = np.column_stack([rng.uniform(-8, 8, (30, 2)), np.zeros(30)])
    found = of(rng.standard_normal((30, 3)) * 100, place)
    stress = found.map(spacing=0.1)
    # The kernel has two derivatives at its edge: a sum over 0.1 um is exact to 1e-5.
    assert np.allclose(stress.stress.sum(axis=(0, 1)) * 0.01, found.force[:, :2].sum(axis=0),
                       atol=1e-2)  # fmt: skip
    alone = of([[100.0, 0, 0]], [[0.0, 0, 0]])
    peak = alone.map(spacing=0.5, smoothing=3.0, margin=10.0).peak_Pa
    assert peak == pytest.approx(4 * 100 / (np.pi * 9), rel=0.02)
    for bad in ({"spacing": 0.0}, {"smoothing": -1.0}, {"margin": float("nan")}):
        with pytest.raises(ParameterError, match=next(iter(bad))):
            alone.map(**bad)


def test_contact_area_is_that_of_the_low_nodes():
    square = np.array([[0, 0, 0.2], [2, 0, 0.2], [2, 3, 0.2], [0, 3, 0.2], [1, 1, 0.1], [9, 9, 4]])
    assert contact_area(square) == pytest.approx(6.0)
    assert contact_area(square[:2]) == 0.0
    assert contact_area(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]])) == 0.0


def test_tractions_of_a_run_are_all_that_the_cell_does_to_its_matrix():
    system = small(lamellipodium={"reaction": "clutch"}, substrate_contact={"support": "matrix"})
    run = simulate(system, LinearlyImplicit(step=0.5), np.arange(0.0, 21.0, 5.0))
    found = tractions(run, k=2)
    ports = ("matrix.focal_adhesion.cell1", "matrix.lamellipodium.cell1",
             "matrix.substrate_contact.cell1")  # fmt: skip
    assert np.allclose(found.force, sum(run.auxiliary(p)[1] for p in ports), rtol=1e-12)
    end = tractions(run)
    # Means over an interval: what the places do inside it is left out.
    assert end.torque_imbalance_share < 0.01
    assert end.torque_share > 5.0 * end.torque_imbalance_share
    told = read_outs(run)
    assert told["traction_sum_pN"] == pytest.approx(tractions(run).sum_pN)
    volume = volume_course(run)
    assert told["volume_least_percent"] == pytest.approx(100 * volume.min() / volume[0])
    assert 0.0 <= told["cue_strength"] < 1.0
    for k in (0, 5, -9):
        with pytest.raises(ParameterError, match="k must be"):
            tractions(run, k=k)
    bare = simulate(system, LinearlyImplicit(step=0.5), np.array([0.0, 5.0]), auxiliaries=False)
    with pytest.raises(DataError, match="auxiliaries"):
        tractions(bare)
    assert "traction_sum_pN" not in read_outs(bare)
