"""Smallest singular value of z I - A over many z, and its minimum over the stability boundary."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from cellsys.spectra import triangular
from cellsys.spectra.realization import EPS

_STEPS = 14  # Lanczos steps; the largest Ritz value settles after a few


def schur_matrix(A: np.ndarray) -> np.ndarray:
    """Complex triangular T with the singular values of z I - A for every z."""
    if not A.size:
        return np.zeros((0, 0), complex)
    return sla.rsf2csf(*sla.schur(A, output="real"))[0]


def smallest_singular(T: np.ndarray, z: np.ndarray) -> np.ndarray:
    """sigma_min(z I - T) for many z by inverse Lanczos, all z together.

    A Ritz value never exceeds |(z I - T)^-1|, so each result is an upper bound; it is usually
    good to many digits (Trefethen and Embree 2005, section 39; Lui 1997).

    Parameters
    ----------
    T : complex array (n, n), upper triangular
    z : complex array (k,)

    Returns
    -------
    array (k,)
    """
    z = np.asarray(z, dtype=complex).ravel()
    n, k = T.shape[0], len(z)
    if n == 0:
        return np.full(k, np.inf)
    out = np.empty(k)
    if n <= 12:
        for lo in range(0, k, 10_000):
            M = z[lo : lo + 10_000, None, None] * np.eye(n) - T
            out[lo : lo + 10_000] = np.linalg.svd(M, compute_uv=False)[:, -1]
        return out
    step = max(16, 8_000_000 // (16 * n))
    back = T.conj().T[::-1, ::-1]  # (z I - T)^H, order reversed, is upper triangular again
    for lo in range(0, k, step):
        out[lo : lo + step] = _lanczos(T, back, z[lo : lo + step])
    return out


def _lanczos(T: np.ndarray, back: np.ndarray, z: np.ndarray) -> np.ndarray:
    n, k = T.shape[0], len(z)
    rng = np.random.default_rng(0)
    v = (rng.standard_normal((n, 1)) + 1j * rng.standard_normal((n, 1))) * np.ones((1, k))
    v /= np.linalg.norm(v, axis=0)
    old = np.zeros_like(v)
    beta = np.zeros(k)
    steps = min(_STEPS, n)
    alphas, betas = np.zeros((k, steps)), np.zeros((k, steps))
    with np.errstate(all="ignore"):
        for j in range(steps):
            w = triangular.solve(T, z, v[:, :, None])[:, :, 0]
            w = triangular.solve(back, z.conj(), w[::-1, :, None])[::-1, :, 0]
            alphas[:, j] = np.einsum("ij,ij->j", v.conj(), w).real
            w = w - alphas[:, j] * v - beta * old
            beta = np.linalg.norm(w, axis=0)
            betas[:, j] = beta
            old, v = v, w / np.where(beta > 0, beta, 1.0)
        scale = np.abs(alphas).max(axis=1) + betas.max(axis=1)
        bad = ~np.isfinite(scale) | (scale == 0)
        scale = np.where(bad, 1.0, scale)
        M = np.zeros((k, steps, steps))
        index = np.arange(steps)
        M[:, index, index] = alphas / scale[:, None]
        M[:, index[1:], index[:-1]] = betas[:, :-1] / scale[:, None]
        M[bad] = 0.0
        top = np.linalg.eigvalsh(M)[:, -1]
        result = 1.0 / np.sqrt(np.maximum(top, 0.0) * scale)
    return np.where(bad, 0.0, result)  # an overflowing inverse: singular to working precision


def boundary(angle: np.ndarray, discrete: bool) -> np.ndarray:
    """Points of the stability boundary: j w, or exp(j theta)."""
    return np.exp(1j * angle) if discrete else 1j * angle


def _level_set(A: np.ndarray, level: float, discrete: bool) -> np.ndarray:
    """Boundary parameters >= 0 where sigma_min equals `level`, or nearly: candidates."""
    n = len(A)
    I = np.eye(n)  # noqa: E741
    if discrete:
        M = np.block([[A, -level * I], [np.zeros((n, n)), I]])
        N = np.block([[I, np.zeros((n, n))], [-level * I, A.T]])
        mu = sla.eigvals(M, N)
        mu = mu[np.isfinite(mu)]
        mu = mu[np.abs(np.abs(mu) - 1) < 1e-5]
        return np.unique(np.abs(np.angle(mu)))
    mu = sla.eigvals(np.block([[A, -level * I], [level * I, -A.T]]))
    return np.unique(np.abs(mu.imag[np.abs(mu.real) < 1e-6 * sla.norm(A)]))


def distance_to_boundary(
    A: np.ndarray,
    values: np.ndarray,
    *,
    discrete: bool,
    T: np.ndarray | None = None,
    rtol: float = 1e-3,
) -> tuple[float, float, complex]:
    """min over the boundary of sigma_min(z I - A), from below, from above, and where.

    Candidates next to the eigenvalues and on a grid, then Byers' test: the Hamiltonian matrix
    ``[[A, -g I], [g I, -A^T]]`` (a symplectic pencil in discrete time) has no eigenvalue on the
    boundary for g below the minimum. New candidates are midpoints of the level set.

    Parameters
    ----------
    A : array (n, n)
    values : complex array (n,)
        Eigenvalues of A.
    discrete : bool
    T : complex array, optional
        From `schur_matrix`.
    rtol : float
        Relative gap between the two bounds that is good enough.

    Returns
    -------
    low, high : float
    z : complex
        Point of the boundary where `high` is reached.

    References
    ----------
    Byers, SIAM J. Sci. Stat. Comput. 9 (1988) 875; Boyd and Balakrishnan, Systems and Control
    Letters 15 (1990) 1.
    """
    n = len(A)
    if n == 0:
        return np.inf, np.inf, complex(np.nan)
    T = schur_matrix(A) if T is None else T
    norm = float(sla.norm(A))
    parameter = np.abs(np.angle(values)) if discrete else np.abs(values.imag)
    reach = np.pi if discrete else 1.1 * max(float(np.abs(values).max()), norm / np.sqrt(n))
    near = np.argsort(np.abs(np.abs(values) - 1) if discrete else np.abs(values.real))[:60]
    angle = np.unique(np.concatenate([[0.0, reach], parameter[near], np.linspace(0, reach, 40)]))
    sigma = smallest_singular(T, boundary(angle, discrete))

    def exact(x: float) -> float:
        return float(sla.svdvals(boundary(np.array(x), discrete) * np.eye(n) - T)[-1])

    best = float(angle[np.argmin(sigma)])
    high = exact(best)
    floor = n * EPS * norm
    for _ in range(20):
        if high <= floor:
            return 0.0, high, complex(boundary(np.array(best), discrete))
        level = high * (1 - rtol)
        found = _level_set(A, level, discrete)
        if found.size:
            edges = np.concatenate([[0.0], found, [reach if discrete else found[-1] * 1.1 + 1.0]])
            trial = np.unique(np.concatenate([found, 0.5 * (edges[1:] + edges[:-1])]))
            sigma = smallest_singular(T, boundary(trial, discrete))
            x = float(trial[np.argmin(sigma)])
            value = exact(x)
            if value < level:
                best, high = x, value
                continue
        # The eigenvalues are good to about n eps |A|: so is the level they speak for.
        return max(level - 10 * floor, 0.0), high, complex(boundary(np.array(best), discrete))
    return 0.0, high, complex(boundary(np.array(best), discrete))
