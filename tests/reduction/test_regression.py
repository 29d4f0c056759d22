"""PCR against least-squares DMD, seams and events, differences, exact recovery of poles."""

import dataclasses

import numpy as np
import pytest

from cellsys.errors import (
    DataError,
    DimensionError,
    IntegrationError,
    ParameterError,
    RankError,
)
from cellsys.integrate import CVODES, simulate
from cellsys.model import LatentModel
from cellsys.reduction import PCR, LeastSquares, reduce, reduce_orders
from cellsys.reduction.basis import fit_basis
from cellsys.reduction.regression import regress
from cellsys.samples import RunData, snapshots
from cellsys.system import OdeSystem
from cellsys.worth.assessment import predict_samples
from tests import naive
from tests.reduction.systems import ar1_data, linear_runs, one_step_data, stable_matrix, state_data


def dmd_with_known_input(data, basis, intercept=True):
    """A, b of (z_k+1 - z_k)/dt - V_x^T S_x^-1 u_k ~ A z_k + b, straight from the arrays."""
    n, weight = data.states.size, basis.inverse_scale()[:, None] * basis.V
    now, rate = [], []
    for run in data.runs:
        whole = np.hstack([run.x[:-1], run.eta])
        z = (whole - basis.mean) @ weight
        now.append(z[:-1])
        rate.append(np.diff(z, axis=0) / data.dt - run.u[: len(z) - 1] @ weight[:n])
    now, rate = np.concatenate(now), np.concatenate(rate)
    columns = np.column_stack([now, np.ones(len(now))]) if intercept else now
    K = np.linalg.lstsq(columns, rate, rcond=None)[0]
    return K[: now.shape[1]].T, K[-1] if intercept else np.zeros(now.shape[1])


@pytest.mark.parametrize("scale", ["none", "block", "column"])
@pytest.mark.parametrize("order", [1, 3, 7, 12])
def test_pcr_is_least_squares_dmd_in_pca_coordinates(scale, order):
    """Same samples in mean, basis and regression: equal to rounding [notes: theory, regression]."""
    data = one_step_data(seed=order, scale=scale)
    basis = fit_basis(data, order)
    A, b = dmd_with_known_input(data, basis)
    model = PCR().fit(data, order, basis=basis)
    # 1e-9 of the matrix: lstsq of a table with condition below 1e3 loses three of 16 digits
    assert np.abs(model.A - A).max() < 1e-9 * np.abs(A).max()
    assert np.abs(model.offset - b).max() < 1e-9 * max(1.0, np.abs(b).max())

    backward = PCR(difference="backward").fit(data, order, basis=basis)
    assert np.abs(backward.A - A).max() > 1e-3 * np.abs(A).max()


def test_the_identity_holds_with_neither_centring_nor_intercept_and_breaks_with_one():
    data = one_step_data(seed=4)
    basis = fit_basis(data, 5, center=False)
    A, _ = dmd_with_known_input(data, basis, intercept=False)
    B = naive.uncentred_pcr(data, basis, intercept=False)
    assert np.abs(B - A).max() < 1e-9 * np.abs(A).max()
    A, _ = dmd_with_known_input(data, basis, intercept=True)
    B = naive.uncentred_pcr(data, basis, intercept=True)
    assert np.abs(B - A).max() > 1e-3 * np.abs(A).max()


def test_backward_differences_turn_the_sign_of_damping():
    """Stationary AR(1): forward -(1 - rho)/dt, backward +(1 - rho)/dt.

    [notes: theory, regression]
    """
    rho, dt = 0.5, 0.1
    data = ar1_data(rho, dt=dt)
    # the standard error of rho from 40 000 samples is sqrt(1 - rho^2)/200 = 0.0043, over dt 0.043;
    # five of them
    near = 0.22
    fast = (1 - rho) / dt
    forward = np.sort(np.linalg.eigvals(PCR().fit(data, 2).A).real)
    assert abs(forward[0] + fast) < near
    assert forward[-1] < near
    backward = np.linalg.eigvals(PCR(difference="backward").fit(data, 2).A).real.max()
    assert abs(backward - fast) < near
    eta = data.runs[0].eta[:, 0]
    assert abs(naive.backward_slope(eta, dt) - fast) < near


