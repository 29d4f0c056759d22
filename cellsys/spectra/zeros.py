"""Invariant zeros by the staircase reduction of the system pencil."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.errors import ParameterError
from cellsys.spectra.realization import EPS, Realization, balance, realization
from cellsys.spectra.roots import RootSet, order
from cellsys.spectra.spectrum import pencil_spectrum, spectrum

Matrices = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _reduce(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, tol: float) -> Matrices:
    """Take away the states that carry infinite zeros until D has full row rank.

    Emami-Naeini and Van Dooren, Automatica 18 (1982) 415; SLICOT AB08NX.
    """
    while True:
        p, n = C.shape
        U, s, _ = sla.svd(D) if D.size else (np.eye(p), np.zeros(0), None)
        rho = int(np.count_nonzero(s > tol))
        if rho == p:
            return A, B, C, D
        C, D = U.T @ C, U.T @ D
        low = C[rho:]
        if n == 0:
            return A, B, C[:rho], D[:rho]
        Q, R, _ = sla.qr(low.T, pivoting=True)
        mu = int(np.count_nonzero(np.abs(np.diagonal(R)) > tol))
        if mu == 0:
            return A, B, C[:rho], D[:rho]
        Q = np.hstack([Q[:, mu:], Q[:, :mu]])
        nu = n - mu
        A, B, C = Q.T @ A @ Q, Q.T @ B, C[:rho] @ Q
        C = np.vstack([C[:, :nu], A[nu:, :nu]])
        D = np.vstack([D[:rho], B[nu:]])
        A, B = A[:nu, :nu], B[:nu]


@checked
def zeros(sys: LinearSystem, *, rank_tol: float | None = None, infinite: float = 1e10) -> RootSet:
    """Invariant zeros: where the system pencil loses rank.

        rank [[A - z I, B], [C, D]]  <  its rank for almost all z

    The system is balanced, infinite zeros are split off by the staircase algorithm, and the rest
    are generalised eigenvalues. The same answer with and without slycot, which is not used.

    Parameters
    ----------
    sys : control.StateSpace, TransferFunction (SISO) or tuple of arrays
        With any number of inputs and outputs.
    rank_tol : float, optional
        Singular values below ``rank_tol * |[[A, B], [C, D]]|_F`` (balanced) count as zero;
        default 10 max(n + p, n + m) eps. Stated in ``.note``.
    infinite : float
        A zero beyond ``infinite * |[[A, B], [C, D]]|_F`` counts as infinite and is left out.

    Returns
    -------
    RootSet
        Complex array (k,), falling real part.

    Raises
    ------
    DataError, DimensionError, ParameterError, MemoryBudgetError
        As for `poles`.

    References
    ----------
    Emami-Naeini and Van Dooren, Automatica 18 (1982) 415-430.
    """
    system = realization(sys).dense()
    if rank_tol is not None and not 0 <= rank_tol < 1:
        raise ParameterError(f"rank_tol must lie in [0, 1), got {rank_tol!r}")
    _, note, pencil = zero_values(system, rank_tol, infinite)
    if pencil is None:
        empty = spectrum(np.zeros((0, 0)))
        return RootSet(empty.values, kind="zero", dt=system.dt, detail=empty, note=note)
    A_f, E_f, norm = pencil
    delta = (10 + np.sqrt(system.n_states)) * EPS
    found = pencil_spectrum(A_f, E_f, delta * norm, delta)
    keep = np.flatnonzero(np.abs(found.values) <= infinite * norm)
    keep = keep[order(found.values[keep])]
    detail = replace(
        found,
        values=found.values[keep],
        condition=found.condition[keep],
        bound=found.bound[keep],
        cluster=np.unique(found.cluster[keep], return_inverse=True)[1],
    )
    return RootSet(detail.values, kind="zero", dt=system.dt, detail=detail, note=note)


def zero_values(
    system: Realization, rank_tol: float | None = None, infinite: float = 1e10
) -> tuple[np.ndarray, str, tuple[np.ndarray, np.ndarray, float] | None]:
    """The finite zeros alone, without error bounds; parameters as for `zeros`.

    Returns
    -------
    values : complex array (k,)
    note : str
    pencil : (A, E, norm) or None
        Finite pencil the zeros are eigenvalues of, and |[[A, B], [C, D]]|_F; None without zeros.
    """
    n, m, p = system.n_states, system.n_inputs, system.n_outputs
    none = np.zeros(0, complex)
    if n == 0 or m == 0 or p == 0:
        return none, "no states, inputs or outputs" if n else "no states", None
    b = balance(system)
    norm = float(np.sqrt(sum(sla.norm(M) ** 2 for M in (b.A, b.B, b.C, b.D))))
    tol = (10 * (n + max(m, p)) * EPS if rank_tol is None else rank_tol) * norm
    A, B, C, D = _reduce(b.A, b.B, b.C, b.D, tol)
    A, C, B, D = (M.T for M in _reduce(A.T, C.T, B.T, D.T, tol))
    note = f"rank tolerance {tol:.1e}, infinite beyond {infinite * norm:.1e}"
    k = A.shape[0]
    if k == 0:
        return none, note, None
    r = D.shape[0]
    # Columns W that span the null space of [C D]: z I - A on it is the finite pencil.
    W = sla.qr(np.hstack([C, D]).T)[0][:, r:] if r else np.eye(k)
    A_f, E_f = np.hstack([A, B]) @ W, W[:k]
    values = sla.eigvals(A_f, E_f)
    values = values[np.isfinite(values)]
    kept = values[np.abs(values) <= infinite * norm]
    if len(kept) < k:
        note += f", {k - len(kept)} left out"
    return kept, note, (A_f, E_f, norm)
