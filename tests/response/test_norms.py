"""Norms, Gramians, Hankel values and balanced truncation against exact solutions and peers."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.errors import DimensionError, ParameterError, RankError
from cellsys.response import (
    balanced_truncation,
    controllability_gramian,
    error_system,
    frequency_response,
    h2_norm,
    hankel_singular_values,
    hinf_norm,
    norm,
    observability_gramian,
)
from cellsys.spectra.lyapunov import lyapunov
from tests.response import gallery

LAPACK = 30 * np.finfo(float).eps  # residual threshold of LAPACK's tests, times n


def sampled(system: tuple, dt: float = 0.1) -> tuple:
    A, B, C, D = system
    return sla.expm(A * dt), B, C, D, dt


@pytest.mark.parametrize(
    ("n", "r", "s"), [(1, 1.5, 1.5), (5, 1.5, 1.5), (10, 1.5, 1.5), (10, 1.1, 2.0), (20, 1.2, 1.2)]
)
def test_lyapunov_with_exact_solution(n: int, r: float, s: float) -> None:
    # CTLEX 4.1: condition grows with r and s; the error may exceed eps by it, the residual not.
    A, c, X = gallery.ctlex41(n, r, s)
    found = observability_gramian((A, np.zeros((n, 1)), c, np.zeros((1, 1))))
    assert found.residual < LAPACK * n
    # sep of the equation for 2-norm conditioning, from the Kronecker matrix itself.
    K = np.kron(np.eye(n), A.T) + np.kron(A.T, np.eye(n))
    condition = 2 * sla.norm(A) * np.linalg.norm(X) / sla.svdvals(K)[-1] / np.linalg.norm(X)
    assert sla.norm(found.matrix - X) <= LAPACK * n * condition * sla.norm(X)
    P, residual = lyapunov(A.T, c.T @ c, discrete=False)
    assert residual < LAPACK * n
    assert sla.norm(P - X) <= LAPACK * n * condition * sla.norm(X)


@pytest.mark.parametrize("time", ["continuous", "discrete"])
@pytest.mark.parametrize("n", [0, 1, 2, 3, 5, 10, 50])
def test_gramian_residuals(n: int, time: str) -> None:
    A = gallery.random_stable(n, 1, 1, n)[0] if n else np.zeros((0, 0))
    rng = np.random.default_rng(n)
    system = (A, rng.standard_normal((n, 2)), rng.standard_normal((3, n)), np.zeros((3, 2)))
    if time == "discrete":
        system = sampled(system) if n else (*system, 0.1)
    for gramian in (controllability_gramian(system), observability_gramian(system)):
        assert gramian.residual < LAPACK * max(n, 1)
        assert np.array_equal(gramian.matrix, gramian.matrix.T)
        assert np.all(np.linalg.eigvalsh(gramian.matrix) > -1e-12) if n else True
        P, residual = lyapunov(
            system[0] if gramian.kind == "controllability" else system[0].T,
            system[1] @ system[1].T
            if gramian.kind == "controllability"
            else system[2].T @ system[2],
            discrete=time == "discrete",
        )
        assert residual < LAPACK * max(n, 1)
        np.testing.assert_allclose(
            P, gramian.matrix, rtol=1e-8, atol=1e-10 * np.abs(P).max(initial=1.0)
        )


def test_norms_in_closed_form() -> None:
    s = ct.tf("s")
    lag = ct.ss(3 / (s + 2))
    assert float(h2_norm(lag)) == pytest.approx(3 / np.sqrt(4), rel=1e-13)
    assert float(hinf_norm(lag)) == pytest.approx(1.5, rel=1e-8)
    zeta = 0.01
    peak = 1 / (2 * zeta * np.sqrt(1 - zeta**2))
    found = hinf_norm(ct.ss(1 / (s**2 + 2 * zeta * s + 1)))
    assert found.value == pytest.approx(peak, rel=1e-10)
    assert found.frequency == pytest.approx(np.sqrt(1 - 2 * zeta**2), rel=1e-4)
    assert found.value <= found.upper <= found.value * (1 + 2e-8)
    # All-pass: 1 at every frequency, also with D; H2 is infinite.
    allpass = ct.ss((1 - s) / (1 + s))
    assert float(hinf_norm(allpass)) == pytest.approx(1.0, rel=1e-8)
    assert float(h2_norm(allpass)) == np.inf
    step = (np.array([[0.5]]), [[1.0]], [[1.0]], [[2.0]], 0.1)
    assert float(h2_norm(step)) == pytest.approx(np.sqrt(4 + 1 / (1 - 0.25)), rel=1e-13)
    assert float(hinf_norm(step)) == pytest.approx(4.0, rel=1e-8)
    assert float(hinf_norm(ct.ss(1 / (s - 1)))) == np.inf
    assert float(norm(lag, np.inf)) == float(hinf_norm(lag)) == float(norm(lag, "inf"))
    assert float(norm(lag)) == float(h2_norm(lag))
    with pytest.raises(ParameterError, match="order must be"):
        norm(lag, 1)
    assert "not inside" in hinf_norm(ct.ss(1 / s)).note
    assert float(hinf_norm((-np.eye(2), np.zeros((2, 0)), np.ones((1, 2)), None))) == 0.0


@pytest.mark.parametrize("time", ["continuous", "discrete"])
@pytest.mark.parametrize("seed", range(4))
def test_hinf_is_the_top_of_a_fine_sweep(seed: int, time: str) -> None:
    system = gallery.random_stable(14, 2, 3, seed, depth=0.02)
    system = (*system[:3], np.ones((3, 2)))
    if time == "discrete":
        system = sampled(system)
    found = hinf_norm(system)
    sweep = frequency_response(system).singular_values[0]
    assert sweep.max() <= found.upper * (1 + 1e-9)
    at = frequency_response(system, [found.frequency]).singular_values[0, 0]
    assert at == pytest.approx(found.value, rel=1e-9)


def test_published_norms_of_peers() -> None:
    system = gallery.mass_spring(10)
    plant = ct.ss(*system, 0)
    assert float(h2_norm(system)) == pytest.approx(ct.norm(plant, 2), rel=1e-9)
    assert float(hinf_norm(system)) == pytest.approx(ct.norm(plant, "inf"), rel=1e-5)


def test_against_pymor_examples() -> None:
    pymor = pytest.importorskip("pymor.models.examples")
    from pymor.core.logger import set_log_levels
    from pymor.models.iosys import LTIModel

    set_log_levels({"pymor": "ERROR"})
    example = pymor.msd_example(8, m=2)
    matrices = example if isinstance(example, tuple) else example.to_matrices()
    J, R, G, P, S, N, E, Q = (None if M is None else np.asarray(M) for M in matrices)
    P = np.zeros_like(G) if P is None else P
    A, B, C = (J - R) @ Q, G - P, (G + P).T @ Q
    model = LTIModel.from_matrices(A, B, C)
    system = (A, B, C, np.zeros((2, 2)))
    assert E is None or np.array_equal(E, np.eye(len(A)))
    assert all(M is None or np.all(M == 0) for M in (S, N))
    assert float(h2_norm(system)) == pytest.approx(float(model.h2_norm()), rel=1e-7)
    np.testing.assert_allclose(hankel_singular_values(system)[:6], model.hsv()[:6], rtol=1e-6)
    # Penzl's example, scaled down: poles known, response 1000 times over in pyMOR's own terms.
    A = sla.block_diag(
        [[-1, 100], [-100, -1]],
        [[-1, 200], [-200, -1]],
        [[-1, 400], [-400, -1]],
        -np.diag(np.arange(1.0, 41)),
    )
    B = np.concatenate([10 * np.ones(6), np.ones(40)])[:, None]
    found = frequency_response((A, B, B.T, [[0.0]]), np.array([1.0, 100.0, 300.0]))
    penzl = LTIModel.from_matrices(A, B, B.T)
    truth = [penzl.transfer_function.eval_tf(1j * w)[0, 0] for w in found.omega]
    np.testing.assert_allclose(found.response[0, 0], truth, rtol=1e-11)


def test_hankel_values_of_a_lag_and_their_invariance() -> None:
    assert hankel_singular_values(([[-2.0]], [[3.0]], [[4.0]], [[0.0]])) == pytest.approx([3.0])
    plain = gallery.random_stable(8, 1, 1, 0)
    T = 2.0 ** np.arange(-40, 40, 10)
    A, B, C, D = plain
    scaled = (A * T[:, None] / T, B * T[:, None], C / T, D)
    np.testing.assert_allclose(
        hankel_singular_values(scaled), hankel_singular_values(plain), rtol=1e-9
    )
    # Factors, not products: values far below sqrt(eps) of the first keep digits.
    slow = (-np.diag([1.0, 2.0]), [[1.0], [1e-6]], [[1.0, 1e-6]], [[0.0]])
    assert hankel_singular_values(slow)[1] == pytest.approx(0.25e-12 * (1 - 8 / 9), rel=1e-3)


@pytest.mark.parametrize("time", ["continuous", "discrete"])
def test_balanced_truncation_keeps_its_bound(time: str) -> None:
    system = gallery.mass_spring(8)
    system = sampled(system, 0.3) if time == "discrete" else system
    for order in (0, 2, 6, 10):
        found = balanced_truncation(system, order=order)
        error = error_system(system, found.system)
        # The bound is met up to the gap to which the norm itself is certified.
        assert error.hinf.value <= found.error_bound * (1 + 1e-6) + 1e-10
        assert error.hinf.value >= found.hankel[order] * (1 - 1e-6)
        np.testing.assert_allclose(found.left.T @ found.right, np.eye(order), atol=1e-9)
        assert found.system.inputs == ("u[0]",)
    reduced = balanced_truncation(system, tol=0.05 * float(hinf_norm(system)))
    assert reduced.error_bound <= 0.05 * float(hinf_norm(system))
    assert reduced.order < len(system[0])
    # Both Gramians of the reduced system are the same diagonal matrix.
    X = controllability_gramian(reduced.system).matrix
    if time == "continuous":
        np.testing.assert_allclose(X, np.diag(reduced.hankel[: reduced.order]), atol=1e-9)


def test_refusals() -> None:
    unstable = ([[1.0]], [[1.0]], [[1.0]], [[0.0]])
    for call in (controllability_gramian, observability_gramian, hankel_singular_values):
        with pytest.raises(ParameterError, match="needs a stable system, but 1"):
            call(unstable)
    system = gallery.mass_spring(2)
    with pytest.raises(ParameterError, match="exactly one"):
        balanced_truncation(system)
    with pytest.raises(ParameterError, match=r"0\.\.4"):
        balanced_truncation(system, order=9)
    copies = (-np.eye(3), np.ones((3, 1)), np.ones((1, 3)), np.zeros((1, 1)))
    with pytest.raises(RankError, match="rank 1"):
        balanced_truncation(copies, order=2)
    with pytest.raises(ParameterError, match="mixed sampling times"):
        error_system(system, sampled(system))
    with pytest.raises(DimensionError, match="differ"):
        error_system(system, gallery.random_stable(2, 2, 1, 0))


def test_error_system_of_equal_models_is_zero() -> None:
    system = gallery.mass_spring(3)
    found = error_system(system, system)
    assert found.hinf.value < 1e-12
    assert found.relative_h2 < 1e-6
    assert "relative" in str(found)