@pytest.mark.parametrize("scale", ["none", "block"])
def test_literal_form_is_equation_24_written_out(scale):
    """Stacked samples, SVD about zero, backward differences inside runs, normal algebra."""
    data, order = one_step_data(seed=2, scale=scale), 4
    n, samples, now, rate = data.states.size, [], [], []
    for run in data.runs:
        both = np.hstack([run.x[:-1], run.eta])[:-1]
        samples.append(both)
        now.append(both[1:])
        rate.append((both[1:, n:] - both[:-1, n:]) / data.dt)
    V = np.linalg.svd(np.concatenate(samples))[2][:order].T
    K = np.linalg.lstsq(np.concatenate(now) @ V, np.concatenate(rate), rcond=None)[0].T
    W_x, W_eta = data.W_x.toarray(), data.W_eta.toarray()
    A = V[:n].T @ (W_x @ V[:n] + W_eta @ V[n:]) + V[n:].T @ K
    centred = fit_basis(data, order)
    model = PCR(literal=True).fit(data, order, basis=centred)  # a basis that it must not take
    # singular vectors have signs: compare what does not depend on them
    signs = np.sign(np.sum(V * model.V, axis=0))
    assert np.abs(signs[:, None] * A * signs - model.A).max() < 1e-9 * np.abs(A).max()
    assert np.all(model.mean == 0.0)
    assert np.all(model.offset == 0.0)
    assert np.all(model.scale == 1.0)
    assert (PCR(literal=True).name, PCR().name) == ("PCR (literal)", "PCR")
    assert (
        np.abs(np.sort(model.poles().real) - np.sort(PCR().fit(data, 4).poles().real)).max() > 0.1
    )


def test_literal_form_turns_damping_into_growth():
    """AR(1) rate: printed, a growing mode of rate log(1 + dt (1 - rho)/dt)/dt; forward, none."""
    rho, dt = 0.5, 0.1
    data = ar1_data(rho, dt=dt)
    literal, forward = PCR(literal=True).fit(data, 2), PCR().fit(data, 2)
    # five standard errors of rho from 40 000 samples, over dt, as above
    assert abs(literal.growth() - np.log(2.0 - rho) / dt) < 0.22
    assert forward.growth() < 0.22
    t = dt * np.arange(20_001)
    with pytest.raises(IntegrationError, match="diverges"):
        literal.predict(np.ones(2), None, t)
    assert np.all(np.isfinite(forward.predict(np.ones(2), None, t[:2001])))


def test_a_constant_column_survives_where_nothing_is_centred():
    rng = np.random.default_rng(0)
    runs = [np.column_stack([np.full(30, 7.0), rng.standard_normal((30, 2))]) for _ in range(2)]
    data = snapshots(runs, dt=1.0, scale="none")
    basis = fit_basis(data, 3, center=False)
    back = (runs[0] @ basis.V) @ basis.V.T
    assert np.abs(back - runs[0]).max() < 1e-12
    assert fit_basis(data, 2).dropped == 1  # centred, it is the mean


def test_no_difference_across_runs_or_events():
    """A jump between runs, or at a logged event, leaves the exact recovery alone."""
    rng = np.random.default_rng(0)
    A, dt = stable_matrix(4, rng), 0.1
    runs = [x for x, _ in linear_runs(A, np.zeros((4, 0)), np.zeros(4), dt, rng, runs=3)]
    runs[1] = runs[1] * 50.0
    exact = np.sort_complex(np.linalg.eigvals(A))

    def error(data):
        return np.abs(np.sort_complex(LeastSquares().fit(data, 4).poles()) - exact).max()

    # one-step least squares on noise-free data: rounding times the condition (about 1e3)
    assert error(state_data(runs, dt)) < 1e-9
    jumped = [x.copy() for x in runs]
    for x in jumped:
        x[20:] *= -2.0  # the event happened in interval 19
    assert error(state_data(jumped, dt)) > 1e-2
    assert error(state_data(jumped, dt, skip=(19,))) < 1e-9
    assert naive.pole_error_of_one_long_run(runs, dt, exact) > 1e-2


def test_backward_pcr_also_stays_inside_runs_and_events():
    data = one_step_data(seed=3)
    model = PCR(difference="backward").fit(data, 3)
    shifted = dataclasses.replace(data, runs=(data.runs[2], data.runs[0], data.runs[1]))
    again = PCR(difference="backward").fit(shifted, 3)
    # another order of runs: same sums, another rounding
    assert np.allclose(np.sort_complex(again.poles()), np.sort_complex(model.poles()), rtol=1e-8)


def test_logged_events_of_a_trajectory_are_skipped():
    run = RunData(x=np.zeros((10, 2)), eta=np.zeros((9, 1)), skip=(4,))
    assert run.usable().tolist() == [0, 1, 2, 6, 7]
    assert RunData(x=np.zeros((10, 2)), skip=(0,)).usable().tolist() == [2, 3, 4, 5, 6, 7, 8]


