"""Test matrices and systems from their published definitions."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla


def companion(n: int) -> np.ndarray:
    """Companion matrix of prod (s + k), k = 1..n, scaled to roots in (0, 1]."""
    return sla.companion(np.poly(-np.arange(1, n + 1) / n))


def jordan(n: int) -> np.ndarray:
    """One Jordan block of eigenvalue -1."""
    return -np.eye(n) + np.eye(n, k=1)


def kahan(n: int) -> np.ndarray:
    """Kahan 1966: upper triangular, s = sin 1.2, c = cos 1.2; nearly singular."""
    s, c = np.sin(1.2), np.cos(1.2)
    return (np.eye(n) - c * np.triu(np.ones((n, n)), 1)) * (s ** np.arange(n))[:, None]


def grcar(n: int) -> np.ndarray:
    """Grcar 1989: Toeplitz, strongly non-normal."""
    return np.triu(np.tril(np.ones((n, n)), 3)) - np.eye(n, k=-1)


def frank(n: int) -> np.ndarray:
    """Frank 1958: Hessenberg with ill-conditioned small eigenvalues."""
    i, j = np.indices((n, n)) + 1
    return np.where(j >= i - 1, n + 1 - np.maximum(i, j), 0).astype(float)


def clement(n: int) -> np.ndarray:
    """Clement 1959: tridiagonal, eigenvalues n-1, n-3, ..., -(n-1)."""
    k = np.arange(1.0, n)
    return np.diag(k, -1) + np.diag(n - k, 1)


def chebyshev(n: int) -> np.ndarray:
    """Chebyshev differentiation matrix with a boundary value removed (Trefethen 2000)."""
    x = np.cos(np.pi * np.arange(n + 1) / n)
    c = np.where((np.arange(n + 1) % n) == 0, 2.0, 1.0) * (-1.0) ** np.arange(n + 1)
    step = x[:, None] - x[None] + np.eye(n + 1)
    D = np.outer(c, 1 / c) / step
    D -= np.diag(D.sum(axis=1))
    return D[1:, 1:]


GALLERY = {f.__name__: f for f in (companion, jordan, kahan, grcar, frank, clement, chebyshev)}


def bidiagonal(n: int) -> np.ndarray:
    """-1 on the diagonal, 2 above: poles -1, and a 1e-14 perturbation makes it unstable."""
    return -np.eye(n) + 2 * np.eye(n, k=1)


def lag_chain(n: int, gain: float) -> tuple:
    """gain / (s + 1)^n as n lags in series."""
    return (-np.eye(n) + np.eye(n, k=-1), np.eye(n, 1), gain * np.eye(1, n, n - 1), [[0.0]])


def mass_spring(n: int, damping: float = 0.1) -> tuple:
    """Chain of n unit masses, unit springs to both neighbours and walls; force on the first,
    velocity of the last. 2 n states."""
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K, -damping * K - 0.01 * np.eye(n)]])
    return A, np.eye(2 * n, 1, -n), np.eye(1, 2 * n, 2 * n - 1), np.zeros((1, 1))


def random_stable(n: int, m: int, p: int, seed: int, depth: float = 0.3) -> tuple:
    """Gaussian system shifted so that its spectral abscissa is -depth."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A -= (sla.eigvals(A).real.max() + depth) * np.eye(n)
    return A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), np.zeros((p, m))


def ctlex41(n: int, r: float, s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, c, X with A^T X + X A + c^T c = 0 exactly: Example 4.1 of CTLEX (Kressner, Mehrmann,
    Penzl, SLICOT Working Note 1999-6); r spreads the poles, s the condition."""
    k = np.arange(n)
    A, X = np.diag(-(r**k)), np.outer(k + 1.0, k + 1) / (r ** k[:, None] + r ** k[None])
    c = (k + 1.0)[None]
    first, second = np.ones(n), 1 - 2.0 * ((k + 1) % 2)
    H1, H2 = (np.eye(n) - 2 / n * np.outer(e, e) for e in (first, second))
    S = s**k
    T, inverse = H2 @ (S[:, None] * H1), (H1 / S[None]) @ H2
    return T @ A @ inverse, c @ inverse, inverse.T @ X @ inverse


def tape(epsilon: float) -> tuple:
    """BD01AD 2.1, Chow and Kokotovic 1976: magnetic tape control, two time scales."""
    A = np.zeros((4, 4))
    A[0, 1], A[1, 2] = 0.4, 0.345
    A[2] = np.array([0, -0.524, -0.465, 0.262]) / epsilon
    A[3, 3] = -1 / epsilon
    B, C = np.zeros((4, 1)), np.zeros((2, 4))
    B[3, 0], C[0, 0], C[1, 2] = 1 / epsilon, 1, 1
    return A, B, C, np.zeros((2, 1))


def arnold_laub(epsilon: float) -> tuple:
    """BD01AD 2.2, Arnold and Laub 1984: nearly uncontrollable and nearly unstable."""
    A = np.kron(np.eye(2), [[0.0, 1.0], [-1.0, 0.0]])
    A += np.diag([-epsilon, -epsilon, epsilon, epsilon])
    return A, np.ones((4, 1)), np.ones((1, 4)), np.zeros((1, 1))


def vehicles(n: int) -> tuple:
    """BD01AD 3.1, Laub 1979, example 4: string of n vehicles, 2 n - 1 states."""
    size = 2 * n - 1
    A, B, C = np.zeros((size, size)), np.zeros((size, n)), np.zeros((n - 1, size))
    for i in range(size):
        if i % 2 == 0:
            A[i, i], B[i, i // 2] = -1, 1
        else:
            A[i, i - 1], A[i, i + 1], C[i // 2, i] = 1, -1, 1
    return A, B, C, np.zeros((n - 1, n))


def rod(n: int) -> tuple:
    """BD01AD 3.2, Hodel et al. 1996: heat flow in a thin rod."""
    A = (n + 1.0) * (np.eye(n, k=1) + np.eye(n, k=-1) - 2 * np.eye(n))
    A[0, 0] = -(n + 1.0)
    return A, (n + 1.0) * np.eye(n, 1, 1 - n), np.eye(n), np.zeros((n, 1))


def integrators(n: int) -> tuple:
    """BD01AD 3.3, Laub 1979, example 6: n integrators in series."""
    return np.eye(n, k=1), np.eye(n, 1, 1 - n), np.eye(1, n), np.zeros((1, 1))


def davison_wang() -> tuple:
    """BD02AD 1.10, Davison and Wang 1974, discrete (dt = 1 s)."""
    A, B, C = np.zeros((6, 6)), np.zeros((6, 2)), np.zeros((2, 6))
    A[[0, 1, 3, 4], [1, 2, 4, 5]] = 1
    B[2, 0] = B[5, 1] = 1
    C[0, :2], C[1, 3:5] = 1, [1, -1]
    return A, B, C, np.array([[1.0, 0], [1, 0]]), 1.0


def paper_machine(delta: float = 1e8) -> tuple:
    """BD02AD 2.1, Pappas et al. 1980: process control of a paper machine (dt = 1 s)."""
    A = np.eye(4, k=-1)
    A[0, 0] = 1 - 1 / delta
    return A, np.eye(4, 1) / delta, np.eye(1, 4, 3), np.zeros((1, 1)), 1.0


def poorbal(spread: float) -> tuple:
    """A pleasant system in units that differ by `spread` from state to state."""
    A, B, C, D = mass_spring(4, damping=0.3)
    n = len(A)
    T = 2.0 ** np.rint(np.linspace(-1, 1, n) * np.log2(spread))
    return A * T[:, None] / T[None], B * T[:, None], C / T[None], D
