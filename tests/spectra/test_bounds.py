"""Every error bound covers the true error, against 50-digit arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

from cellsys.response import frequency_response
from cellsys.spectra import poles, zeros
from tests.response.gallery import GALLERY

mp = pytest.importorskip("mpmath")

SIZES = [1, 2, 5, 20, pytest.param(40, marks=pytest.mark.slow)]


def exact(A: np.ndarray) -> np.ndarray:
    """Eigenvalues of a float matrix, correctly rounded from 50 digits (80 for n = 40)."""
    with mp.workdps(50 if len(A) <= 20 else 80):
        if np.array_equal(A, np.triu(A)):
            return np.diagonal(A).astype(complex)
        found = mp.eig(mp.matrix(A.tolist()), left=False, right=False)
        return np.array([complex(z) for z in found])


def covered(found: np.ndarray, bound: np.ndarray, true: np.ndarray) -> None:
    gap = np.abs(found[:, None] - true[None])
    # Every computed root has a true one within its bound, and every true one lies in some disc.
    assert np.all(gap.min(axis=1) <= bound)
    assert np.all((gap - bound[:, None]).min(axis=0) <= 0)


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("name", GALLERY)
def test_pole_bounds_cover(name: str, n: int) -> None:
    A = GALLERY[name](n)
    found = poles(A)
    covered(np.asarray(found), found.error_bound, exact(A))


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("name", GALLERY)
def test_zero_bounds_cover(name: str, n: int) -> None:
    # With D = 1 the zeros are the eigenvalues of A - B C; B and C of small integers, so that
    # this matrix is exact.
    A = GALLERY[name](n)
    B, C = np.ones((n, 1)), np.zeros((1, n))
    C[0, 0] = 1.0
    with mp.workdps(50 if n <= 20 else 80):
        M = mp.matrix(A.tolist())
        for i in range(n):
            M[i, 0] -= 1
        true = np.array([complex(z) for z in mp.eig(M, left=False, right=False)])
    found = zeros((A, B, C, [[1.0]]))
    assert len(found) == n
    covered(np.asarray(found), found.error_bound, true)


@pytest.mark.parametrize("n", [1, 2, 5, 20, 60])
@pytest.mark.parametrize("name", GALLERY)
def test_frequency_response_bound_covers(name: str, n: int) -> None:
    A = GALLERY[name](n)
    B, C = np.ones((n, 1)), np.ones((1, n)) + np.arange(n)
    omega = np.array([1e-3, 0.3, 1.7, 40.0])
    found = frequency_response((A, B, C, [[0.5]]), omega)
    with mp.workdps(60):
        for k, w in enumerate(omega[:1] if n > 20 else omega):
            M = mp.mpc(0, float(w)) * mp.eye(n) - mp.matrix(A.tolist())
            true = (mp.matrix(C.tolist()) * mp.lu_solve(M, mp.matrix(B.tolist())))[0] + mp.mpf(0.5)
            error = float(abs(mp.mpc(complex(found.response[0, 0, k])) - true))
            assert error <= found.accuracy[0, 0, k] * abs(complex(true)) * 1.01


def test_bounds_are_not_idle() -> None:
    # Well-conditioned spectra must come with tight bounds: Clement is similar to a symmetric
    # matrix by a diagonal scaling, whose condition the balancing removes.
    for n in (5, 20):
        A = GALLERY["clement"](n)
        assert poles(A).error_bound.max() < 1e-9
        omega = np.array([0.3, 40.0])
        response = frequency_response((A, np.ones((n, 1)), np.ones((1, n)), [[0.0]]), omega)
        assert response.accuracy.max() < 1e-9


def test_bound_of_the_defective_follows_the_root_law() -> None:
    # k equal poles in one Jordan block move by about (eps)^(1/k): the bound lies between that
    # and 100 times as much, and the k poles are one cluster.
    for k in (2, 3, 4):
        A = np.diag([-5.0, *[-1.0] * k]) + np.eye(k + 1, k=1)
        A[0, 1] = 0.0
        found = poles(A)
        worst = found.error_bound[np.abs(np.asarray(found) + 1) < 0.1].max()
        law = (2e-16 * 10) ** (1 / k)
        assert law < worst < 100 * law
        assert sorted(found.cluster_size.tolist()) == [1] + [k] * k
