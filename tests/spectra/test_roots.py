"""Poles, zeros and damping: results, filters, clusters, behaviour as an array."""

from __future__ import annotations

import copy
import pickle
import warnings
from collections.abc import Iterator
from typing import Any

import control as ct
import numpy as np
import pytest
import scipy.linalg as sla
import scipy.signal
from scipy.optimize import linear_sum_assignment

from cellsys.errors import ParameterError
from cellsys.response import margins
from cellsys.spectra import damping, poles, zeros
from tests import naive
from tests.response import gallery


def apart(one: np.ndarray, two: np.ndarray) -> float:
    """Largest distance after the best assignment."""
    cost = np.abs(np.asarray(one)[:, None] - np.asarray(two)[None])
    assert cost.shape[0] == cost.shape[1]
    return float(cost[linear_sum_assignment(cost)].max(initial=0.0))


def test_poles_behave_as_a_plain_array() -> None:
    found = poles(np.diag([-3.0, -1.0, -2.0]))
    assert isinstance(found, np.ndarray)
    assert np.asarray(found).dtype == complex
    assert len(found) == 3
    assert list(found) == [-1, -2, -3]
    assert found[0] == -1
    assert type(found[:2]) is np.ndarray
    assert type(found * 2) is np.ndarray
    assert found.real.max() == -1
    assert np.max(found.real) == -1
    assert np.sort(found)[0] == -3
    assert found.error_bound.shape == found.condition.shape == (3,)
    with pytest.raises(ValueError, match="read-only"):
        found[0] = 1
    with pytest.raises(AttributeError, match="use the whole"):
        _ = found.view().condition
    for again in (pickle.loads(pickle.dumps(found)), copy.deepcopy(found)):
        np.testing.assert_array_equal(again.error_bound, found.error_bound)


def test_lazy_details_keep_the_order() -> None:
    A = gallery.random_stable(40, 1, 1, seed=0)[0]
    found = poles(A)
    # First-order perturbation theory, checked by a finite change: |d lambda| <= cond |dA|.
    rng = np.random.default_rng(0)
    E = rng.standard_normal(A.shape)
    E *= 1e-7 / np.linalg.norm(E, 2)
    moved = np.abs(np.asarray(found)[:, None] - sla.eigvals(A + E)[None]).min(axis=1)
    assert np.all(moved <= 1.1 * found.condition * 1e-7 + 1e-12)


@pytest.mark.parametrize("copies", [2, 5, 50])
def test_copies_of_a_pole_are_one_cluster(copies: int) -> None:
    block = np.array([[-1.0, 2.0, 0], [-2, -1, 1], [0, 0, -4]])
    Q = sla.qr(np.random.default_rng(copies).standard_normal((3 * copies,) * 2))[0]
    found = poles(Q.T @ np.kron(np.eye(copies), block) @ Q)
    assert set(found.cluster_size.tolist()) == {copies}
    assert len(np.unique(found.cluster)) == 3
    assert found.error_bound.max() < 1e-9  # semisimple: no loss of digits


def test_zeros_of_known_systems() -> None:
    s = ct.tf("s")
    found = zeros(ct.ss((s + 2) * (s - 3) / ((s + 1) ** 3 * (s**2 + 0.1 * s + 4))))
    assert apart(found, np.array([3, -2])) < 1e-10
    assert len(zeros(gallery.lag_chain(100, 0.5))) == 0
    assert len(zeros(gallery.integrators(21))) == 0
    assert len(zeros(gallery.rod(30))) == 0


@pytest.mark.parametrize(("m", "p"), [(1, 1), (2, 2), (3, 3)])
def test_square_zeros_agree_with_python_control(m: int, p: int) -> None:
    for seed in range(5):
        A, B, C, D = gallery.random_stable(9, m, p, seed)
        D = np.eye(p) * (seed % 2)
        assert apart(zeros((A, B, C, D)), ct.zeros(ct.ss(A, B, C, D, 0))) < 1e-7


def test_zeros_with_and_without_slycot() -> None:
    slycot = pytest.importorskip("slycot")
    for seed, (n, m, p) in enumerate([(8, 1, 1), (8, 2, 2), (9, 3, 2), (9, 2, 3), (20, 1, 1)]):
        A, B, C, D = gallery.random_stable(n, m, p, seed)
        B[:, 0] = np.eye(n)[0]  # some structure
        nu, *_, Af, Bf = slycot.ab08nd(n, m, p, A, B, C, D)
        truth = sla.eigvals(Af[:nu, :nu], Bf[:nu, :nu])
        found = zeros((A, B, C, D))
        assert apart(found, truth) <= 10 * max(found.error_bound.max(initial=1e-12), 1e-10)


