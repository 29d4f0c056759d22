"""Ridge on standardised regressors: its limits, its step, its refusals."""

import numpy as np
import pytest

from cellsys.errors import DataError, ParameterError
from cellsys.reduction import LeastSquares, Ridge, fit_basis, reduce
from cellsys.reduction.ridge import ridge_regress
from tests.reduction.systems import (
    linear_runs,
    one_step_data,
    spreading_data,
    stable_matrix,
    state_data,
)


@pytest.mark.parametrize("commands", [True, False])
def test_without_penalty_and_at_the_sampling_interval_it_is_least_squares(commands):
    data = one_step_data(seed=1, commands=commands)
    a, b = Ridge(ridge=0.0).fit(data, 6), LeastSquares().fit(data, 6)
    # two least-squares solvers on a table of condition below 1e4
    for name in ("A", "B", "offset"):
        want = getattr(b, name)
        assert np.abs(getattr(a, name) - want).max() < 1e-9 * max(1.0, np.abs(want).max()), name
    assert a.input_names == b.input_names


@pytest.mark.parametrize("every", [1, 3, 7])
def test_poles_do_not_depend_on_the_step_where_the_data_are_linear(every):
    rng = np.random.default_rng(2)
    A, dt = stable_matrix(5, rng), 0.1
    runs = [x for x, _ in linear_runs(A, np.zeros((5, 0)), np.ones(5), dt, rng, runs=4)]
    model = Ridge(ridge=0.0, step=every * dt).fit(state_data(runs, dt), 5)
    assert model.dt == pytest.approx(every * dt, rel=1e-14)
    exact = np.sort_complex(np.linalg.eigvals(A))
    # rounding times the condition of the table (1e3), over the step
    assert np.abs(np.sort_complex(model.poles()) - exact).max() < 1e-8


def test_the_penalty_is_that_of_the_textbook_on_standardised_regressors():
    rng = np.random.default_rng(0)
    Z = rng.standard_normal((80, 4)) * [1e-3, 1.0, 10.0, 1e3] + 5.0
    Y, ridge = rng.standard_normal((80, 2)), 0.3
    F = (Z - Z.mean(axis=0)) / Z.std(axis=0)
    want = np.linalg.solve(F.T @ F / 80 + ridge * np.eye(4), F.T @ (Y - Y.mean(axis=0)) / 80)
    K, b = ridge_regress(Z, Y, ridge)
    assert np.abs(K * Z.std(axis=0)[:, None] - want).max() < 1e-12
    assert np.abs((Z @ K + b).mean(axis=0) - Y.mean(axis=0)).max() < 1e-12
    # one penalty for weak and strong directions: units of z do not matter
    again, _ = ridge_regress(Z * [7.0, 1e4, 1e-4, 3.0], Y, ridge)
    assert np.allclose(again * [[7.0], [1e4], [1e-4], [3.0]], K, rtol=1e-9)
    # the naive penalty on raw z does depend on them
    raw = np.linalg.solve(Z.T @ Z + 80 * ridge * np.eye(4), Z.T @ Y)
    W = Z * [7.0, 1e4, 1e-4, 3.0]
    other = np.linalg.solve(W.T @ W + 80 * ridge * np.eye(4), W.T @ Y)
    assert np.abs(other * [[7.0], [1e4], [1e-4], [3.0]] - raw).max() > 0.1 * np.abs(raw).max()


def test_a_great_penalty_leaves_nothing_but_the_mean_rate():
    model = Ridge(ridge=1e12).fit(one_step_data(seed=3, commands=True), 5)
    assert np.abs(model.A).max() < 1e-9
    assert np.abs(model.offset).max() > 1e-3


def test_long_steps_stay_inside_runs_and_events():
    """A jump at a logged event, or between runs, does not enter any pair."""
    rng = np.random.default_rng(5)
    A, dt = stable_matrix(4, rng), 0.1
    runs = [x for x, _ in linear_runs(A, np.zeros((4, 0)), np.zeros(4), dt, rng, runs=3)]
    for x in runs:
        x[20:] *= -2.0  # in interval 19
    exact = np.sort_complex(np.linalg.eigvals(A))

    def error(**more):
        model = Ridge(ridge=0.0, step=4 * dt).fit(state_data(runs, dt, **more), 4)
        return np.abs(np.sort_complex(model.poles()) - exact).max()

    assert error(skip=(19,)) < 1e-8  # as above
    assert error() > 1e-2


def test_its_card_measures_whole_runs_at_the_samples():
    data = spreading_data()
    model = reduce(data, order=8, method=Ridge(ridge=1e-3, step=20.0))
    assert model.dt == 20.0
    assert 0.0 < model.card.training["cells"]["model"] < 1.0


def test_refusals():
    data = spreading_data(runs=1, T=10)
    with pytest.raises(ParameterError, match="multiple of the sampling interval of 5 s"):
        Ridge(step=12.0).fit(data, 2)
    with pytest.raises(ParameterError, match="multiple"):
        Ridge(step=1.0).fit(data, 2)
    with pytest.raises(DataError, match="stretch of 60 s"):
        Ridge(step=60.0).fit(data, 2, basis=fit_basis(data, 2))
    for bad in ({"ridge": -1.0}, {"ridge": np.nan}, {"step": 0.0}, {"step": np.inf}):
        with pytest.raises(ParameterError, match="Ridge"):
            Ridge(**bad)
