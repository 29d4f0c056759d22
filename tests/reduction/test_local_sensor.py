"""The sensor that reads the network: recovery, choice of inputs, slope, files."""

import numpy as np
import pytest

import cellsys as cs
from cellsys.reduction.local_sensor import (
    LocalSensor,
    StiffnessMap,
    fit_local_sensor,
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


def test_frozen_sensor_has_value_and_slope():
    known = network()
    sensor = fit_local_sensor(*runs(known), known)
    z = np.append(RNG.standard_normal(6), [1.0, -2.0])
    linear = sensor.frozen(z)
    np.testing.assert_allclose(linear.raw(z), sensor.raw(z), atol=1e-12)
    step = 1e-4 * RNG.standard_normal(8)
    change = sensor.raw(z + step) - sensor.raw(z - step)
    np.testing.assert_allclose(2 * linear.S_d @ step, change, atol=1e-8)


def test_arrays_bring_it_back():
    known = network()
    z, d = runs(known)
    for sensor in (fit_local_sensor(z, d, known), cs.fit_sensor(z, d)):
        again = sensor_from(sensor.arrays())
        assert type(again) is type(sensor)
        np.testing.assert_array_equal(again.raw(z[0]), sensor.raw(z[0]))
        if isinstance(sensor, LocalSensor):
            assert again.inputs == sensor.inputs


def test_bad_maps_are_refused():
    with pytest.raises(cs.DimensionError, match="nodes"):
        StiffnessMap(np.zeros((3, 3)), np.zeros(3))
    with pytest.raises(cs.DataError, match="NaN"):
        StiffnessMap(np.zeros((3, 2)), np.array([1.0, np.nan, 1.0]))
