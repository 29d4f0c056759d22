"""The basis: orthonormal, streamed as exact, ranks refused, constant columns kept apart, units."""

import dataclasses
import sys

import numpy as np
import pytest
import scipy.linalg as sla
import scipy.sparse as sp

from cellsys.errors import ParameterError, RankError
from cellsys.reduction import PCR, ExactSVD, LeastSquares, RandomisedSVD, fit_basis, reduce
from cellsys.reduction.basis import moments
from cellsys.samples import snapshots
from tests.reduction.systems import linear_runs, one_step_data, stable_matrix, state_data


def decaying(T=300, n=60, seed=0, rate=0.7):
    """Samples with singular values that fall as rate^k."""
    rng = np.random.default_rng(seed)
    U = sla.qr(rng.standard_normal((T, n)), mode="economic")[0]
    W = sla.qr(rng.standard_normal((n, n)))[0]
    return 1e3 * U * rate ** np.arange(n) @ W.T + rng.standard_normal(n)


@pytest.mark.parametrize("method", [ExactSVD(), RandomisedSVD()])
@pytest.mark.parametrize("scale", ["none", "block", "column"])
@pytest.mark.parametrize("center", [True, False])
def test_basis_is_orthonormal(method, scale, center):
    data = one_step_data(T=200, scale=scale)
    V = fit_basis(data, 7, center=center, method=method).V
    # rounding of a QR and an SVD of 7 columns
    assert np.abs(V.T @ V - np.eye(7)).max() < 1e-12


@pytest.mark.parametrize("scale", ["none", "column"])
def test_streamed_randomised_svd_is_the_exact_one(scale):
    data = state_data([decaying(), decaying(seed=1)], scale=scale)
    order = 12
    exact = fit_basis(data, order, method=ExactSVD())
    streamed = fit_basis(data, order, method=RandomisedSVD(power=2))
    # power = 2 and 20 extra directions: the tail is damped by (s_33/s_12)^5 < 1e-15 per angle,
    # the rest is rounding over the gap s_12 - s_13 (0.3 s_12)
    assert np.sin(sla.subspace_angles(exact.V, streamed.V).max()) < 1e-7
    assert np.abs(streamed.singular_values / exact.singular_values - 1).max() < 1e-10
    assert abs(streamed.total / exact.total - 1) < 1e-12
    assert np.array_equal(streamed.V, fit_basis(data, order, method=RandomisedSVD(power=2)).V)
    # the default may iterate less: one power less costs (s_33/s_12)^2 = 4e7 in the angle at most
    quick = fit_basis(data, order, method=RandomisedSVD())
    assert np.sin(sla.subspace_angles(exact.V, quick.V).max()) < 1e-3
    assert np.abs(quick.singular_values / exact.singular_values - 1).max() < 1e-6


def latent_samples(data, basis):
    """Z (n_samples, m): latent coordinates of the used samples."""
    weight = basis.inverse_scale()[:, None] * basis.V
    return np.concatenate([piece @ weight for piece in data.pieces(0, basis.mean)])


@pytest.mark.parametrize("method", [ExactSVD(), RandomisedSVD()])
@pytest.mark.parametrize("rows", [1, 7, 10_000])
def test_blocks_of_rows_do_not_matter(method, rows, monkeypatch):
    data = one_step_data(T=150)
    model = PCR(svd=method).fit(data, 5)
    Z = latent_samples(data, fit_basis(data, 5, method=method))
    monkeypatch.setattr(sys.modules["cellsys.samples.snapshots"], "ROWS", rows)
    again = PCR(svd=method).fit(data, 5)
    # sums in another order: rounding, amplified by the regression
    assert np.abs(again.singular_values / model.singular_values - 1).max() < 1e-11
    assert np.abs(again.V @ again.V.T - model.V @ model.V.T).max() < 1e-10
    distance = np.abs(again.poles()[:, None] - model.poles()[None])
    assert distance.min(axis=1).max() < 1e-8
    assert (
        np.abs(np.abs(latent_samples(data, fit_basis(data, 5, method=method))) - abs(Z)).max()
        < 1e-9
    )


def test_memory_mapped_runs_give_the_same_model(tmp_path):
    data = one_step_data(T=200)
    runs = []
    for i, run in enumerate(data.runs):
        kept = {}
        for name in ("x", "eta", "u"):
            np.save(tmp_path / f"{name}{i}.npy", getattr(run, name))
            kept[name] = np.load(tmp_path / f"{name}{i}.npy", mmap_mode="r")
        runs.append(dataclasses.replace(run, **kept))
    mapped = PCR().fit(dataclasses.replace(data, runs=tuple(runs)), 5)
    assert np.array_equal(mapped.A, PCR().fit(data, 5).A)


