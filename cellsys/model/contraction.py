"""Norms in which a step shrinks: the certificate, and the tools to keep a model in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.errors import ParameterError
from cellsys.model.latent import LatentModel
from cellsys.shown import Shown


@checked
@dataclass(frozen=True)
class Contraction(Shown):
    """Certificate of a discrete model: |T A T^-1|_2 < 1 bounds every roll-out.

    Parameters
    ----------
    norm : float
        |T A T^-1|_2, or the spectral radius where that is >= 1: then no norm contracts.
    condition : float
        Condition number of T diag(sd(z)): how much larger than the norm a transient can be.
    metric : {"whitened", "fitted"}
        Which T, see `Contractive`.
    """

    norm: float
    condition: float
    metric: str

    def __str__(self) -> str:
        word = "contracts" if self.norm < 1.0 else "does not contract"
        return (
            f"{word}: norm 1 {self.norm - 1.0:+.2e} in the {self.metric} metric "
            f"(condition {self.condition:.3g})"
        )


@checked
def contraction(model: LatentModel) -> Contraction:
    """Certificate found from the model's own matrices, so that a loaded model can be checked.

    In whitened coordinates where that is enough, else in the Lyapunov metric of its A.

    Raises
    ------
    ParameterError
        Where the model is continuous or carries no singular values.
    """
    if model.dt is None or model.singular_values is None:
        raise ParameterError("a contraction norm needs a discrete model with singular values")
    sd = model.singular_values
    A = model.step_matrices()[0] * sd / sd[:, None]
    norm = float(sla.norm(A, 2))
    if norm < 1.0:
        return Contraction(norm, 1.0, "whitened")
    radius = float(np.abs(sla.eigvals(A)).max())
    if radius >= 1.0:
        return Contraction(radius, float("inf"), "fitted")
    L = contraction_metric(A, 0.5 * (1.0 + radius))
    whole = sla.solve_triangular(L.T, (L @ A).T, lower=True).T
    return Contraction(float(sla.norm(whole, 2)), float(np.linalg.cond(L)), "fitted")


def contraction_metric(A: np.ndarray, bound: float) -> np.ndarray:
    """Upper triangular L, |L|_2 = 1, with |L A L^-1|_2 <= bound; A of spectral radius < bound.

    L^T L = sum over k of (A^T)^k A^k / bound^2k, by doubling (Smith 1968): a sum of positive
    terms, so that nothing cancels.
    """
    P, power = np.eye(len(A)), A / bound
    for _ in range(60):
        more = power.T @ P @ power
        P = P + more
        if np.linalg.norm(more) < 1e-15 * np.linalg.norm(P):
            break
        power = power @ power
    L = sla.cholesky(0.5 * (P + P.T))
    return L / sla.norm(L, 2)


def shrunk(A: np.ndarray, radius: float) -> np.ndarray:
    """A with every eigenvalue beyond `radius` brought back to it, in its real Schur form."""
    T, Z = sla.schur(A, output="real")
    i = 0
    while i < len(T):
        k = 2 if i + 1 < len(T) and T[i + 1, i] != 0 else 1
        block = T[i : i + k, i : i + k]
        size = np.sqrt(abs(sla.det(block))) if k == 2 else abs(block[0, 0])
        if size > radius:
            T[i : i + k, i : i + k] = block * (radius / size)
        i += k
    return Z @ T @ Z.T


def clipped(A: np.ndarray, bound: float) -> np.ndarray:
    """The nearest matrix (Frobenius) whose singular values are at most `bound`.

    A - U (1 - bound/s) U^T A over the left singular vectors beyond the bound, from the leading
    eigenpairs of A A^T: several times cheaper than all of them, and as exact for large ones.
    """
    s2, U = sla.eigh(A @ A.T, subset_by_value=(bound**2, np.inf), check_finite=False)
    if not len(s2):
        return A
    return A - (U * (1.0 - bound / np.sqrt(s2))) @ (U.T @ A)