@pytest.mark.parametrize("scale", ["none", "block", "column"])
def test_least_squares_recovers_a_linear_system_exactly(scale):
    rng = np.random.default_rng(1)
    n, dt = 6, 0.15
    A, B, b = stable_matrix(n, rng), rng.standard_normal((n, 2)), rng.standard_normal(n)
    arrays = linear_runs(A, B, b, dt, rng)
    data = snapshots([RunData(x=x, commands=c) for x, c in arrays], dt=dt, scale=scale)
    model = reduce(data, order=n, method=LeastSquares())
    exact = np.sort_complex(np.linalg.eigvals(A))
    # rounding of the samples over dt, times the condition of the table (about 1e3)
    assert np.abs(np.sort_complex(model.poles()) - exact).max() < 1e-9
    # continuous form: the same transfer function as the system behind the samples
    A_c, B_c, _ = model.continuous_matrices()
    assert np.abs(np.sort_complex(np.linalg.eigvals(A_c)) - exact).max() < 1e-9
    C = (model.scale[:, None] * model.V)[:n]
    s = 0.3 + 1.1j
    G = C @ np.linalg.solve(s * np.eye(n) - A_c, B_c)
    assert np.abs(G - np.linalg.solve(s * np.eye(n) - A, B)).max() < 1e-8
    x, c = arrays[0]
    z = model.predict(model.encode(x[0]), c, dt * np.arange(len(x)))
    assert np.abs(model.reconstruct(z) - x).max() < 1e-8 * np.abs(x).max()


def test_pcr_on_trajectories_predicts_what_was_recorded():
    """A nonlinear system through simulate(): eta is the average over the interval, PCR exact."""
    n = 2
    system = OdeSystem(
        states=["a", "b"],
        auxiliaries=["f"],
        x0=np.array([1.0, -0.5]),
        W_x=np.array([[-1.0, 0.3], [0.0, -0.7]]),
        W_eta=np.array([[0.0], [1.0]]),
        law=lambda t, x: [-0.2 * x[0] * x[0]],
    )
    t = np.linspace(0.0, 3.0, 61)
    runs = [
        simulate(system, CVODES(rtol=1e-9, atol=1e-11), t, x0)
        for x0 in ([1.0, -0.5], [0.2, 0.9], [-1.0, 0.4])
    ]
    data = snapshots(runs)
    basis = fit_basis(data, 4)
    model = PCR().fit(data, 4, basis=basis)
    A, _ = dmd_with_known_input(
        dataclasses.replace(
            data, runs=tuple(dataclasses.replace(r, u=np.zeros((60, n))) for r in data.runs)
        ),
        basis,
    )
    # the step residual block makes the identity hold on real runs too; the fourth direction is
    # weak (condition 1e4)
    assert np.abs(model.A - A).max() < 1e-7 * np.abs(A).max()


def test_commands_enter_as_the_regression_of_u():
    data = one_step_data(seed=5, commands=True)
    model = PCR().fit(data, 6)
    assert model.input_names == ("a", "b")
    assert model.notes["input_share_explained"] > 1 - 1e-12  # u is linear in the commands here
    U = np.linalg.lstsq(data.runs[0].commands, data.runs[0].u, rcond=None)[0]
    n = data.states.size
    expected = (U * (1.0 / model.scale[:n])) @ model.V[:n]
    assert np.abs(model.B - expected.T).max() < 1e-11


def test_reduce_orders_gives_the_models_of_reduce():
    data = one_step_data(seed=6, commands=True)
    basis = fit_basis(data, 8)
    methods = [PCR(), LeastSquares()]
    many = reduce_orders(data, methods, [2, 5, 8], basis=basis)
    for model, (method, order) in zip(
        many, [(m, k) for m in methods for k in (2, 5, 8)], strict=True
    ):
        alone = reduce(data, order=order, method=method, basis=basis)
        # same numbers, other order of sums
        assert np.allclose(model.A, alone.A, rtol=1e-9, atol=1e-11)
        assert np.allclose(model.z_start, alone.z_start, rtol=1e-10, atol=1e-12)
        assert model.card.verdict == alone.card.verdict


def test_tol_gives_the_smallest_order_that_meets_it():
    data = one_step_data(seed=7)
    for tol in (0.3, 0.05, 1e-3):
        model = reduce(data, tol=tol)
        share = 1.0 - model.notes["variance_share"]
        assert share <= tol
        assert (
            model.order == 1
            or 1.0 - reduce(data, order=model.order - 1).notes["variance_share"] > tol
        )
    with pytest.raises(ParameterError, match="tol"):
        reduce(data, tol=0.0)
    # Fewer samples than columns: with their mean taken out, all but one of them span the rest.
    few = one_step_data(seed=7, runs=1, T=6)
    assert few.n_samples < few.n_columns
    with pytest.raises(ParameterError, match="tol"):
        reduce(few, tol=1e-300)
    assert reduce(few, tol=1e-14).order == few.n_samples - 1


