"""Polarity law: the heading p of a cell turns towards the sensed direction d.

    dp/dt = kappa p x (d x p) = kappa [d (p.p) - p (p.d)]        [thesis eq. 72, 85]

|p| is constant. For constant d the angle between p and d obeys
tan(theta/2) = tan(theta_0/2) exp(-kappa |p| |d| t), which gives an exact step.
"""

from __future__ import annotations

from math import hypot

import numpy as np

from cellsys.laws.arrays import Vector, operations


def rate(p: Vector, d: Vector, kappa: float | Vector) -> Vector:
    """dp/dt of thesis eq. 72, for numpy (3,) or CasADi (3, 1) vectors; same unit as kappa p."""
    ops = operations(p, d)
    return kappa * (d * ops.dot(p, p) - p * ops.dot(p, d))


def exact_step(p: np.ndarray, d: np.ndarray, kappa: float, dt: float) -> np.ndarray:
    """Solution after dt of thesis eq. 72 with d held constant.

    With unit p, d and s = |p + d|^2/2, r = |p - d|^2/2, E = exp(-kappa |p| |d| dt):

        p+ = |p| (2 E (p - (p.d) d) + (s - E^2 r) d) / (s + E^2 r)

    Both equilibria stay: p = d/|d| (stable) and p = -d/|d| (unstable, s = 0). For p = 0 or
    d = 0 nothing turns.

    Parameters
    ----------
    p, d : array (3,)
        Polarity and sensed direction.
    kappa : float
        Gain, 1/s.
    dt : float
        Step, s; any size, also negative where the exponential does not overflow.

    Returns
    -------
    array (3,), with |p+| = |p| to rounding.
    """
    length, strength = hypot(*p), hypot(*d)  # no square that overflows
    if length == 0.0 or strength == 0.0 or dt == 0.0 or kappa == 0.0:
        return np.array(p, dtype=float)
    p_unit, d_unit = np.asarray(p, float) / length, np.asarray(d, float) / strength
    s = 0.5 * float((p_unit + d_unit) @ (p_unit + d_unit))
    if s == 0.0:
        return np.array(p, dtype=float)
    r = 0.5 * float((p_unit - d_unit) @ (p_unit - d_unit))
    decay = np.exp(-kappa * length * strength * dt)
    across = p_unit - (p_unit @ d_unit) * d_unit
    # `across` is orthogonal to d only to rounding; a second pass keeps |p| over long runs.
    across -= (across @ d_unit) * d_unit
    turned = 2.0 * decay * across + (s - decay**2 * r) * d_unit
    turned /= np.linalg.norm(turned)
    # |turned|^2 - |p|^2 without cancellation: norms rounded alike at every step would add up.
    excess = float((turned - p_unit) @ (turned + p_unit))
    return length * (turned - 0.5 * excess * turned)


def symbolic_step(p: Vector, d: Vector, kappa: float | Vector, dt: float) -> Vector:
    """`exact_step` on CasADi expressions: both equilibria stay, d = 0 turns nothing."""
    ops = operations(p, d)

    def size(v: Vector) -> Vector:
        return ops.sqrt(ops.dot(v, v) + 1e-300)

    length, strength = size(p), size(d)
    p_unit, d_unit = p / length, d / strength
    s = 0.5 * ops.dot(p_unit + d_unit, p_unit + d_unit)
    r = 0.5 * ops.dot(p_unit - d_unit, p_unit - d_unit)
    decay = ops.exp(-kappa * length * strength * dt)
    across = p_unit - ops.dot(p_unit, d_unit) * d_unit
    across = across - ops.dot(across, d_unit) * d_unit
    turned = 2.0 * decay * across + (s - decay * decay * r) * d_unit
    turned = turned / size(turned)
    excess = ops.dot(turned - p_unit, turned + p_unit)
    return ops.where(s * ops.dot(d, d) > 0, length * (turned - 0.5 * excess * turned), p)


def exact_steps(p: np.ndarray, d: np.ndarray, kappa: float, dt: float) -> np.ndarray:
    """`exact_step` for many cells: p, d and the result are (K, 3)."""
    length, strength = (np.hypot(np.hypot(v[:, 0], v[:, 1]), v[:, 2]) for v in (p, d))
    turns = (length > 0) & (strength > 0)
    if dt == 0.0 or kappa == 0.0 or not turns.any():
        return np.array(p, dtype=float)
    with np.errstate(invalid="ignore", divide="ignore"):
        p_unit, d_unit = p / length[:, None], d / strength[:, None]
        total, gap = p_unit + d_unit, p_unit - d_unit
        s, r = 0.5 * _dots(total, total), 0.5 * _dots(gap, gap)
        decay = np.exp(-kappa * length * strength * dt)
        across = p_unit - _dots(p_unit, d_unit)[:, None] * d_unit
        across -= _dots(across, d_unit)[:, None] * d_unit
        turned = 2.0 * decay[:, None] * across + (s - decay**2 * r)[:, None] * d_unit
        turned /= np.sqrt(_dots(turned, turned))[:, None]
        excess = _dots(turned - p_unit, turned + p_unit)
        turned -= 0.5 * excess[:, None] * turned
        turned *= length[:, None]
    # p = -d stays where it is, as does what has no length.
    return np.where((turns & (s > 0))[:, None], turned, p)


def _dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("ki,ki->k", a, b)


def heading_features(p: Vector, order: int = 2) -> Vector:
    """cos and sin of the heading angle about the substrate normal, up to `order`.

    (cos theta, sin theta, cos 2 theta, sin 2 theta, ...) with (cos, sin) = p_xy / |p_xy|: the
    signed angle of thesis eq. 70 without the arctangent, so that the derivative exists.
    """
    ops = operations(p)
    norm = ops.sqrt(p[0] * p[0] + p[1] * p[1])
    c, s = p[0] / norm, p[1] / norm
    features, c_k, s_k = [], 1.0, 0.0
    for _ in range(order):
        c_k, s_k = c_k * c - s_k * s, s_k * c + c_k * s
        features += [c_k, s_k]
    return ops.concatenate(features)


def rate_rows(p: np.ndarray, d: np.ndarray, kappa: float) -> np.ndarray:
    """`rate` for rows of directions: p and d (..., 3)."""
    return kappa * (d * np.vecdot(p, p)[..., None] - p * np.vecdot(p, d)[..., None])


def heading_rows(p: np.ndarray) -> np.ndarray:
    """`heading_features` of order 2 for rows of directions: (..., 3) -> (..., 4)."""
    turn = p[..., 0] + 1j * p[..., 1]
    turn /= np.abs(turn)
    out = np.empty((*p.shape[:-1], 4))
    out[..., 0], out[..., 1] = turn.real, turn.imag
    turn *= turn
    out[..., 2], out[..., 3] = turn.real, turn.imag
    return out
