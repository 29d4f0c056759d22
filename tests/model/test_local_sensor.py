"""The sensor that reads the network: recovery, choice of inputs, slope, files."""

import numpy as np
import pytest

import cellsys as cs
from cellsys.laws.sensing import graded
from cellsys.model.network_sensor import (
    LocalSensor,
    StiffnessMap,
    fit_local_sensor,
    nodal_moments,
    sensor_from,
)

RNG = np.random.default_rng(4)


def network():
    """A patch four times as stiff at (12, 5) um."""
    nodes = RNG.uniform(-30, 30, (3000, 2))
    nodes = nodes[np.hypot(*nodes.T) < 30]
    stiff = 1.0 + 3.0 * (np.hypot(*(nodes - (12.0, 5.0)).T) < 5.0)
    return StiffnessMap(nodes, stiff)


def runs(known, n=6, T=40, m=6, seed=0):
    """Latent states with a place in the last two; the direction is the network's."""
    rng = np.random.default_rng(seed)
    z, d = [], []
    for _ in range(n):
        path = rng.uniform(-6, 6, 2) + np.cumsum(0.2 * rng.standard_normal((T, 2)), axis=0)
        z.append(np.hstack([rng.standard_normal((T, m)), path]))
        d.append(np.hstack([known.at(path), np.zeros((T, 1))]))
    return z, d


def test_it_points_at_the_stiff_patch():
    known = network()
    for place in ((0.0, 0.0), (5.0, -4.0), (3.0, 12.0)):
        wanted = np.array([12.0, 5.0]) - place
        assert known.at(np.array(place)) @ wanted / np.linalg.norm(wanted) > 0.95


def test_network_inputs_win_where_they_are_the_truth():
    """Held out less than half of the best constant direction's error; linear in z is not."""
    known = network()
    train, test = runs(known), runs(known, n=3, seed=9)
    sensor = fit_local_sensor(*train, known, *test)
    assert "local stiffness" in sensor.inputs
    assert sensor.held_out_error < 0.5 * sensor.constant_error
    plain = cs.fit_sensor(*train, *test)
    assert sensor.held_out_error < 0.5 * plain.held_out_error


def test_latent_inputs_win_where_they_are_the_truth():
    known = network()
    z, _ = runs(known)
    K = RNG.standard_normal((3, 6))
    d = [part[:, :6] @ K.T for part in z]
    d = [v / np.linalg.norm(v, axis=1, keepdims=True) for v in d]
    assert fit_local_sensor(z, d, known).inputs.startswith("latent state")


def moments_of(z, seed=5):
    """Moments of stress that are linear in z, and the directions that follow them."""
    rng = np.random.default_rng(seed)
    M = rng.standard_normal((2, z[0].shape[1]))
    q = [part @ M.T for part in z]
    flat = [v / np.linalg.norm(v, axis=1, keepdims=True) for v in q]
    return q, [np.hstack([v, np.zeros((len(v), 1))]) for v in flat]


def test_stress_wins_where_it_is_the_truth():
    """d follows the direction of stress: not linear in z, but its moment is."""
    known = network()
    z, _ = runs(known)
    q, d = moments_of(z)
    sensor = fit_local_sensor(z, d, known, moments={"virial": q})
    assert sensor.inputs.startswith("stress")
    assert sensor.training_error < 1.0
    assert sensor.tried["latent state"] > 10 * sensor.tried[sensor.inputs]
    without = fit_local_sensor(z, d, known)
    assert not any("stress" in name for name in without.tried)
    with pytest.raises(cs.DimensionError, match="moments"):
        fit_local_sensor(z, d, known, moments={"virial": q[:-1]})


def test_squares_are_used_only_where_they_win():
    known = network()
    z, _ = runs(known)
    x = [part[:, -2:] for part in z]
    raw = [np.column_stack([1 + 0.2 * p[:, 0] ** 2, 0.3 * p[:, 0] * p[:, 1] - 1, 0 * p[:, 0]])
           for p in x]  # fmt: skip
    sensor = fit_local_sensor(z, raw, known)
    assert "squares" in sensor.inputs
    assert sensor.training_error < 0.01  # the smallest penalty, 1e-4, bends it by that much
    straight = [np.column_stack([1 + 0.1 * p[:, 0], 0.1 * p[:, 1] - 1, 0 * p[:, 0]]) for p in x]
    assert "squares" not in fit_local_sensor(z, straight, known).inputs


def test_a_vector_is_read_from_states_that_turn_like_one():
    """The strained stiffness is the network's plus a charge-1 read-out; noise states mislead the
    plain regression, not the one that may only use that charge."""
    known = network()
    z, _ = runs(known, n=5, T=30, m=20)
    charge = (np.arange(0, 3), np.arange(3, 6))
    size = np.linalg.norm(np.concatenate([known.moment(v[:, -2:]) for v in z]), axis=1).mean()
    c = size * np.array([0.4, -0.2, 0.1])
    q = [0.6 * known.moment(v[:, -2:]) + np.column_stack([v[:, :3] @ c, v[:, 3:6] @ c]) for v in z]
    d = [np.column_stack([v / np.linalg.norm(v, axis=1, keepdims=True), 0 * v[:, 0]]) for v in q]
    sensor = fit_local_sensor(z, d, known, moments={"stiffness": q}, charge=charge)
    assert sensor.inputs == "stiffness under strain"
    assert sensor.training_error < 0.1
    np.testing.assert_allclose(sensor.a, 0.6, rtol=1e-3)
    np.testing.assert_allclose(sensor.M[0, 1:4], c, rtol=1e-3)
    np.testing.assert_allclose(sensor.M[1, 4:7], c, rtol=1e-3)
    noisy = [v + 0.5 * size * RNG.standard_normal(v.shape) for v in q]
    plain = fit_local_sensor(z, d, known, moments={"stiffness": noisy})
    vector = fit_local_sensor(z, d, known, moments={"stiffness": noisy}, charge=charge)
    name = "stiffness under strain"
    assert vector.tried[name] < 0.7 * plain.tried[name]
    # Without the charge too, what is left once the network's own part is taken off is learned.
    known_part = fit_local_sensor(z, d, known, moments={"stiffness": q})
    np.testing.assert_allclose(known_part.a, 0.6, rtol=0.05)
    np.testing.assert_allclose(known_part.M[0, 1:4], c, atol=0.05 * np.abs(c).max())
    others = np.delete(known_part.M[0], slice(1, 4))
    assert np.abs(others).max() < 0.1 * np.abs(c).max()


