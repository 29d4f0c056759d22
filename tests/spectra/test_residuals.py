"""Residuals on published systems stay below LAPACK's threshold, 30 n eps."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.response import frequency_response
from cellsys.spectra import poles, zeros
from tests.response import gallery

EPS = np.finfo(float).eps
SYSTEMS = {
    "tape": gallery.tape(1e-6),
    "arnold_laub": gallery.arnold_laub(1e-6),
    "vehicles": gallery.vehicles(20),
    "rod": gallery.rod(100),
    "integrators": gallery.integrators(21),
    "davison_wang": gallery.davison_wang(),
    "paper_machine": gallery.paper_machine(),
    "mass_spring": gallery.mass_spring(20, damping=0.0),
}


def balanced(A: np.ndarray) -> np.ndarray:
    return sla.matrix_balance(A, permute=False)[0]


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_pole_is_one_of_a_matrix_nearby(name: str) -> None:
    # sigma_min(z I - A) is the size of the smallest change that makes z an exact pole.
    A = balanced(np.asarray(SYSTEMS[name][0]))
    n = len(A)
    for z in np.asarray(poles(SYSTEMS[name])):
        assert sla.svdvals(A - z * np.eye(n))[-1] <= 30 * n * EPS * sla.norm(A, 2)


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_zero_is_one_of_a_system_nearby(name: str) -> None:
    A, B, C, D = (np.asarray(M, dtype=float) for M in SYSTEMS[name][:4])
    n, m, p = len(A), B.shape[1], len(C)
    rng = np.random.default_rng(0)
    M = np.block([[A, B], [C, D]])

    def rank(z: complex) -> np.ndarray:
        return sla.svdvals(M - z * sla.block_diag(np.eye(n), np.zeros((p, m))))

    for z in np.asarray(zeros(SYSTEMS[name])):
        # At the zero one singular value drops: compared with a point next to it.
        usual = rank(0.1 * rng.standard_normal() + 0.7j)
        normal = int(np.count_nonzero(usual > 1e-9 * usual[0]))
        assert rank(z)[normal - 1] <= 30 * n * EPS * sla.norm(M, 2) * max(1, abs(z))


def test_known_zeros_of_published_systems() -> None:
    # Davison and Wang: y1 = x1 + x2 + u1, y2 = x4 - x5 + u1 with x3' ... chains of delays:
    # det [[1 + (1 + z)/z^3, 0], [1, (1 - z)/z^3]] vanishes at z = 1 and z^3 + z + 1 = 0.
    found = np.asarray(zeros(gallery.davison_wang()))
    truth = np.concatenate([[1.0], np.roots([1, 0, 1, 1])])
    assert len(found) == 4
    for z in truth:
        assert np.abs(found - z).min() < 1e-12
    for name in ("rod", "integrators", "paper_machine"):
        assert len(zeros(SYSTEMS[name])) == 0


@pytest.mark.parametrize("name", SYSTEMS)
def test_response_solves_its_equation(name: str) -> None:
    A, B, C, D = (np.asarray(M, dtype=float) for M in SYSTEMS[name][:4])
    dt = SYSTEMS[name][4] if len(SYSTEMS[name]) > 4 else 0
    omega = np.array([0.3, 1.1, 2.5])
    found = frequency_response(SYSTEMS[name], omega)
    for k, w in enumerate(omega):
        s = np.exp(1j * w * dt) if dt else 1j * w
        truth = C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D
        error = np.abs(found.response[:, :, k] - truth)
        # LU in given coordinates has its own error: ten times the bound covers both. An entry
        # that is exactly 0 has no relative accuracy.
        known = np.isfinite(found.accuracy[:, :, k])
        assert np.all(error[known] <= 10 * found.accuracy[known, k] * np.abs(truth[known]))
        assert np.all(error[~known] <= 1e-14)
