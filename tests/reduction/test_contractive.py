"""Contractive models: certificate at every order, bounded roll-outs, exact gradient, recovery."""

import numpy as np
import pytest

from cellsys.errors import IntegrationError, ParameterError
from cellsys.model import LatentModel, contraction
from cellsys.model.contraction import clipped, contraction_metric, shrunk
from cellsys.reduction import Contractive, fit_basis, reduce
from cellsys.reduction.roll_out_loss import RollOuts, adam
from tests.reduction.systems import linear_runs, spreading_data, stable_matrix, state_data

DAY = 1e6  # s


def small_runs(seed=0, known=False, steps=7, runs=3, m=4, n_c=2):
    rng = np.random.default_rng(seed)
    weight = np.ones((steps + 1, runs))
    weight[0], weight[3, 1], weight[5:, 2] = 0.0, 0.0, 0.0
    half = rng.standard_normal((m, m))
    return RollOuts(
        true=rng.standard_normal((steps + 1, runs, m)),
        weight=weight,
        start=rng.standard_normal((runs, m)),
        inputs=rng.standard_normal((steps, runs, n_c)),
        known=rng.standard_normal((steps, runs, m)) if known else None,
        metric=half @ half.T,
    )


@pytest.mark.parametrize("known", [False, True])
def test_the_adjoint_is_the_gradient_of_the_roll_out(known):
    runs, rng = small_runs(known=known), np.random.default_rng(1)
    K, b = 0.4 * rng.standard_normal((6, 4)), rng.standard_normal(4)
    value, gK, gb = runs.loss(K, b)
    # the loss sample by sample, with its own recursion
    total = 0.0
    for r in range(3):
        w = runs.start[r]
        for k in range(7):
            w = w @ K[:4] + runs.inputs[k, r] @ K[4:] + b + (runs.known[k, r] if known else 0.0)
            e = w - runs.true[k + 1, r]
            total += runs.weight[k + 1, r] * e @ runs.metric @ e
    assert value == pytest.approx(total, rel=1e-12)
    h = 1e-5  # central difference: error h^2 and rounding 1e-16/h, both near 1e-10
    for index in np.ndindex(K.shape):
        d = np.zeros_like(K)
        d[index] = h
        slope = (runs.loss(K + d, b)[0] - runs.loss(K - d, b)[0]) / (2 * h)
        assert abs(slope - gK[index]) < 1e-6 * np.abs(gK).max()
    for i in range(4):
        d = np.eye(4)[i] * h
        slope = (runs.loss(K, b + d)[0] - runs.loss(K, b - d)[0]) / (2 * h)
        assert abs(slope - gb[i]) < 1e-6 * np.abs(gb).max()


def test_training_never_ends_above_its_start_and_comes_back_from_a_wild_step():
    runs, rng = small_runs(2), np.random.default_rng(3)
    K, b = 0.4 * rng.standard_normal((6, 4)), rng.standard_normal(4)
    for rate in (1e-3, 0.9):
        best, offset, history = adam(runs, K, b, None, 60, rate)
        assert runs.loss(best, offset)[0] == history.min() < history[0]


@pytest.mark.parametrize("loss", ["one-step", "roll-out"])
@pytest.mark.parametrize("metric", ["whitened", "fitted"])
def test_every_order_contracts(loss, metric):
    """Norm <= 1 + 1e-12 from 5 to 200 (the issue's bound), on the loaded model's own matrices."""
    largest = 200 if metric == "fitted" else 60
    data = spreading_data(n=140, n_eta=100, T=80, runs=4)
    basis = fit_basis(data, largest).with_parts(data)
    for order in (5, 20, largest):
        method = Contractive(loss=loss, metric=metric, iterations=8, delta=1e-3)
        certificate = contraction(method.fit(data, order, basis=basis))
        assert certificate.norm <= 1.0 + 1e-12
        assert "does not" not in str(certificate)