def test_moments_of_hand_made_measures():
    """All at one node on the x axis: the moment points there, with that size."""
    rest = np.array([[8.0, 0.0, 0.0], [0.0, 8.0, 0.0], [0.0, 1.0, 0.0], [40.0, 0.0, 0.0]])
    values = np.array([[3.0, 0.0, 5.0, 7.0]])  # the last two: under the cell, out of reach
    nodal = {"virial": values, "stiffness": values}
    q = nodal_moments(rest, np.zeros((1, 4, 3)), nodal, np.zeros((1, 2)))
    np.testing.assert_allclose(q["virial"], [[3.0, 0.0]], atol=1e-6)
    np.testing.assert_allclose(q["stiffness"], [[3.0, 5.0]], atol=1e-6)


@pytest.mark.parametrize("truth", ["network", "stress", "strain", "squares"])
def test_frozen_sensor_has_value_and_slope(truth):
    known = network()
    z, d = runs(known)
    q, along = moments_of(z)
    moments = {"virial": q}
    if truth == "stress":
        d = along
    elif truth == "strain":
        q = [known.moment(p[:, -2:]) + 1e2 * part for p, part in zip(z, q, strict=True)]
        moments = {"stiffness": q}
        d = [np.column_stack([v / np.linalg.norm(v, axis=1, keepdims=True), 0 * v[:, 0]])
             for v in q]  # fmt: skip
    elif truth == "squares":
        d = [np.column_stack([1 + p[:, -1] ** 2, p[:, -2] * p[:, -1], 0 * p[:, 0]]) for p in z]
    sensor = fit_local_sensor(z, d, known, moments=moments)
    assert {"network": "local"}.get(truth, truth) in sensor.inputs
    z = np.append(RNG.standard_normal(6), [1.0, -2.0])
    linear = sensor.frozen(z)
    np.testing.assert_allclose(linear.raw(z), sensor.raw(z), atol=1e-12)
    step = 1e-4 * RNG.standard_normal(8)
    change = sensor.raw(z + step) - sensor.raw(z - step)
    np.testing.assert_allclose(2 * linear.S_d @ step, change, atol=1e-8)


def test_arrays_bring_it_back():
    known = network()
    z, d = runs(known)
    q, along = moments_of(z)
    for sensor in (
        fit_local_sensor(z, d, known),
        fit_local_sensor(z, along, known, moments={"virial": q}),
        cs.fit_sensor(z, d),
    ):
        again = sensor_from(sensor.arrays())
        assert type(again) is type(sensor)
        np.testing.assert_array_equal(again.raw(z[0]), sensor.raw(z[0]))
        if isinstance(sensor, LocalSensor):
            assert again.inputs == sensor.inputs
            assert again.tried == sensor.tried


def test_bad_maps_are_refused():
    with pytest.raises(cs.DimensionError, match="nodes"):
        StiffnessMap(np.zeros((3, 3)), np.zeros(3))
    with pytest.raises(cs.DataError, match="NaN"):
        StiffnessMap(np.zeros((3, 2)), np.array([1.0, np.nan, 1.0]))


def test_a_graded_cue_reads_the_contrast_at_rest():
    """Held out less than half of the best constant's error; slope, files, other networks."""
    plain = network()
    known = StiffnessMap(plain.nodes, plain.stiffness, contrasts=True)
    assert np.linalg.norm(known.at(np.zeros(2))) < np.linalg.norm(known.at(np.array([3.0, 1.0])))
    z, g = runs(known)
    test_z, test_g = runs(known, n=3, seed=9)
    graded_d, graded_test = (
        [np.column_stack([graded(v[:, :2], 0.05), v[:, 2]]) for v in rows] for rows in (g, test_g)
    )
    sensor = fit_local_sensor(z, graded_d, known, test_z, graded_test, noise=0.05)
    assert "local stiffness" in sensor.inputs
    assert sensor.held_out_error < 0.5 * sensor.constant_error
    assert np.allclose(sensor.direction(test_z[0]), graded_test[0], atol=0.05)
    at = test_z[0][3]
    flat = sensor.frozen(at)
    assert flat.noise == 0.05
    assert np.allclose(flat.raw(at), sensor.raw(at), rtol=1e-9)
    h = 1e-4 * np.eye(len(at))
    slope = np.column_stack([(sensor.raw(at + e) - sensor.raw(at - e)) / 2e-4 for e in h])
    assert np.allclose(flat.S_d, slope, atol=1e-5)
    again = sensor_from(sensor.arrays())
    assert np.array_equal(again.raw(at), sensor.raw(at))
    assert again.map.contrasts
    even = sensor.on(known.nodes, np.ones(len(known.nodes)))
    assert np.linalg.norm(even.direction(at)) < 0.1
    with pytest.raises(cs.DataError, match="contrasts"):
        fit_local_sensor(z, graded_d, plain, noise=0.05)
