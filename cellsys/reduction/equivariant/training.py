"""Training of one charge: contractive one-step fit, then projected Adam on the roll-out loss.

In whitened coordinates x and with real rows (real and imaginary parts of a charge are separate
rows: the matrices are real),

    x_k+1 = A_k x_k + B_k u_k - gamma (I + A_k)/2 v_k
    A_k = sum_h w_h(t_k) A_h,    ||A_h||_2 <= 1 - delta

v_k is the matrix velocity taken through the transposed load read-out. The loss is the squared
error of the whole roll-out in physical units, its gradient the adjoint recursion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from cellsys.errors import ParameterError


@dataclass(frozen=True, eq=False)
class ChargeData:
    """Rows (R) of one charge over K steps.

    Parameters
    ----------
    x : (K + 1, R, m)
        Whitened samples.
    u : (K, R, n_u)
        Command features.
    v : (K, R, m)
        Port velocities in whitened coordinates.
    w : (K, H)
        Schedule.
    weight : (m,)
        Variances that unwhiten the loss.
    counts : (K + 1, R)
        1 where a sample exists, 0 after the end of a shorter run.
    """

    x: np.ndarray
    u: np.ndarray
    v: np.ndarray
    w: np.ndarray
    weight: np.ndarray
    counts: np.ndarray


@dataclass(eq=False)
class ChargeParameters:
    """A (H, m, m), B (H, m, n_u) and gamma >= 0 of one charge; changed in place by training."""

    A: np.ndarray
    B: np.ndarray
    gamma: float = 0.0

    def copy(self) -> ChargeParameters:
        """An independent copy."""
        return ChargeParameters(self.A.copy(), self.B.copy(), self.gamma)


def clip(A: np.ndarray, bound: float) -> np.ndarray:
    """Nearest matrices (Frobenius) whose 2-norm is at most `bound`; (..., m, m)."""
    if not A.shape[-1]:
        return A
    U, s, Vt = np.linalg.svd(A)
    if s.max(initial=0.0) <= bound:
        return A
    return (U * np.minimum(s, bound)[..., None, :]) @ Vt


def one_step(data: ChargeData, ridge: float, bound: float) -> ChargeParameters:
    """Least squares of every single step, clipped: a start for `train`, a poor model by itself.

    The ridge pulls A towards the identity and B to zero, in units of the regressors' variance.
    """
    K, R, m = data.u.shape[0], data.u.shape[1], data.x.shape[2]
    H, n_u = data.w.shape[1], data.u.shape[2]
    regressors = np.concatenate([data.x[:-1], data.u], axis=2)
    there = (data.counts[1:] > 0)[..., None]
    rows = (data.w[:, None, :, None] * regressors[:, :, None, :] * there[..., None]).reshape(
        K * R, H * (m + n_u)
    )
    target = ((data.x[1:] - data.x[:-1]) * there).reshape(K * R, m)
    size = np.sqrt(np.mean(rows**2, axis=0))
    penalty = np.sqrt(ridge * K * R) * np.diag(np.maximum(size, 1e-3 * size.max()))
    solution = sla.lstsq(
        np.vstack([rows, penalty]), np.vstack([target, np.zeros((len(penalty), m))])
    )[0].reshape(H, m + n_u, m)
    A = np.eye(m) + solution[:, :m].transpose(0, 2, 1)
    B = solution[:, m:].transpose(0, 2, 1)
    return ChargeParameters(clip(A, bound), np.ascontiguousarray(B))


def roll_out(p: ChargeParameters, data: ChargeData) -> np.ndarray:
    """x (K + 1, R, m) from the first samples."""
    A, drive = _step_terms(p, data)
    x = np.empty_like(data.x)
    x[0] = data.x[0]
    for k in range(len(A)):
        np.matmul(x[k], A[k].T, out=x[k + 1])
        x[k + 1] += drive[k]
    return x


def loss_and_gradient(p: ChargeParameters, data: ChargeData) -> tuple[float, ChargeParameters]:
    """Mean squared roll-out error, and its gradient with respect to A, B and gamma."""
    A, _ = _step_terms(p, data)
    x = roll_out(p, data)
    n = data.counts[1:].sum()
    error = (x - data.x) * data.weight * data.counts[..., None]
    loss = float(np.sum(error * (x - data.x)) / n)
    adjoint = 2.0 / n * error
    for k in range(len(A) - 1, 0, -1):
        adjoint[k] += adjoint[k + 1] @ A[k]
    ahead = adjoint[1:].transpose(0, 2, 1)
    by_step = ahead @ (x[:-1] - 0.5 * p.gamma * data.v)
    gradient = ChargeParameters(
        np.einsum("kh,kij->hij", data.w, by_step, optimize=True),
        np.einsum("kh,kij->hij", data.w, ahead @ data.u, optimize=True),
        float(-np.sum(adjoint[1:] * _ported(A, data.v))),
    )
    return loss, gradient


def _step_terms(p: ChargeParameters, data: ChargeData) -> tuple[np.ndarray, np.ndarray]:
    A = np.einsum("kh,hij->kij", data.w, p.A, optimize=True)
    B = np.einsum("kh,hij->kij", data.w, p.B, optimize=True)
    drive = data.u @ B.transpose(0, 2, 1)
    if p.gamma:
        drive = drive - p.gamma * _ported(A, data.v)
    return A, drive


def _ported(A: np.ndarray, v: np.ndarray) -> np.ndarray:
    return 0.5 * (v + v @ A.transpose(0, 2, 1))


def port_gain(p: ChargeParameters, data: ChargeData) -> float:
    """Gain gamma >= 0 that lowers the roll-out loss most with A and B kept; often 0.

    The roll-out is affine in gamma, so the loss is a parabola and its least point exact. A gain
    that lowers the loss by less than 1 % is not determined by such data: then 0, and the cell
    drives the field as a cascade.
    """
    if not np.any(data.v):
        return 0.0
    unit = float(np.sqrt(np.mean(data.v**2)))
    without = roll_out(ChargeParameters(p.A, p.B, 0.0), data)
    slope = roll_out(ChargeParameters(p.A, p.B, 1.0 / unit), data) - without
    weight = data.weight * data.counts[..., None]
    curvature = float(np.sum(weight * slope * slope))
    descent = float(np.sum(weight * slope * (data.x - without)))
    loss = float(np.sum(weight * (data.x - without) ** 2))
    if not (curvature > 0 and descent > 0) or descent**2 / curvature < 0.01 * loss:
        return 0.0
    return descent / curvature / unit


def train(
    start: ChargeParameters,
    data: ChargeData,
    *,
    iterations: int,
    rate: float,
    bound: float | None,
) -> tuple[ChargeParameters, list[float]]:
    """Adam on the roll-out loss, projected after each step; the best parameters seen.

    gamma is not changed; see `port_gain`.

    Parameters
    ----------
    iterations : int
    rate : float
        First step size; it falls to a twentieth along a half cosine.
    bound : float or None
        Greatest allowed ||A_h||_2; None trains without the constraint.

    Returns
    -------
    ChargeParameters, list of float
        And the loss before every step.
    """
    if iterations < 0:
        raise ParameterError(f"iterations must be >= 0, got {iterations!r}")
    p, best, least, history = start.copy(), start.copy(), np.inf, []
    moments = [[np.zeros_like(a), np.zeros_like(a)] for a in (p.A, p.B)]
    for i in range(iterations + 1):
        with np.errstate(over="ignore", invalid="ignore"):
            # Without the constraint a roll-out may overflow; such a step is not taken as best.
            loss, gradient = loss_and_gradient(p, data)
        history.append(loss)
        if loss < least:
            best, least = p.copy(), loss
        if i == iterations or not np.isfinite(loss):
            break
        step = rate * (0.525 + 0.475 * np.cos(np.pi * i / iterations))
        changes = []
        for (first, second), g in zip(moments, (gradient.A, gradient.B), strict=True):
            first += 0.1 * (g - first)
            second += 0.01 * (g * g - second)
            mean, size = first / (1 - 0.9 ** (i + 1)), second / (1 - 0.99 ** (i + 1))
            changes.append(step * mean / (np.sqrt(size) + 1e-12))
        p.A -= changes[0]
        p.B -= changes[1]
        if bound is not None:
            p.A = clip(p.A, bound)
    return best, history
