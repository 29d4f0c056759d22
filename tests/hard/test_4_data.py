"""Data: collinear, repeated, constant, too few, far apart, interrupted, unequal, wild, missing."""

import dataclasses

import mpmath as mp
import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.errors import CellsysError, DataError, ParameterError, RankError
from cellsys.reduction import PCR, LeastSquares, RandomisedSVD, Ridge, fit_basis, reduce
from cellsys.samples import snapshots
from tests import naive
from tests.hard.stress import SEED, Case, Choice, Int, Power, hold
from tests.population.systems import match
from tests.reduction.systems import ar1_data, linear_runs, one_step_data, stable_matrix, state_data


def hilbert_like(n, rows, seed):
    """Rows of 1/(i + j + 1) turned by a rotation: condition 1e12 at n = 9."""
    i, j = np.indices((rows, n))
    Q = sla.qr(np.random.default_rng(seed).standard_normal((n, n)))[0]
    return (1.0 / (i + j + 1)) @ Q


def exact_directions(X, order):
    """Leading right singular vectors and values of the centred rows of X, at 50 digits."""
    with mp.workdps(50):
        M = mp.matrix(X.tolist())
        for j in range(M.cols):
            mean = sum(M[i, j] for i in range(M.rows)) / M.rows
            for i in range(M.rows):
                M[i, j] -= mean
        _, s, Vt = mp.svd_r(M)
        V = np.array([[float(Vt[k, j]) for j in range(M.cols)] for k in range(order)]).T
        return V, np.array([float(v) for v in s])


def ill_conditioned_data_keep_their_basis(n, order, seed, method):
    """Orthogonality, singular values and angles against 50 digits."""
    order = min(order, n - 1)
    X = hilbert_like(n, n + 4, seed)
    data = state_data([X], scale="none")
    used = X[:-1]  # the last sample has no next one
    V, s = exact_directions(used, order)
    found = fit_basis(data, order, center=True, method=method)
    # an SVD errs by a few units of rounding of the first singular value, at every order
    eps = 1e-15 * n * s[0]
    assert np.abs(found.V.T @ found.V - np.eye(order)).max() < 1e-12
    assert np.abs(found.singular_values[:order] - s[:order]).max() < 10 * eps
    gap = s[order - 1] - s[order]
    angle = np.sin(sla.subspace_angles(found.V, V)).max()
    # Wedin: rounding over the gap
    assert angle < 20 * eps / gap


def test_the_covariance_squares_the_condition():
    X = hilbert_like(10, 14, 0)
    V, s = exact_directions(X[:-1], 8)
    ours = fit_basis(state_data([X], scale="none"), 8, center=True)
    assert s[0] / s[7] > 1e8
    assert np.sin(sla.subspace_angles(ours.V, V)).max() < 1e-3
    lost = naive.covariance_basis(X[:-1], 8)
    assert np.sin(sla.subspace_angles(lost, V)).max() > 0.5


def poles_survive_columns_far_apart(seed, spread, method):
    """Columns up to 1e12 apart (um beside pN, nm beside m): scaled by column, the same poles."""
    rng = np.random.default_rng(seed)
    A = stable_matrix(4, rng)
    runs = [x for x, _ in linear_runs(A, np.zeros((4, 0)), np.zeros(4), 0.1, rng)]
    T = 10.0 ** rng.uniform(-np.log10(spread), np.log10(spread), 4)
    data = state_data([x * T for x in runs], scale="column")
    model = reduce(data, order=4, method=method)
    tol = 1e-2 if isinstance(method, Ridge) else 1e-7
    # exact data: rounding times the condition of the regression, below 1e6 for these systems
    assert match(model.poles(), np.linalg.eigvals(A)) < tol * np.abs(np.linalg.eigvals(A)).max()


def test_units_far_apart_break_the_normal_equations():
    rng = np.random.default_rng(0)
    A, T = stable_matrix(4, rng), np.array([1e-9, 1e-3, 1e3, 1e9])
    runs = [x * T for x, _ in linear_runs(A, np.zeros((4, 0)), np.zeros(4), 0.1, rng)]
    found = reduce(state_data(runs, scale="column"), order=4, method=LeastSquares()).poles()
    assert match(found, np.linalg.eigvals(A)) < 1e-9
    assert match(naive.normal_equation_poles(runs, 0.1), np.linalg.eigvals(A)) > 0.1


DAMAGE = ("duplicate", "constant", "collinear", "zero")


