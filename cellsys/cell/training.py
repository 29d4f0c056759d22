"""Training of one charge: contractive one-step fit, then projected Adam on the roll-out loss.

In whitened coordinates x and with real rows (real and imaginary parts of a charge are separate
rows: the matrices are real),

    x_k+1 = E_k x_k + B_k u_k - gamma (I + E_k)/2 v_k,    E_k = sum_h w_h(t_k) S^-1 A_h S
    ||A_h||_2 <= 1 - delta

All vertices contract in the one norm |S x|, which is learned with them: the whitened norm alone
(S = I) costs twice as much accuracy. v_k is the matrix velocity taken through the transposed load
read-out. The loss is the squared error of the whole roll-out in physical units, its gradient the
adjoint recursion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla

from cellsys.cell.training_kernels import backward, forward
from cellsys.errors import ParameterError

SPREAD = 10.0  # greatest stretch of the learned norm against the whitened one


@dataclass(frozen=True, eq=False, kw_only=True)
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
    """A (H, m, m), B (H, m, n_u), gamma >= 0 and S (m, m) of one charge; changed by training.

    S None stands for the identity.
    """

    A: np.ndarray
    B: np.ndarray
    gamma: float = 0.0
    S: np.ndarray | None = None

    @property
    def norm(self) -> np.ndarray:
        """S (m, m), the identity where there is none."""
        return np.eye(self.A.shape[-1]) if self.S is None else self.S

    def copy(self) -> ChargeParameters:
        """An independent copy."""
        S = None if self.S is None else self.S.copy()
        return ChargeParameters(self.A.copy(), self.B.copy(), self.gamma, S)

    def steps(self) -> np.ndarray:
        """S^-1 A_h S (H, m, m)."""
        if self.S is None:
            return self.A
        return np.linalg.solve(self.S, self.A @ self.S)


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
    return _rolled(*_step_terms(p, data), data)


def _rolled(A: np.ndarray, drive: np.ndarray, data: ChargeData) -> np.ndarray:
    x = np.concatenate([data.x[:1], drive])
    forward(np.ascontiguousarray(A.transpose(0, 2, 1)), x)
    return x


def loss_and_gradient(p: ChargeParameters, data: ChargeData) -> tuple[float, ChargeParameters]:
    """Mean squared roll-out error, and its gradient with respect to A, B, gamma and S."""
    E, drive = _step_terms(p, data)
    x = _rolled(E, drive, data)
    n = data.counts[1:].sum()
    miss = x - data.x
    error = miss * data.weight * data.counts[..., None]
    loss = float(np.vdot(error, miss) / n)
    adjoint = 2.0 / n * error
    backward(E, adjoint)
    ahead = adjoint[1:].transpose(0, 2, 1)
    by_step = ahead @ (x[:-1] - 0.5 * p.gamma * data.v)
    G = _per_vertex(data.w, by_step)
    by_S = None
    if p.S is not None:
        steps = p.steps()
        # dE = -S^-1 dS E + E S^-1 dS
        back = np.swapaxes(steps, 1, 2) @ G - G @ np.swapaxes(steps, 1, 2)
        by_S = np.linalg.solve(p.S.T, back.sum(axis=0))
        G = np.linalg.solve(p.S.T, G) @ p.S.T
    gradient = ChargeParameters(
        G,
        _per_vertex(data.w, ahead @ data.u),
        float(-np.vdot(adjoint[1:], _ported(E, data.v))),
        by_S,
    )
    return loss, gradient


def _step_terms(p: ChargeParameters, data: ChargeData) -> tuple[np.ndarray, np.ndarray]:
    A, B = _at(data.w, p.steps()), _at(data.w, p.B)
    drive = data.u @ B.transpose(0, 2, 1)
    if p.gamma:
        drive = drive - p.gamma * _ported(A, data.v)
    return A, drive


def _at(w: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """sum_h w_kh M_h, (K, i, j)."""
    return (w @ vertices.reshape(len(vertices), -1)).reshape(len(w), *vertices.shape[1:])


def _per_vertex(w: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """sum_k w_kh M_k, (H, i, j)."""
    return (w.T @ steps.reshape(len(steps), -1)).reshape(w.shape[1], *steps.shape[1:])


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
    if p.S is not None:
        # The port enters through the inverse of the norm |S x|^2.
        flat = data.v.reshape(-1, len(p.S)).T
        data = replace(data, v=sla.solve(p.S.T @ p.S, flat).T.reshape(data.v.shape))
    unit = float(np.sqrt(np.mean(data.v**2)))
    without = roll_out(replace(p, gamma=0.0), data)
    slope = roll_out(replace(p, gamma=1.0 / unit), data) - without
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
    if bound is not None and p.S is None:
        p.S = np.eye(p.A.shape[-1])
    names = ["A", "B"] + (["S"] if p.S is not None else [])
    moments = {name: (np.zeros_like(v), np.zeros_like(v)) for name, v in _values(p, names)}
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
        for name, g in _values(gradient, names):
            first, second = moments[name]
            first += 0.1 * (g - first)
            second += 0.01 * (g * g - second)
            mean, size = first / (1 - 0.9 ** (i + 1)), second / (1 - 0.99 ** (i + 1))
            setattr(p, name, getattr(p, name) - step * mean / (np.sqrt(size) + 1e-12))
        if bound is not None:
            p.A = clip(p.A, bound)
            if p.S is not None:
                p.S = _conditioned(p.S)
    return best, history


def _values(p: ChargeParameters, names: list[str]) -> list[tuple[str, np.ndarray]]:
    return [(name, getattr(p, name)) for name in names]


def _conditioned(S: np.ndarray) -> np.ndarray:
    """S with singular values kept within `SPREAD` of their geometric mean 1."""
    U, s, Vt = np.linalg.svd(S)
    s = s / np.exp(np.mean(np.log(s)))
    return (U * np.clip(s, 1.0 / SPREAD, SPREAD)) @ Vt
