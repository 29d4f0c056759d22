"""Cell, interface and matrix apart as printed: W-bar, M_alpha, M_chi, M_phi, C and P of [42-59].

With eta split into cell (alpha), interface (chi) and matrix (phi), chi = M_chi_phi eta_phi [44] and
x' = W eta, the latent rate is z' = V^T W-bar [eta; eta'] with [eta; eta'] = V* z', so that

    W-bar = [[W, 0], [0, I]]  [48]     V* = [W^# V_x; V_eta]  [53]
    P_g = V^T W-bar M_g V*  [53, 59]
    C: chi from phi, in both halves [51]      R = I + V^T W-bar C (V^T W-bar)^# [57]

M_g keeps group g in both halves. P_alpha + P_chi + P_phi = I where V_x lies in the range of W; what
is left of it otherwise is `remainder`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.shown import Shown
from cellsys.system import Matrix, is_sparse
from cellsys.units import real_array, real_number


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class PrintedInterface(Shown):
    """The matrices of thesis eq. 48-59. Made by `printed_interface`.

    Attributes
    ----------
    W_bar : (n_x + n_eta, 2 n_eta)
    M_alpha, M_chi, M_phi : (2 n_eta, 2 n_eta)
        The printed M_alpha has rows and columns of other numbers by misprint; these are square.
    C : (2 n_eta, 2 n_eta)
        As used in [54]; its printed size l* x 2 n_eta does not multiply W-bar.
    V_star : (2 n_eta, m)
    P_alpha, P_chi, P_phi : (m, m)
    R : (m, m)
        What `Feedback(R=...)` takes for [57].
    remainder : float
        |P_alpha + P_chi + P_phi - I|_2.
    ranks : (int, int)
        Of W and of V^T W-bar, as decided.
    """

    W_bar: np.ndarray
    M_alpha: np.ndarray
    M_chi: np.ndarray
    M_phi: np.ndarray
    C: np.ndarray
    V_star: np.ndarray
    P_alpha: np.ndarray
    P_chi: np.ndarray
    P_phi: np.ndarray
    R: np.ndarray
    remainder: float
    ranks: tuple[int, int]

    def __str__(self) -> str:
        sizes = [float(np.linalg.norm(P, 2)) for P in (self.P_alpha, self.P_chi, self.P_phi)]
        return (
            f"printed split, m = {len(self.R)}: |P_alpha| {sizes[0]:.3g}, |P_chi| {sizes[1]:.3g}, "
            f"|P_phi| {sizes[2]:.3g}, |sum - I| {self.remainder:.2g}, |R| "
            f"{np.linalg.norm(self.R, 2):.3g}; rank of W {self.ranks[0]}, of V^T W-bar "
            f"{self.ranks[1]}"
        )


@checked
def printed_interface(
    V_x: np.ndarray,
    V_eta: np.ndarray,
    W_eta: Matrix,
    *,
    chi: Sequence[int],
    phi: Sequence[int],
    M_chi_phi: np.ndarray,
    rank_tol: float = 1e-10,
) -> PrintedInterface:
    """Build the matrices of thesis eq. 42-59.

    Parameters
    ----------
    V_x, V_eta : (n_x, m), (n_eta, m)
        Rows of the basis, in the units of W_eta; (V_x, V_eta) orthonormal for the sum to be I.
    W_eta : (n_x, n_eta)
    chi, phi : sequence of int
        Which auxiliaries belong to the interface and to the matrix; the rest is the cell's.
    M_chi_phi : (n_chi, n_phi)
        Membership [44], -1 where the tension between the attachments takes the trail's node.
    rank_tol : float
        Singular values below this share of the largest are left out of the two pseudo-inverses.

    Raises
    ------
    DimensionError, DataError, ParameterError
        Sizes that do not fit, groups that overlap or name no auxiliary, NaN.
    """
    W = np.asarray(W_eta.toarray() if is_sparse(W_eta) else W_eta, dtype=float)
    V_x, V_eta, member = (real_array(v, n) for v, n in ((V_x, "V_x"), (V_eta, "V_eta"),
                                                        (M_chi_phi, "M_chi_phi")))  # fmt: skip
    if V_x.ndim != 2 or V_eta.ndim != 2 or V_x.shape[1] != V_eta.shape[1]:
        raise DimensionError(f"V_x and V_eta must be (., m), got {V_x.shape} and {V_eta.shape}")
    if W.shape != (len(V_x), len(V_eta)):
        raise DimensionError(f"W_eta must be {(len(V_x), len(V_eta))}, got {W.shape}")
    if member.shape != (len(chi), len(phi)):
        raise DimensionError(f"M_chi_phi must be {(len(chi), len(phi))}, got {member.shape}")
    if not all(np.all(np.isfinite(v)) for v in (W, V_x, V_eta, member)):
        raise DataError("V_x, V_eta, W_eta or M_chi_phi holds NaN or inf")
    if not 0 < real_number(rank_tol, "rank_tol") < 1:
        raise ParameterError(f"rank_tol must be between 0 and 1, got {rank_tol!r}")
    n = len(V_eta)
    both = [*chi, *phi]
    if len(set(both)) < len(both) or any(not 0 <= i < n for i in both):
        raise ParameterError(f"chi and phi must be different ones of the {n} auxiliaries")
    group = np.zeros(n, dtype=int)
    group[list(chi)], group[list(phi)] = 1, 2
    M = [np.diag(np.tile(group == g, 2).astype(float)) for g in range(3)]
    W_bar = sla.block_diag(W, np.eye(n))
    C = np.zeros((2 * n, 2 * n))
    for half in (0, n):
        C[np.ix_(half + np.array(chi, dtype=int), half + np.array(phi, dtype=int))] = member
    back, rank_W = _pseudo_inverse(W, rank_tol)
    V = np.vstack([V_x, V_eta])
    V_star, project = np.vstack([back @ V_x, V_eta]), V.T @ W_bar
    P = [project @ part @ V_star for part in M]
    again, rank_project = _pseudo_inverse(project, rank_tol)
    one = np.eye(V.shape[1])
    return PrintedInterface(
        W_bar=W_bar,
        M_alpha=M[0],
        M_chi=M[1],
        M_phi=M[2],
        C=C,
        V_star=V_star,
        P_alpha=P[0],
        P_chi=P[1],
        P_phi=P[2],
        R=one + project @ C @ again,
        remainder=float(np.linalg.norm(P[0] + P[1] + P[2] - one, 2)),
        ranks=(rank_W, rank_project),
    )


def _pseudo_inverse(M: np.ndarray, share: float) -> tuple[np.ndarray, int]:
    """M^# and the rank it was decided with."""
    U, s, Vt = sla.svd(M, full_matrices=False)
    rank = int((s > share * s.max(initial=0.0)).sum())
    return (Vt[:rank].T / s[:rank]) @ U[:, :rank].T, rank