def a_rank_is_found_and_not_exceeded(seed, damage, columns, method):
    """Columns that add nothing: the same rank, the rank works, one more is refused."""
    rng = np.random.default_rng(seed)
    A = stable_matrix(4, rng)
    runs = [x for x, _ in linear_runs(A, np.zeros((4, 0)), np.zeros(4), 0.1, rng)]
    M = rng.standard_normal((4, columns))

    def widened(x):
        extra = {
            "duplicate": np.repeat(x[:, :1], columns, axis=1),
            "constant": np.full((len(x), columns), 0.1),
            "collinear": x @ M,
            "zero": np.zeros((len(x), columns)),
        }[damage]
        return np.column_stack([x, extra])

    data = state_data([widened(x) for x in runs])
    model = reduce(data, order=4, method=method)
    assert match(model.poles(), np.linalg.eigvals(A)) < 1e-6
    with pytest.raises(RankError, match="numerical rank 4"):
        reduce(data, order=5, method=method)
    back = model.reconstruct(model.encode(widened(runs[0])[3]))
    assert np.abs(back - widened(runs[0])[3]).max() < 1e-8


def test_columns_that_add_nothing():
    a_rank_is_found_and_not_exceeded(0, "duplicate", 3, LeastSquares())
    rng = np.random.default_rng(0)
    A = stable_matrix(4, rng)
    runs = [x for x, _ in linear_runs(A, np.zeros((4, 0)), np.zeros(4), 0.1, rng)]
    wide = [np.column_stack([x, np.repeat(x[:, :1], 3, axis=1)]) for x in runs]
    # naive: seven poles of four, three of them logarithms of rounding
    found = naive.normal_equation_poles(wide, 0.1)
    assert len(found) == 7
    assert not match(found, np.concatenate([np.linalg.eigvals(A), np.zeros(3)])) < 10.0


@pytest.mark.parametrize("T", [1, 2, 3])
def test_too_few_samples_are_refused_with_their_number(T):
    x = np.random.default_rng(0).standard_normal((T, 6))
    with pytest.raises(CellsysError):
        reduce(snapshots([x], dt=1.0), order=5)
    if T == 3:
        # naive: two pairs determine nothing of 25 numbers, and lstsq does not mind
        assert naive.fitted_without_a_look(x).shape == (6, 6)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["x", "eta", "u"])
def test_what_is_missing_is_refused_by_name(name, value):
    data = one_step_data()
    bad = np.array(getattr(data.runs[1], name))
    bad[7, 2] = value
    run = dataclasses.replace(data.runs[1], **{name: bad})
    with pytest.raises(DataError, match="NaN or inf"):
        reduce(dataclasses.replace(data, runs=(data.runs[0], run)), order=3)


def test_what_is_missing_spreads():
    X = np.random.default_rng(0).standard_normal((20, 4))
    X[7, 2] = np.nan
    # naive: the covariance of columns, one NaN in which is four
    with np.errstate(all="ignore"), pytest.raises(np.linalg.LinAlgError):
        naive.normal_equation_poles([X], 0.1)


def test_squares_of_an_outlier():
    with pytest.raises(DataError, match="more than 1e100"):
        outliers_give_finite_models(0, 1e200, PCR())
    X = np.random.default_rng(0).standard_normal((20, 4))
    X[7, 2] *= 1e200
    # naive: a scale by the root of the mean square, which is beyond doubles where the data are not
    with np.errstate(over="ignore"):
        assert not np.isfinite(naive.scale_by_squares(X)).all()


def outliers_give_finite_models(seed, size, method):
    """One wild sample: a finite model, or a refusal; never NaN, never an overflow."""
    data = one_step_data(seed=seed % 50)
    rng = np.random.default_rng(seed)
    bad = np.array(data.runs[0].x)
    bad[int(rng.integers(len(bad))), int(rng.integers(bad.shape[1]))] *= size
    runs = (dataclasses.replace(data.runs[0], x=bad), *data.runs[1:])
    model = reduce(dataclasses.replace(data, runs=runs), order=4, method=method)
    assert np.all(np.isfinite(model.A))
    assert np.all(np.isfinite(model.V.T @ model.V))
    assert np.abs(model.V.T @ model.V - np.eye(4)).max() < 1e-10