@pytest.mark.parametrize("options", [{}, {"order": 2, "tol": 0.1}])
def test_order_or_tol(options):
    with pytest.raises(ParameterError, match="either"):
        reduce(one_step_data(), **options)


def test_regress_reports_its_rank_and_scales_columns():
    rng = np.random.default_rng(0)
    Z = rng.standard_normal((50, 3)) * [1e-8, 1.0, 1e8]
    K = rng.standard_normal((3, 2))
    got, intercept, rank = regress(Z, Z @ K + 2.0, True, 1e-13)
    assert rank == 4
    assert np.abs((got - K) * [[1e-8], [1.0], [1e8]]).max() < 1e-6
    assert np.abs(intercept - 2.0).max() < 1e-6
    assert regress(np.column_stack([Z, Z[:, 1]]), Z @ K, True, 1e-13)[2] == 4


def test_refusals():
    with pytest.raises(ParameterError, match="difference"):
        PCR(difference="sideways")
    rng = np.random.default_rng(0)
    with pytest.raises(DataError, match="LeastSquares"):
        PCR().fit(state_data([rng.standard_normal((9, 4))]), 2)
    data = one_step_data()
    for bad in (0, -1, 2.5, True):
        with pytest.raises(ParameterError, match="order"):
            reduce(data, order=bad)
    with pytest.raises(RankError, match="14"):
        reduce(data, order=15)


def user_arrays():
    return np.random.default_rng(3).standard_normal((12, 4))


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"x": float("nan")}, DataError, "x of run 1 holds NaN"),
        ({"eta": float("inf")}, DataError, "eta of run 1 holds NaN or inf"),
        ({"u": float("nan")}, DataError, "u of run 1"),
        ({"commands": float("nan")}, DataError, "commands of run 1"),
    ],
)
def test_nan_in_any_array_is_refused_by_name(change, error, words):
    data = one_step_data(commands=True)
    (name, value), run = next(iter(change.items())), data.runs[1]
    broken = np.array(getattr(run, name))
    broken[3, 0] = value
    runs = (data.runs[0], dataclasses.replace(run, **{name: broken}), data.runs[2])
    with pytest.raises(error, match=words):
        dataclasses.replace(data, runs=runs)


def test_user_data_refusals():
    x = user_arrays()
    with pytest.raises(ParameterError, match="dt is missing"):
        snapshots([x])
    with pytest.raises(DataError, match="at least one run"):
        snapshots([])
    with pytest.raises(ParameterError, match="dt"):
        snapshots([x], dt=0.0)
    with pytest.raises(ParameterError, match="scale"):
        snapshots([x], dt=1.0, scale="blok")
    with pytest.raises(DimensionError, match="exactly once"):
        snapshots([x], dt=1.0, blocks={"component": range(3)})
    with pytest.raises(DimensionError, match="columns"):
        snapshots([x, x[:, :3]], dt=1.0)
    with pytest.raises(DataError, match="too short"):
        snapshots([x[:1]], dt=1.0)
    with pytest.raises(DimensionError):
        snapshots([x[:, 0]], dt=1.0)
    with pytest.raises(ParameterError, match="numbers"):
        snapshots([[["a", "b"]]], dt=1.0)


def test_a_coarse_model_is_rolled_out_between_its_steps():
    """Mean commands a step, linear in between; the last, shorter step has the mean of what is."""
    model = LatentModel(A=[[-0.1]], B=[[1.0]], dt=3.0)
    c = np.array([[1.0], [2.0], [6.0], [-1.0], [-3.0]])
    z = predict_samples(model, np.array([2.0]), c, 1.0, 6)[:, 0]
    first = 2.0 + 3.0 * (-0.2 + 3.0)
    second = first + 3.0 * (-0.1 * first - 2.0)
    expected = [2.0, 2 + (first - 2) / 3, 2 + 2 * (first - 2) / 3, first]
    expected += [first + (second - first) / 3, first + 2 * (second - first) / 3]
    assert np.allclose(z, expected, rtol=1e-14)
    assert predict_samples(model, np.array([2.0]), None, 1.0, 1).tolist() == [[2.0]]
    with pytest.raises(ParameterError, match="grid"):
        predict_samples(model, np.array([2.0]), None, 2.0, 4)


def test_recorded_headings_too_large_to_be_squared_are_refused():
    """Found by the fuzz of run files: a heading of 1e200 overflowed instead."""
    from cellsys.samples.commands import command_features

    p = np.array([[[1.0, 0.0, 0.0]], [[1e200, 0.0, 0.0]]])
    with pytest.raises(DataError, match="polarity of a run"):
        command_features(p, None)
    with pytest.raises(DataError, match="amplitude of a run"):
        command_features(p[:1], np.array([[np.inf]]))
