"""Sensed direction: where the matrix around a cell is stiffest, or most stressed.

    q = sum_j w_j s_j (x_j - c)/rho_j ,   S = sum_j w_j s_j ,   d = q/|q| if |q| > eps S else p

rho_j is the horizontal distance from the cell's centroid c. w_j falls smoothly from 1 to 0 over
the last um of the range (and over 1 um at the inner radius): a hard edge is a switch.
Source: numerics.md II.4 (stiffness), mechanics.md 3 (stress).
"""

from __future__ import annotations

import numpy as np

from cellsys.laws.lamellipodium import smoothstep


def nodal_sum(n_nodes: int, fibres: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Sum over the fibres at each node."""
    return np.bincount(fibres[:, 0], value, n_nodes) + np.bincount(fibres[:, 1], value, n_nodes)


def _direction(
    nodes: np.ndarray,
    measure: np.ndarray,
    center: np.ndarray,
    p: np.ndarray,
    window: np.ndarray,
    away: np.ndarray,
    threshold: float,
) -> np.ndarray:
    weight = window * measure
    q = np.array([*(weight @ away), 0.0])
    strength = float(np.hypot(q[0], q[1]))
    if strength <= threshold * float(np.abs(weight).sum()) or strength == 0.0:
        return np.array(p, dtype=float)
    return q / strength


def stiffest_direction(
    nodes: np.ndarray,
    fibres: np.ndarray,
    stiffness: np.ndarray,
    center: np.ndarray,
    p: np.ndarray,
    reach: float,
    threshold: float,
) -> np.ndarray:
    """Unit direction d (3,) in the substrate plane of greatest tangent stiffness.

    nodes (n, 3) um; fibres (m, 2); stiffness (m,) tangent, pN/um; center, p (3,).
    """
    offset = nodes[:, :2] - center[:2]
    rho = np.sqrt((offset**2).sum(axis=1) + 1e-12)
    measure = nodal_sum(len(nodes), fibres, stiffness)
    window = 1.0 - smoothstep(rho, reach - 1.0, reach)
    return _direction(nodes, measure, center, p, window, offset / rho[:, None], threshold)


def stress_direction(
    nodes: np.ndarray,
    fibres: np.ndarray,
    virial: np.ndarray,
    center: np.ndarray,
    p: np.ndarray,
    inner: float,
    reach: float,
    threshold: float,
) -> np.ndarray:
    """Unit direction d (3,) of greatest tensile stress in the shell inner < rho < reach.

    virial (m,): tension times length of each fibre, pN um; compression does not count.
    """
    offset = nodes[:, :2] - center[:2]
    rho = np.sqrt((offset**2).sum(axis=1) + 1e-12)
    measure = nodal_sum(len(nodes), fibres, np.maximum(virial, 0.0))
    window = smoothstep(rho, inner, inner + 1.0) * (1.0 - smoothstep(rho, reach - 1.0, reach))
    return _direction(nodes, measure, center, p, window, offset / rho[:, None], threshold)
