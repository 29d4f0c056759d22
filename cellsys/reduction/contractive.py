"""Contractive models: a norm in which every step shrinks, kept by clipping singular values."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.errors import ParameterError
from cellsys.model.contraction import clipped, contraction_metric, shrunk
from cellsys.model.latent import LatentModel
from cellsys.reduction.basis import (
    Basis,
    ExactSVD,
    RandomisedSVD,
    fit_basis,
    truncated,
)
from cellsys.reduction.regression import StepSamples, learned_model
from cellsys.reduction.ridge import ridge_regress
from cellsys.reduction.roll_out_loss import RollOuts, adam
from cellsys.samples.snapshots import Snapshots
from cellsys.worth.assessment import encode_start

LOSSES = ("roll-out", "one-step")
METRICS = ("fitted", "whitened")


@checked
@dataclass(frozen=True, kw_only=True)
class Contractive:
    """w+ = A w + B c + b with |A|_2 <= 1 - delta in coordinates w = T z, at every order.

    Two trajectories under the same commands approach each other in every step, and

        |w_k| <= |w_0| + sup |B c + b| / delta      for ever.

    Parameters
    ----------
    loss : {"roll-out", "one-step"}
        Roll-out: error of the positions over whole training runs from their start, in scaled
        units (projected Adam, adjoint gradient). One-step: error of single steps in w
        (accelerated projected gradient; the problem is convex).
    metric : {"fitted", "whitened"}
        T = L P_0, with P_0 = diag(1 / sd(z)). Whitened: L = I. Fitted: L^T L solves the Lyapunov
        equation of the ridge fit, its growing modes turned back, so that the start of the
        training already contracts.
    delta : float or None
        Contraction of a step, 0 < delta < 1. None trains the same start without the bound: to
        see what the bound costs and prevents.
    ridge : float
        Penalty of the start, see `Ridge`.
    step : float, optional
        s; a multiple of the sampling interval, which is the default.
    iterations, rate : int, float
        Adam steps of the roll-out loss, and the size of the first, over sqrt(order).
    svd : ExactSVD or RandomisedSVD, optional
        See `fit_basis`.
    """

    name: ClassVar[str] = "Contractive"
    loss: str = "roll-out"
    metric: str = "fitted"
    delta: float | None = 2e-4
    ridge: float = 1e-2
    step: float | None = None
    iterations: int = 300
    rate: float = 3e-3
    svd: ExactSVD | RandomisedSVD | None = None

    def __post_init__(self) -> None:
        for name, known in (("loss", LOSSES), ("metric", METRICS)):
            if getattr(self, name) not in known:
                raise ParameterError(
                    f"Contractive.{name} must be one of {', '.join(known)}, "
                    f"got {getattr(self, name)!r}"
                )
        if self.delta is not None and not 0 < self.delta < 0.5:
            raise ParameterError(
                f"Contractive.delta must be between 0 and 0.5 (or None), got {self.delta!r}"
            )
        if not (np.isfinite(self.ridge) and self.ridge >= 0):
            raise ParameterError(f"Contractive.ridge must be finite and >= 0, got {self.ridge!r}")
        if self.step is not None and not (np.isfinite(self.step) and self.step > 0):
            raise ParameterError(f"Contractive.step must be > 0 s, got {self.step!r}")
        if self.iterations < 0 or not 0 < self.rate < 1:
            raise ParameterError(
                "Contractive needs iterations >= 0 and 0 < rate < 1, got "
                f"{self.iterations!r} and {self.rate!r}"
            )

    def fit(
        self,
        data: Snapshots,
        order: int,
        *,
        test: Snapshots | None = None,
        basis: Basis | None = None,
    ) -> LatentModel:
        """Learn a model of order `order`.

        `basis`, of at least that order, is used if given, and the samples that it carries.
        """
        basis = truncated(basis, order) or fit_basis(data, order, method=self.svd)
        parts = basis.parts_of(data)
        step = data.dt if self.step is None else float(self.step)
        s = StepSamples.of(data, basis, parts, step)
        shift, size = s.inputs.mean(axis=0), np.maximum(s.inputs.std(axis=0), 1e-12)

        def standard(c: np.ndarray) -> np.ndarray:
            return (c - shift) / size

        delta = 1e-4 if self.delta is None else self.delta
        bound = None if self.delta is None else 1.0 - self.delta
        # Start: ridge in z, then T and everything in w = T z.
        c, ahead = standard(s.inputs), s.ahead - step * s.known
        K, _ = ridge_regress(np.column_stack([s.now, c]), ahead - s.now, self.ridge)
        A = K[:order].T + np.eye(order)
        sd = basis.singular_values / basis.singular_values[0]
        A = A * sd / sd[:, None]
        L = np.eye(order)
        if self.metric == "fitted":
            A = shrunk(A, 1.0 - 2.0 * delta)
            L = contraction_metric(A, 1.0 - delta)
        T, back = L / sd, sd[:, None] * sla.solve_triangular(L, np.eye(order))
        A = (L @ A) @ sla.solve_triangular(L, np.eye(order))
        K = np.concatenate([A.T, K[order:] @ T.T])
        now, ahead = np.column_stack([s.now @ T.T, c]), ahead @ T.T
        if self.metric == "whitened" or self.loss == "one-step":
            K = one_step(now, ahead, K, 1.0 - delta if bound is None else bound)
        b = ahead.mean(axis=0) - now.mean(axis=0) @ K
        notes: dict[str, object] = {}
        if self.loss == "roll-out":
            shell = learned_model(data, basis, np.zeros((order, order)), dt=step, notes={})
            starts = [encode_start(shell, run) for run in data.runs]
            runs = RollOuts.of(data, parts, s, starts, T, _weights(data, basis), standard)
            K, b, history = adam(
                runs,
                K,
                b,
                None if bound is None else partial(_projected, order=order, bound=bound),
                self.iterations,
                self.rate / np.sqrt(order),
            )
            notes["training_loss"] = [float(history[0]), float(history.min())]
        A, B, b = back @ K[:order].T @ T, back @ K[order:].T / size, back @ b
        return learned_model(
            data,
            basis,
            (A - np.eye(order)) / step,
            B=np.column_stack([B / step, s.B]),
            offset=(b - B @ shift) / step,
            input_names=s.names,
            dt=step,
            notes={"method": repr(self), "metric_condition": float(np.linalg.cond(L)), **notes},
        )


def _projected(K: np.ndarray, *, order: int, bound: float) -> np.ndarray:
    """K with the norm of its first `order` rows, those of the state, at most `bound`."""
    return np.concatenate([clipped(K[:order], bound), K[order:]])


def _weights(data: Snapshots, basis: Basis) -> np.ndarray:
    """How errors of z count: through the scaled positions, and a hundredth of everything."""
    rows = data.states.where(kind="position")
    V = basis.V[rows if len(rows) else slice(0, data.states.size)]
    return V.T @ V + 0.01 * np.eye(V.shape[1])


def one_step(now: np.ndarray, ahead: np.ndarray, K: np.ndarray, bound: float) -> np.ndarray:
    """K (regressors, m) of  min |ahead - now K - k_0|^2  with |K[:m]|_2 <= bound.

    FISTA on the triangular factor of the centred table (as many rows as regressors), from the
    given K; stops after 150 steps, or when one changes K by less than 1e-5 of its norm.
    """
    m = ahead.shape[1]
    Q, R = sla.qr(now - now.mean(axis=0), mode="economic", check_finite=False)
    left = Q.T @ (ahead - ahead.mean(axis=0))
    steepest = sla.norm(R, 2) ** 2

    def projected(K: np.ndarray) -> np.ndarray:
        return np.concatenate([clipped(K[:m], bound), K[m:]])

    point = old = projected(K)
    momentum = 1.0
    for _ in range(150):
        K = projected(point - R.T @ (R @ point - left) / steepest)
        change = K - old
        if np.linalg.norm(change) < 1e-5 * np.linalg.norm(K):
            break
        restart = np.sum(change * (point - K)) > 0
        following = 1.0 if restart else 0.5 + np.sqrt(0.25 + momentum**2)
        point = K if restart else K + (momentum - 1.0) / following * change
        momentum, old = following, K
    return K