def test_moments_keep_their_digits_on_a_large_constant_part():
    rng = np.random.default_rng(0)
    x = rng.standard_normal((500, 4))
    mean, variance = moments(state_data([x + 1e8]))
    used = x[:-1]
    # the samples themselves carry 1e8 * 2^-53 = 1e-8 of rounding
    assert np.abs(variance / used.var(axis=0) - 1).max() < 1e-6
    assert np.abs(mean - 1e8 - used.mean(axis=0)).max() < 3e-8


@pytest.mark.parametrize("scale", ["none", "block", "column"])
def test_constant_columns_are_dropped_and_restored(scale):
    rng = np.random.default_rng(2)
    A, dt = stable_matrix(4, rng), 0.1
    free = [x for x, _ in linear_runs(A, np.zeros((4, 0)), np.zeros(4), dt, rng)]
    full = []
    for x in free:
        wide = np.full((len(x), 7), [0.1, 0, 0, 1e9, 0, 0, -3.0])
        wide[:, [1, 2, 4, 5]] = x
        full.append(wide)
    data = state_data(full, dt, scale)
    model = reduce(data, order=4, method=LeastSquares())
    assert model.notes["dropped_columns"] == 3
    assert np.flatnonzero(model.scale == 0).tolist() == [0, 3, 6]
    back = model.reconstruct(model.encode(full[0]))
    # constants come back bit for bit, the others to rounding of a full basis
    assert np.array_equal(back[:, [0, 3, 6]], full[0][:, [0, 3, 6]])
    assert np.abs(back - full[0]).max() < 1e-12 * 1e2
    exact = np.sort_complex(np.linalg.eigvals(A))
    assert np.abs(np.sort_complex(model.poles()) - exact).max() < 1e-9


def test_scale_factors():
    data = one_step_data(T=100)
    used = np.concatenate([np.hstack([r.x[:-1], r.eta])[:-1] for r in data.runs])
    variance = used.var(axis=0)
    none, column, block = (
        fit_basis(dataclasses.replace(data, scale=s), 1).scale for s in ("none", "column", "block")
    )
    assert np.all(none == 1.0)
    assert np.abs(column / np.sqrt(variance) - 1).max() < 1e-12
    for group in ([0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10], [11, 12, 13]):
        assert np.abs(block[group] / np.sqrt(variance[group].sum()) - 1).max() < 1e-12


@pytest.mark.parametrize("factor", [1e6, 1e-6, 1e12])
def test_units_do_not_move_poles_under_block_scaling(factor):
    """Positions in m instead of um (1e-6), or stranger: one factor per block takes it out."""
    data = one_step_data(T=80)
    n = data.states.size
    runs = tuple(
        dataclasses.replace(r, x=factor * r.x, u=factor * r.u, eta_start=None) for r in data.runs
    )
    changed = dataclasses.replace(data, runs=runs, W_eta=sp.csr_array(factor * data.W_eta))
    a, b = (np.sort_complex(PCR().fit(d, 6).poles()) for d in (data, changed))
    assert np.abs(a - b).max() < 1e-8 * np.abs(a).max()
    # without scaling they do move
    a, b = (
        np.sort_complex(PCR().fit(dataclasses.replace(d, scale="none"), 6).poles())
        for d in (data, changed)
    )
    assert np.abs(a - b).max() > 1e-3 * np.abs(a).max()
    assert n == 8


def test_states_in_si_units_beside_large_rates_are_not_taken_for_constants():
    """A displacement of 1e-9 m beside a stress of 1e7 Pa varies; nothing is dropped."""
    data = one_step_data(T=80)
    runs = tuple(
        dataclasses.replace(r, x=1e-9 * r.x, u=1e-9 * r.u, eta=1e7 * r.eta, eta_start=None)
        for r in data.runs
    )
    si = dataclasses.replace(data, runs=runs, W_eta=sp.csr_array(1e-16 * data.W_eta))
    basis = fit_basis(si, 6)
    assert basis.dropped == 0
    a, b = (np.sort_complex(PCR().fit(d, 6).poles()) for d in (data, si))
    assert np.abs(a - b).max() < 1e-8 * np.abs(a).max()


@pytest.mark.parametrize("method", [ExactSVD(), RandomisedSVD()])
def test_order_beyond_the_rank_is_refused_with_the_rank(method):
    rng = np.random.default_rng(0)
    low = rng.standard_normal((80, 5)) @ rng.standard_normal((5, 30))
    data = state_data([low, rng.standard_normal((40, 5)) @ np.linalg.qr(low.T)[0][:, :5].T])
    with pytest.raises(RankError, match=r"numerical rank 5\b"):
        fit_basis(data, 6, method=method)
    assert fit_basis(data, 5, method=method).V.shape == (30, 5)