def test_rank_one_copies_have_the_zeros_of_the_scalar() -> None:
    # Two equal outputs: normal rank 1, the zeros are those of one output.
    A, B, C, D = gallery.random_stable(7, 1, 1, seed=5)
    single = zeros((A, B, C, D))
    double = zeros((A, B, np.vstack([C, C]), np.vstack([D, D])))
    assert apart(single, double) < 1e-9
    square = zeros((A, np.hstack([B, B]), np.vstack([C, C]), np.zeros((2, 2))))
    assert apart(single, square) < 1e-8


def test_naive_pencil_shows_infinite_zeros_as_finite() -> None:
    A, B, C, D = gallery.mass_spring(20, damping=0.0)
    found = zeros((A, B, C, D))
    assert len(found) == 1  # the velocity output: one zero at the origin
    assert abs(found[0]) < 1e-10
    assert "infinite beyond" in found.note
    # Eight lags turned by an orthogonal matrix: no zeros; the pencil finds nine at eps^(-1/9).
    A, B, C, D = gallery.lag_chain(8, 1.0)
    Q = sla.qr(np.random.default_rng(0).standard_normal((8, 8)))[0]
    assert len(zeros((Q.T @ A @ Q, Q.T @ B, C @ Q, D))) == 0
    assert len(naive.pencil_zeros(Q.T @ A @ Q, Q.T @ B, C @ Q, np.asarray(D))) > 0


def test_poles_and_zeros_do_not_depend_on_units() -> None:
    plain = gallery.random_stable(6, 1, 1, seed=2)
    T = 2.0 ** np.array([-200, 100, 0, 60, -30, 266])
    A, B, C, D = plain
    scaled = (A * T[:, None] / T, B * T[:, None], C / T, D)
    for roots in (poles, zeros):
        one, two = roots(plain), roots(scaled)
        assert apart(one, two) <= 2 * one.error_bound.max()


def test_degenerate_sizes() -> None:
    for system in (
        (np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))),
        (-np.eye(2), np.zeros((2, 0)), np.ones((1, 2)), np.zeros((1, 0))),
    ):
        assert len(zeros(system)) == 0
        assert len(poles(system)) == len(system[0])
        assert len(damping(system)) == len(system[0])
        assert str(damping(system))
    assert poles(np.array([[-2.0]]))[0] == -2
    with pytest.raises(ParameterError, match="rank_tol"):
        zeros(gallery.mass_spring(2), rank_tol=-1.0)
    s = ct.tf("s")
    row = ct.combine_tf([[1 / s, 1 / (s + 1)]])
    with pytest.raises(ParameterError, match="several channels"):
        poles(row)


def test_damping_table() -> None:
    # Continuous: (s^2 + 2 zeta w s + w^2)(s + 4) s, and the same sampled.
    zeta, w = 0.1, 3.0
    A = sla.block_diag([[0, 1], [-(w**2), -2 * zeta * w]], [[-4.0]], [[0.0]])
    table = damping(A)
    pair = np.abs(table.poles.imag) > 0
    np.testing.assert_allclose(table.frequency[pair], w, rtol=1e-12)
    np.testing.assert_allclose(table.damping[pair], zeta, rtol=1e-12)
    np.testing.assert_allclose(table.time_constant[pair], 1 / (zeta * w), rtol=1e-12)
    assert table.damping[np.asarray(table.poles) == -4] == 1
    assert np.isnan(table.damping[np.asarray(table.poles) == 0])
    assert np.isinf(table.time_constant[np.asarray(table.poles) == 0])
    h = 0.1
    n = len(A)
    sampled = damping((sla.expm(A * h), np.zeros((n, 0)), np.zeros((0, n)), np.zeros((0, 0)), h))
    pair = np.abs(sampled.poles.imag) > 0
    np.testing.assert_allclose(sampled.frequency[pair], w, rtol=1e-10)
    np.testing.assert_allclose(sampled.damping[pair], zeta, rtol=1e-10)
    gone = damping((np.zeros((1, 1)), np.zeros((1, 0)), np.zeros((0, 1)), np.zeros((0, 0)), h))
    assert gone.time_constant[0] == 0
    assert "cond" in str(table)


