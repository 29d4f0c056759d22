"""The dense route: weights that are not symmetric have no split, so the whole is one block."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from cellsys.population.graph import InteractionGraph
from cellsys.population.printed.blocks import ModeBlock, PrintedForm
from cellsys.population.printed.split import DOUBTFUL, EPS, FieldSplit


def dense_block(
    form: PrintedForm,
    split: FieldSplit,
    A: np.ndarray,
    graph: InteractionGraph,
    *,
    drop: bool = False,
) -> ModeBlock:
    """The whole system as one block of size K m, z = T x, x' = M x + G f.

    A pseudo-inverse does not survive an oblique transform, so N = I + w (x) P is decomposed as a
    whole, N = U S V^T with an absolute tolerance, and z = U S x where kept.

    Parameters
    ----------
    form : Superposition, MappedSuperposition or Feedback
    split : FieldSplit
    A : (m, m)
    graph : InteractionGraph
    drop : bool
        Drop the doubtful directions as well.
    """
    m, K = split.order, graph.n_cells
    w = graph.dense()
    eye = np.eye(K * m)
    isolated = np.kron(np.eye(K), A)
    N = eye + np.kron(w, split.P)
    extra = form.extra(m)
    X = N if extra is None else N + np.kron(w, extra @ split.P)
    if not form.inverted():
        kept = np.ones(K * m, bool)
        return ModeBlock(
            omega=np.nan,
            M=X @ isolated,
            T=eye,
            T_inverse=eye,
            G=X,
            D=eye,
            kept=kept,
            doubtful=np.zeros(0),
            shared=False,
            smallest=1.0,
        )
    U, s, Vt = sla.svd(N)
    # The rounding of N itself bounds what its singular values can tell.
    zero = max(split.tol**2, K * m * EPS * max(float(s[0]), 1.0))
    keep = s > (max(zero, DOUBTFUL) if drop else zero)
    doubtful = s[keep & (s < DOUBTFUL)]
    smallest = float(s[keep].min(initial=1.0))
    if keep.all() and extra is None:
        inverse = (Vt.T / s) @ U.T
        return ModeBlock(
            omega=np.nan,
            M=isolated,
            T=N,
            T_inverse=inverse,
            G=eye,
            D=eye,
            kept=keep,
            doubtful=doubtful,
            shared=True,
            smallest=smallest,
        )
    scale = np.where(keep, s, 1.0)
    # Rows of T^-1 X: those of V^T plus the correction by R - I, without the cancellation of N N^-1.
    top = Vt * keep[:, None]
    if extra is not None:
        top = top + (U.T @ np.kron(w, extra @ split.P)) / scale[:, None]
    M = (top @ isolated @ Vt.T) * keep
    return ModeBlock(
        omega=np.nan,
        M=M,
        T=U * scale,
        T_inverse=U.T / scale[:, None],
        G=top,
        D=keep[:, None] * Vt,
        kept=keep,
        doubtful=doubtful,
        shared=bool(keep.all()) and extra is None,
        smallest=smallest,
    )
