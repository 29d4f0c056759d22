"""The sensor: exact recovery, ridge by leaving out runs, held-out error against a constant."""

import numpy as np
import pytest

from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.laws.sensing import graded
from cellsys.model import StiffnessSensor, fit_sensor
from cellsys.model.sensor import angle_error


def runs(K_d, count=6, T=80, noise=0.0, seed=0, unit=False):
    rng = np.random.default_rng(seed)
    m = K_d.shape[1] - 1
    latent, direction = [], []
    for _ in range(count):
        z = rng.standard_normal(m) + np.cumsum(0.2 * rng.standard_normal((T, m)), axis=0)
        d = K_d[:, 0] + z @ K_d[:, 1:].T + noise * rng.standard_normal((T, 3))
        latent.append(z)
        direction.append(d / np.linalg.norm(d, axis=1, keepdims=True) if unit else d)
    return latent, direction


def truth(m=4, seed=1):
    return np.random.default_rng(seed).standard_normal((3, m + 1))


def test_a_linear_direction_is_recovered():
    K_d = truth()
    latent, direction = runs(K_d)
    exact = fit_sensor(latent, direction, ridges=(0.0,))
    # least squares on exact data, condition below 1e3
    assert np.abs(exact.K_d - K_d).max() < 1e-12
    # the shipped penalties shrink by at most about the penalty
    shipped = fit_sensor(latent, direction)
    assert shipped.ridge == 1e-4
    assert np.abs(shipped.K_d - K_d).max() < 1e-2 * np.abs(K_d).max()


def test_intercept_is_not_penalised_and_units_do_not_matter():
    K_d = truth()
    K_d[:, 0] *= 100.0
    latent, direction = runs(K_d)
    sensor = fit_sensor(latent, direction, ridges=(1e-2,))
    z = np.concatenate(latent)
    at_mean = sensor.raw(z.mean(axis=0))
    assert np.abs(at_mean - np.concatenate(direction).mean(axis=0)).max() < 1e-11
    scaled = fit_sensor([z * [1e6, 1, 1e-6, 1] for z in latent], direction, ridges=(1e-2,))
    assert np.abs(scaled.S_d * [1e6, 1, 1e-6, 1] - sensor.S_d).max() < 1e-11 * 100


def test_the_penalty_is_chosen_by_leaving_out_runs():
    K_d = truth(8)
    latent, direction = runs(K_d, count=4, T=12, noise=3.0, unit=True)

    def left_out(ridge):
        total = 0.0
        for i in range(4):
            rest = [k for k in range(4) if k != i]
            one = fit_sensor(
                [latent[k] for k in rest], [direction[k] for k in rest], ridges=(ridge,)
            )
            total += angle_error(one.raw(latent[i]), direction[i])
        return total

    ridges = (1e-4, 1e-2, 1.0, 10.0)
    assert fit_sensor(latent, direction, ridges=ridges).ridge == min(ridges, key=left_out)
    # noise this large asks for a penalty; clean data for none
    assert fit_sensor(latent, direction).ridge > fit_sensor(*runs(K_d, unit=False)).ridge


def test_held_out_error_beats_a_constant_direction_where_there_is_signal():
    K_d = truth()
    train, test = runs(K_d, noise=0.1, unit=True), runs(K_d, 3, noise=0.1, seed=5, unit=True)
    sensor = fit_sensor(*train, *test)
    assert sensor.held_out_error < 0.5 * sensor.constant_error
    direct = angle_error(sensor.direction(np.concatenate(test[0])), np.concatenate(test[1]))
    assert abs(sensor.held_out_error - direct) < 1e-9
    assert sensor.training_error < 0.5 * sensor.constant_error
    assert np.isnan(fit_sensor(*train).held_out_error)


def test_without_signal_it_is_no_better_than_a_constant():
    K_d = truth()
    K_d[:, 1:] = 0.0
    train, test = (runs(K_d, 4, noise=1.0, seed=s, unit=True) for s in (0, 1))
    sensor = fit_sensor(*train, *test)
    assert sensor.held_out_error > 0.95 * sensor.constant_error