def test_published_systems_keep_their_known_poles() -> None:
    # BD01AD 2.1: one pole 0 and a fast one at -1/eps; BD01AD 3.1: -1 and 0 with known counts;
    # BD02AD 2.1: 1 - 1/delta and a triple 0.
    found = poles(gallery.tape(1e-6))
    assert np.abs(np.asarray(found) + 1e6).min() < 1e-3
    assert np.abs(np.asarray(found)).min() <= found.error_bound.max()
    found = poles(gallery.vehicles(20))
    assert np.count_nonzero(np.abs(np.asarray(found) + 1) < 1e-6) == 20
    assert np.count_nonzero(np.abs(np.asarray(found)) < 1e-6) == 19
    found = poles(gallery.paper_machine())
    assert np.abs(np.asarray(found) - (1 - 1e-8)).min() < 1e-15
    # Rod: -4 (n + 1) sin^2(...), half-free chain.
    n = 30
    k = np.arange(n)
    truth = -4 * (n + 1) * np.sin((2 * k + 1) * np.pi / (2 * (2 * n + 1))) ** 2
    found = poles(gallery.rod(n))
    assert apart(found, truth) <= found.error_bound.max()


def outcome(call: Any, *args: Any) -> Any:
    """What a call gives, or the error it raises."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return call(*args)
        except Exception as error:
            return error


def calls_of_numpy(plain: np.ndarray) -> Iterator[tuple[str, Any]]:
    """Functions of numpy that take an array, and methods of one as functions."""
    left_out = (
        "info",
        "save",
        "asanyarray",
        "require",
        "empty",
        "tofile",
        "dump",
        "view",
        "setflags",
    )
    names = {name for name in dir(np) if callable(getattr(np, name))}
    for name in sorted(names - {n for n in names if isinstance(getattr(np, n), type)}):
        if not name.startswith(("_", "show_", "source", "test", *left_out)):
            yield f"numpy.{name}", getattr(np, name)
    for name in dir(plain):  # older versions list methods that are gone and raise
        if not name.startswith(("_", "mT", *left_out)) and callable(getattr(plain, name, None)):
            yield f".{name}", lambda array, *more, name=name: getattr(array, name)(*more)


def test_numpy_takes_poles_like_any_array() -> None:
    """Every function of numpy and every method of an array, with one argument or two."""
    found = poles(gallery.random_stable(5, 1, 1, 0))
    plain = np.array(found)
    tried = 0
    for name, call in calls_of_numpy(plain):
        for more in ((), (3,), ("complex",)):
            true, got = outcome(call, plain.copy(), *more), outcome(call, found, *more)
            if isinstance(true, Exception):
                continue
            if isinstance(got, ValueError) and name.endswith(
                ("copyto", "fill", "partition", "put", "sort", "resize", "byteswap", "setfield")
            ):
                continue  # it would write: read-only
            tried += 1
            assert type(got) is type(true), (name, more, got)
            if isinstance(true, np.ndarray):
                assert true.dtype == got.dtype, name
                assert np.array_equal(true, got, equal_nan=true.dtype.kind in "fc"), name
    assert tried > 200
    np.testing.assert_array_equal(np.round(found, 3), np.round(plain, 3))
    assert type(np.concatenate([found, found])) is np.ndarray
    assert found.copy().flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        found += 1


def test_systems_of_scipy_are_taken() -> None:
    for given, dt in (
        (scipy.signal.TransferFunction([1, 2], [1, 3, 4]), 0.0),
        (scipy.signal.TransferFunction([1, 2], [1, 3, 4], dt=0.1), 0.1),
        (scipy.signal.StateSpace([[-3, -4], [1, 0]], [[1], [0]], [[1, 2]], 0), 0.0),
    ):
        assert apart(poles(given), np.roots([1, 3, 4])) < 1e-14
        assert apart(zeros(given), [-2]) < 1e-14
        assert poles(given).dt == dt
        assert margins(given).gain_margin > 0
    for given, message in (
        (scipy.signal.ZerosPolesGain([1], [-1], 1), "to_ss"),
        (scipy.signal.TransferFunction([[1], [2]], [1, 2]), "several channels"),
        (scipy.signal.TransferFunction([1, 0, 0], [1, 2]), "improper"),
    ):
        with pytest.raises(ParameterError, match=message):
            poles(given)