def runs_of_any_length_are_not_glued(seed, lengths):
    """Runs of 3 to 60 samples: exact poles; glued into one, their seams would be dynamics."""
    rng = np.random.default_rng(seed)
    A = stable_matrix(3, rng)
    runs = [
        linear_runs(A, np.zeros((3, 0)), np.zeros(3), 0.1, rng, runs=1, T=int(T))[0][0]
        for T in rng.integers(3, 61, lengths)
    ]
    exact = np.sort_complex(np.linalg.eigvals(A))
    found = reduce(state_data(runs), order=3, method=LeastSquares())
    assert match(found.poles(), exact) < 1e-6
    assert naive.pole_error_of_one_long_run(runs, 0.1, exact) > 1e-3


def test_an_event_inside_a_run_is_not_differenced_across():
    """A jump of 5 um at sample 30, logged: the pair that holds it is left out."""
    rng = np.random.default_rng(3)
    A = stable_matrix(3, rng)
    (x, _), (y, _) = linear_runs(A, np.zeros((3, 0)), np.zeros(3), 0.1, rng, runs=2, T=40)
    jumped = np.concatenate([x[:30], y[:30]])
    exact = np.linalg.eigvals(A)
    data = state_data([jumped], skip=(29,))
    assert match(reduce(data, order=3, method=LeastSquares()).poles(), exact) < 1e-6
    blind = reduce(state_data([jumped]), order=3, method=LeastSquares())
    assert match(blind.poles(), exact) > 1e-3


def test_the_sign_of_damping_under_noise():
    """A rate kept alive by noise, correlation rho: forward -(1 - rho)/dt; backward flips it."""
    data = ar1_data(rho=0.5, N=20_000, dt=0.1)
    eta = np.asarray(data.runs[0].eta)[:, 0]
    model = reduce(data, order=2, method=PCR())
    # the slower pole is the integrator of position; standard error sqrt(1 - rho^2)/sqrt(N)/dt
    assert min(model.poles().real) < -3.0
    assert naive.backward_slope(eta, 0.1) == pytest.approx(5.0, abs=0.3)


CASES = (
    Case(
        "ill-conditioned basis",
        ill_conditioned_data_keep_their_basis,
        {"n": Int(3, 9), "order": Int(1, 8), "method": Choice(None), "seed": SEED},
    ),
    Case(
        "columns far apart",
        poles_survive_columns_far_apart,
        {"spread": Power(0, 12), "method": Choice(LeastSquares()), "seed": SEED},
    ),
    Case(
        "columns that add nothing",
        a_rank_is_found_and_not_exceeded,
        {
            "damage": Choice(*DAMAGE),
            "columns": Int(1, 6),
            "method": Choice(LeastSquares(), LeastSquares(svd=RandomisedSVD())),
            "seed": SEED,
        },
    ),
    Case(
        "outliers",
        outliers_give_finite_models,
        {
            "size": Power(0, 300),
            "method": Choice(PCR(), LeastSquares(), Ridge(ridge=1e-3)),
            "seed": SEED,
        },
    ),
    Case("unequal runs", runs_of_any_length_are_not_glued, {"lengths": Int(3, 8), "seed": SEED}),
)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_random_instances(case):
    hold(case, 5)


@pytest.mark.parametrize("value", ["PCR", 3, PCR, object()])
def test_methods_data_and_numbers_that_are_none(value):
    data = one_step_data()
    with pytest.raises(ParameterError, match="method must be a reductor"):
        reduce(data, order=2, method=value)
    with pytest.raises(ParameterError, match=r"data must be a Snapshots, made by cs.snapshots"):
        reduce(value, order=2)
    X = np.random.default_rng(0).standard_normal((30, 4))
    for bad in (X + 0j, X.astype(str), [[1, 2], [3]]):
        with pytest.raises(CellsysError):
            snapshots([bad], dt=1.0)
    for dt in ("a", 1j, [1.0], 0.0, np.nan):
        with pytest.raises(CellsysError, match="dt"):
            snapshots([X], dt=dt)
    for tol in ("a", [0.1], np.nan, 2.0):
        with pytest.raises(CellsysError, match="tol"):
            reduce(data, tol=tol)
    for ridge in ("a", None, 1j, 1e308, -1.0):
        with pytest.raises(CellsysError, match="ridge must be"):
            Ridge(ridge=ridge)
    with pytest.raises(ParameterError, match="scale must be"):
        snapshots([X], dt=1.0, scale=np.ones(4))


def test_options_of_methods_are_checked():
    with pytest.raises(ParameterError):
        Ridge(ridge=-1.0)