def test_collinear_and_constant_regressors_are_harmless():
    K_d = truth(2)
    latent, direction = runs(K_d)
    wide = [np.column_stack([z, z[:, 0], np.full(len(z), 3.0)]) for z in latent]
    sensor = fit_sensor(wide, direction, ridges=(0.0,))
    assert np.abs(sensor.raw(wide[0]) - direction[0]).max() < 1e-11
    assert np.all(sensor.S_d[:, 3] == 0.0)


def test_one_run_is_enough():
    K_d = truth(2)
    latent, direction = runs(K_d, 1)
    assert fit_sensor(latent, direction).training_error < 1.0


def test_direction_of_zero_stays_zero():
    sensor = StiffnessSensor(K_d=np.array([[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]]))
    assert np.array_equal(sensor.direction(np.array([0.0])), np.zeros(3))
    assert np.array_equal(sensor.direction(np.array([[-2.0], [0.0]])), [[-1, 0, 0], [0, 0, 0]])


def test_angle_error():
    x, y = np.array([[1.0, 0, 0]]), np.array([[0, 2.0, 0]])
    assert angle_error(x, x) == 0.0
    assert abs(angle_error(x, y) - 90) < 1e-12
    assert abs(angle_error(x, -3 * x) - 180) < 1e-12
    assert abs(angle_error(0 * x, x) - 90) < 1e-12


@pytest.mark.parametrize(
    ("K_d", "error"),
    [
        (np.zeros((2, 4)), DimensionError),
        (np.zeros((3, 1)), DimensionError),
        (np.zeros(4), DimensionError),
        (np.full((3, 4), np.nan), DataError),
    ],
)
def test_sensor_refuses(K_d, error):
    with pytest.raises(error):
        StiffnessSensor(K_d=K_d)


def test_fit_refuses():
    latent, direction = runs(truth())
    with pytest.raises(DataError, match="as many runs"):
        fit_sensor(latent, direction[:-1])
    with pytest.raises(DataError, match="as many runs"):
        fit_sensor([], [])
    broken = [z.copy() for z in latent]
    broken[2][3, 1] = np.nan
    with pytest.raises(DataError, match="NaN"):
        fit_sensor(broken, direction)
    with pytest.raises(DimensionError):
        fit_sensor(latent, [d[:-1] for d in direction])


def test_a_graded_cue_is_learned_as_a_contrast():
    """g linear in z is recovered from d = (g/g0) x/(1 + x^2), also where g is next to nothing."""
    K_d = 0.05 * truth()
    K_d[2] = 0.0
    latent, g = runs(K_d)
    d = [np.column_stack([graded(row[:, :2], 0.05), row[:, 2]]) for row in g]
    sensor = fit_sensor(latent, d, latent[:2], d[:2], ridges=(0.0,), noise=0.05)
    assert np.abs(sensor.K_d - K_d).max() < 1e-9
    assert np.allclose(sensor.direction(latent[0]), d[0], atol=1e-7)
    assert sensor.error_unit == "of g"
    assert sensor.held_out_error < 1e-6 * sensor.constant_error
    sizes = np.linalg.norm(np.concatenate(g), axis=1)
    assert sensor.strength == pytest.approx(sizes.mean() / 0.05, rel=1e-6)
    # The naive sensor of directions calls all cues equally strong.
    naive = fit_sensor(latent, d, ridges=(0.0,))
    assert np.allclose(np.linalg.norm(naive.direction(latent[0]), axis=1), 1.0)
    again = StiffnessSensor(**sensor.arrays())
    assert again.noise == 0.05
    assert again.strength == sensor.strength
    old = {k: v for k, v in sensor.arrays().items() if k not in ("noise", "strength")}
    assert StiffnessSensor(**old).error_unit == "deg"  # as files of 0.2.0 hold it
    with pytest.raises(ParameterError, match="noise"):
        StiffnessSensor(K_d=K_d, noise=-1.0)
