"""Field maps of a basis: which part of a latent state belongs to the matrix, and to the cell.

    P_phi  = V_phi^T V_phi                            matrix rows                      [29]
    P_Fphi = V_F^T V_F                                matrix force rows                [84, 88]
    P_c    = V_c^T kron(ones(n, n)/n, I_3) V_c        centre of the membrane           [84]
    P_map                                             membrane adhesion forces that answer the
                                                      matrix forces, fitted to data    [89]

All are compressions of projectors: symmetric with a spectrum in [0, 1], but not idempotent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import ReducedModel
from cellsys.errors import DataError, DimensionError, ParameterError, RepresentationError
from cellsys.model.latent import basis_of, with_basis

_ORTHONORMAL = 1e-8  # |V^T V - I| up to which the split P + V_alpha^T V_alpha = I is meant to hold


def field_rows(
    model: ReducedModel, rows: str | Sequence[int], what: str = "a field map"
) -> np.ndarray:
    """Row indices of V that belong to the matrix.

    Parameters
    ----------
    model : LatentModel
    rows : "field", "forces" or sequence of int
        All matrix rows (``blocks["field"]``), those among the auxiliaries (its forces), or these.
    """
    named, V = with_basis(model, what)
    if isinstance(rows, str):
        if rows not in ("field", "forces"):
            raise ParameterError(f"rows must be 'field', 'forces' or indices, got {rows!r}")
        found = np.asarray(named.blocks.get("field", ()), dtype=int)
        if rows == "forces":
            found = found[found >= named.n_states]
        if not found.size:
            raise RepresentationError(
                f"{what} needs rows of the matrix, and this model names none"
                + (" among its auxiliaries" if rows == "forces" else "")
                + '; pass blocks={"field": indices} to LatentModel, or rows=indices'
            )
        return found
    found = np.unique(np.asarray(list(rows), dtype=int))
    if not found.size or found[0] < 0 or found[-1] >= len(V):
        raise DimensionError(f"rows must be indices from 0 to {len(V) - 1}")
    return found


def _check_basis(V: np.ndarray) -> None:
    error = float(np.abs(V.T @ V - np.eye(V.shape[1])).max(initial=0.0))
    if error > _ORTHONORMAL:
        raise DataError(
            f"V is not orthonormal: |V^T V - I| = {error:.2g}, allowed is {_ORTHONORMAL:g}; "
            "orthonormalise it first (scipy.linalg.qr)"
        )


def other_rows(model: ReducedModel, rows: np.ndarray, what: str) -> np.ndarray:
    """V_alpha: all rows of V but `rows`; V is checked to be orthonormal."""
    V = basis_of(model, what)
    _check_basis(V)
    mask = np.ones(len(V), bool)
    mask[rows] = False
    return V[mask]


@checked
def P_phi(model: ReducedModel, rows: str | Sequence[int] = "field") -> np.ndarray:
    """P_phi = V_phi^T V_phi (m, m) of the matrix rows [thesis eq. 29].

    Raises
    ------
    RepresentationError
        When the model has no V or names no matrix rows.
    """
    V_phi = basis_of(model, "P_phi")[field_rows(model, rows, "P_phi")]
    return V_phi.T @ V_phi


@checked
def P_F_phi(model: ReducedModel) -> np.ndarray:
    """P_Fphi = V_F^T V_F (m, m) of the matrix's force rows, those among the auxiliaries [84]."""
    V_F = basis_of(model, "P_F_phi")[field_rows(model, "forces", "P_F_phi")]
    return V_F.T @ V_F