def test_duplicated_columns_count_once():
    rng = np.random.default_rng(1)
    x = rng.standard_normal((50, 6))
    data = state_data([np.hstack([x, x, 3 * x])])
    with pytest.raises(RankError, match=r"numerical rank 6\b"):
        fit_basis(data, 7)


def test_order_beyond_the_samples_is_refused():
    rng = np.random.default_rng(2)
    data = state_data([rng.standard_normal((5, 30)), rng.standard_normal((4, 30))])
    with pytest.raises(RankError, match="7 samples of 30 columns span at most 6"):
        fit_basis(data, 7)
    assert fit_basis(data, 6).V.shape[1] == 6


def test_data_that_never_move_are_refused():
    with pytest.raises(RankError):
        fit_basis(state_data([np.full((20, 4), 0.3)]), 1)


@pytest.mark.parametrize("order", [0, -3, 1.5, True, float("nan"), float("inf")])
def test_order_must_be_a_whole_number(order):
    with pytest.raises(ParameterError, match="order"):
        fit_basis(one_step_data(), order)


def test_randomised_svd_refuses_its_parameters():
    with pytest.raises(ParameterError):
        RandomisedSVD(oversample=0)
    with pytest.raises(ParameterError):
        RandomisedSVD(power=-1)


def test_blocks_of_user_arrays_are_put_in_order():
    rng = np.random.default_rng(3)
    x = rng.standard_normal((60, 6)).cumsum(axis=0)
    data = snapshots([x], dt=1.0, blocks={"field": [0, 2, 4], "component": [1, 3, 5]})
    assert np.array_equal(data.runs[0].x, x[:, [0, 2, 4, 1, 3, 5]])
    model = reduce(data, order=3, method=LeastSquares())
    assert model.blocks["field"].tolist() == [0, 1, 2]
    assert model.blocks["component"].tolist() == [3, 4, 5]


@pytest.mark.parametrize("power", [0, 1, 2])
def test_error_bounds_of_a_streamed_basis_hold(power):
    """Slowly falling singular values (i^-1.4): bounds against the exact basis."""
    rng = np.random.default_rng(0)
    U = np.linalg.qr(rng.standard_normal((900, 300)))[0]
    W = np.linalg.qr(rng.standard_normal((400, 300)))[0]
    X = 1e3 * U * np.arange(1.0, 301.0) ** -1.4 @ W.T + rng.standard_normal(400)
    data = state_data([X[:450], X[450:]], scale="none")
    exact = fit_basis(data, 60, method=ExactSVD())
    basis = fit_basis(data, 60, method=RandomisedSVD(power=power))
    assert exact.residuals is None
    assert exact.angle_bound(5) == 0.0
    # nothing but rounding between bound and truth where the bound is rounding itself
    rounding = 1e-12 * exact.singular_values[0]
    for s, r in zip(basis.singular_values, basis.residuals, strict=True):
        assert np.abs(exact.singular_values - s).min() <= r + rounding
    gone = np.concatenate([p.copy() for p in data.pieces(shift=basis.mean)])
    missed = np.linalg.norm(gone - gone @ basis.V @ basis.V.T) / np.linalg.norm(gone)
    assert basis.left_out == pytest.approx(missed, rel=1e-9)
    assert basis.left_out >= exact.left_out * (1 - 1e-9)
    for count in (3, 10, 20):
        V, W = basis.V[:, :count], exact.V[:, :count]
        # the sine itself, by what V leaves of W: small angles keep their digits
        angle = np.linalg.norm(W - V @ (V.T @ W), 2)
        assert angle <= basis.angle_bound(count) + 1e-12
    if power == 2:
        assert angle < 1e-6  # the first 20 directions, as asked of large sets
    if power == 0:
        assert angle > 1e-4  # a start alone is not enough
    with pytest.raises(ParameterError, match="count"):
        basis.angle_bound(60)


def test_a_streamed_basis_reads_the_data_power_plus_three_times(monkeypatch):
    """Once for the moments, once for the start, once for each product."""
    data = state_data([decaying(), decaying(seed=1)], scale="none")
    passes = []
    pieces = type(data).pieces

    def counted(self, ahead=0, shift=None):
        if shift is not None:  # the first row alone is looked at without one
            passes.append(ahead)
        return pieces(self, ahead, shift)

    monkeypatch.setattr(type(data), "pieces", counted)
    fit_basis(data, 5, method=RandomisedSVD(power=2))
    assert len(passes) == 5