def test_bounded_for_ever_where_the_same_fit_without_the_bound_is_not(tmp_path):
    """1e6 s under the largest command; the bound |w_0| + sup |input| / delta holds at each."""
    data = spreading_data(seed=3, runs=3, T=60)
    basis = fit_basis(data, 40).with_parts(data)
    t = np.arange(0.0, DAY + 1, 1e3)
    escaped = []
    for order in (5, 10, 20, 40):
        method = Contractive(delta=1e-3, metric="whitened", iterations=30)
        model = method.fit(data, order, basis=basis)
        again = LatentModel.load(model.save(tmp_path / "m.npz"))
        assert contraction(again).norm < 1.0
        sd = model.singular_values
        c = np.array([1.0, 0.0])
        z = model.predict(np.zeros(order), c, t)
        drive = model.dt * (model.B @ c + model.offset) / sd
        bound = np.linalg.norm(drive) / 1e-3
        assert np.linalg.norm(z / sd, axis=1).max() <= bound
        free = Contractive(delta=None, metric="whitened", iterations=30)
        try:
            grown = free.fit(data, order, basis=basis).predict(np.zeros(order), c, t)
            escaped.append(bool(np.linalg.norm(grown / sd, axis=1).max() > bound))
        except IntegrationError:
            escaped.append(True)
    assert any(escaped)


@pytest.mark.parametrize("loss", ["one-step", "roll-out"])
def test_a_contractive_linear_system_is_recovered(loss):
    """Exact data, no penalty: the start is exact already and training must not leave it."""
    rng = np.random.default_rng(4)
    A, dt = stable_matrix(4, rng), 0.1
    runs = [x for x, _ in linear_runs(A, np.zeros((4, 0)), np.ones(4), dt, rng, runs=4)]
    data = state_data(runs, dt)
    model = Contractive(loss=loss, ridge=0.0, delta=1e-3, iterations=40).fit(data, 4)
    exact = np.sort_complex(np.linalg.eigvals(A))
    # rounding times the condition of table and metric (1e5 together)
    assert np.abs(np.sort_complex(model.poles()) - exact).max() < 1e-7


def test_training_on_roll_outs_lowers_their_error():
    """The same bound and metric; only the loss differs (one_step fits never see a roll-out)."""
    train = spreading_data(seed=0, runs=3)
    error = {
        loss: reduce(train, order=8, method=Contractive(loss=loss)).card.training["cells"]["model"]
        for loss in ("one-step", "roll-out")
    }
    assert error["roll-out"] < 0.95 * error["one-step"]


def test_tools():
    rng = np.random.default_rng(0)
    A = rng.standard_normal((9, 9))
    assert np.linalg.norm(clipped(A, 0.7), 2) <= 0.7 * (1 + 1e-14)
    small = 0.5 * A / np.linalg.norm(A, 2)
    assert clipped(small, 0.7) is small
    S = shrunk(A, 0.9)
    before, after = np.linalg.eigvals(A), np.linalg.eigvals(S)
    # several eigenvalues meet on the circle: a double one is sensitive as the root of rounding
    assert np.abs(after).max() <= 0.9 + 1e-6
    # what was inside stays where it was
    inside = before[np.abs(before) < 0.9]
    assert np.abs(inside[:, None] - after[None]).min(axis=1).max(initial=0.0) < 1e-10
    L = contraction_metric(S, 0.95)
    assert np.linalg.norm(L @ S @ np.linalg.inv(L), 2) <= 0.95 * (1 + 1e-10)
    assert contraction(LatentModel(A=np.eye(1), singular_values=[1.0], dt=1.0)).norm == 2.0


def test_refusals():
    for bad in (
        {"loss": "two-step"},
        {"metric": "cubic"},
        {"delta": 0.0},
        {"delta": 1.0},
        {"ridge": -1.0},
        {"step": -5.0},
        {"iterations": -1},
        {"rate": 0.0},
    ):
        with pytest.raises(ParameterError, match="Contractive"):
            Contractive(**bad)
    with pytest.raises(ParameterError, match="discrete"):
        contraction(LatentModel(A=[[-1.0]]))