@checked
def P_c(
    model: ReducedModel, rows: Sequence[int] | None = None, *, order: str = "node"
) -> np.ndarray:
    """P_c = V_c^T kron(ones(n, n)/n, I_3) V_c: the latent state of the cell's centre [84].

    ``ones(n, n)`` alone, as printed, would mix x, y and z of the nodes.

    Parameters
    ----------
    model : LatentModel
    rows : sequence of int, optional
        Membrane-position rows (3 n) of V; default the states of role component, kind position.
    order : {"node", "component"}
        x, y, z of node 1, then node 2 (default), or all x, then all y, then all z (the order of
        the thesis's appendix).
    """
    named, V = with_basis(model, "P_c")
    if order not in ("node", "component"):
        raise ParameterError(f"order must be 'node' or 'component', got {order!r}")
    if rows is None:
        if named.states is None:
            raise RepresentationError("P_c: the model does not name its states; pass rows=")
        chosen = named.states.where(role="component", kind="position")
    else:
        chosen = np.asarray(list(rows), dtype=int)
    if not chosen.size or chosen.size % 3 or chosen.min() < 0 or chosen.max() >= len(V):
        raise DimensionError(f"P_c needs 3 rows per membrane node, got {chosen.size} rows")
    V_c = V[chosen].reshape((-1, 3, V.shape[1]) if order == "node" else (3, -1, V.shape[1]))
    n = chosen.size // 3
    total = V_c.sum(axis=0 if order == "node" else 1)
    return total.T @ total / n


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class ForceMap:
    """P_map with what the fit left over.

    Attributes
    ----------
    matrix : (m, m)
        P_map.
    residual : float
        |P_map P_F z - target| over |target|, rms over the samples.
    mismatch : float
        |F_i + F_j| over |F| of the bonded pairs in the data themselves; 0 when they are equal and
        opposite, nan when no pairs were given.
    dropped : int
        Directions of P_F z that the data do not span; P_map is zero on them.
    rows : int array
        Rows of V that P_F was made of: a coupling with this map takes the same ones.
    """

    matrix: np.ndarray
    residual: float
    mismatch: float
    dropped: int
    rows: np.ndarray


@checked
def fit_P_map(
    model: ReducedModel,
    latent: np.ndarray,
    *,
    cell_rows: Sequence[int] | None = None,
    pairs: Sequence[tuple[int, int]] | None = None,
    field: str | Sequence[int] = "forces",
    tol: float = 1e-10,
) -> ForceMap:
    """Fit P_map [thesis eq. 89] so that adhesion forces on the membrane answer those on the matrix.

        P_map P_F z ~ V_c^T F_c        F_c = V_c z, or F_c,i = -F_e,j for the bonded pairs (i, j)

    by least squares over the training samples, minimum norm.

    Parameters
    ----------
    model : LatentModel
    latent : (N, m)
        Latent states of the training runs.
    cell_rows : sequence of int, optional
        Rows of V with the adhesion forces on the membrane. Give these or `pairs`.
    pairs : sequence of (cell row, matrix row), optional
        Bonded rows of V: equal and opposite by construction.
    field : "forces", "field" or rows
        Which rows make P_F.
    tol : float
        Directions of P_F z below this share of the greatest count as not in the data.

    Raises
    ------
    ParameterError, DataError, DimensionError
        Neither or both of `cell_rows` and `pairs`; NaN; wrong shapes.
    """
    V = basis_of(model, "P_map")
    Z = np.asarray(latent, dtype=float)
    if Z.ndim != 2 or Z.shape[1] != V.shape[1]:
        raise DimensionError(f"latent must be (N, {V.shape[1]}), got {Z.shape}")
    if not np.all(np.isfinite(Z)):
        raise DataError("latent holds NaN or inf")
    if not (np.isfinite(tol) and 0 <= tol < 1):
        raise ParameterError(f"tol must be in [0, 1), got {tol!r}")
    rows = field_rows(model, field, "P_map")
    V_F = V[rows]
    mismatch = float("nan")
    if cell_rows is not None and pairs is None:
        V_c = V[np.asarray(list(cell_rows), dtype=int)]
        target = (Z @ V_c.T) @ V_c
    elif pairs is not None and cell_rows is None:
        i, j = np.asarray(list(pairs), dtype=int).T
        on_cell, on_matrix = Z @ V[i].T, Z @ V[j].T
        size = float(np.linalg.norm(on_matrix))
        mismatch = float(np.linalg.norm(on_cell + on_matrix)) / size if size > 0 else 0.0
        target = -on_matrix @ V[i]
    else:
        raise ParameterError("P_map is fitted to cell_rows= or to pairs=; give one of them")
    known = (Z @ V_F.T) @ V_F
    U, s, Wt = sla.svd(known, full_matrices=False)
    rank = int(np.count_nonzero(s > tol * s.max(initial=0.0)))
    matrix = ((Wt[:rank].T / s[:rank]) @ (U[:, :rank].T @ target)).T
    size = float(np.linalg.norm(target))
    left = float(np.linalg.norm(known @ matrix.T - target))
    return ForceMap(
        matrix=matrix,
        residual=left / size if size > 0 else 0.0,
        mismatch=mismatch,
        dropped=len(s) - rank,
        rows=rows,
    )
