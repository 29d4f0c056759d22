"""Sensed direction: where the matrix around a cell is stiffest, or most stressed.

    q = sum_j w_j s_j (x_j - c)/rho_j ,   S = sum_j w_j s_j ,   d = q/|q| if |q| > eps S else p

rho_j is the horizontal distance from the cell's centroid c. w_j falls smoothly from 1 to 0 over
the last um of the range (and over 1 um at the inner radius): a hard edge is a switch.
Stiffness and stress compared: [notes: measurements, sensor].
"""

from __future__ import annotations

import numpy as np

from cellsys.laws.lamellipodium import smoothstep


def nodal_sum(n_nodes: int, fibres: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Sum over the fibres at each node."""
    return np.bincount(fibres[:, 0], value, n_nodes) + np.bincount(fibres[:, 1], value, n_nodes)


def tensile_virial(n_nodes: int, fibres: np.ndarray, virial: np.ndarray) -> np.ndarray:
    """Sum (n_nodes,) of tension times length over the tense fibres at each node, pN um.

    The trace of the nodal virial, of fibres in tension alone; over the node's volume it is a
    stress. virial (m,): tension times length of each fibre, pN um.
    """
    return nodal_sum(n_nodes, fibres, np.maximum(virial, 0.0))


def measure_moment(
    nodes: np.ndarray, measure: np.ndarray, center: np.ndarray, inner: float, reach: float
) -> tuple[np.ndarray, float]:
    """q (2,) and S of a nodal measure (n,) about `center`; `inner` 0 takes the whole disc.

    nodes (n, 2) or (n, 3) um; q and S in the unit of the measure.
    """
    offset = nodes[:, :2] - center[:2]
    rho = np.sqrt((offset**2).sum(axis=1) + 1e-12)
    window = 1.0 - smoothstep(rho, reach - 1.0, reach)
    if inner > 0:
        window = window * smoothstep(rho, inner, inner + 1.0)
    weight = window * measure
    return (weight / rho) @ offset, float(np.abs(weight).sum())


def sensed_direction(
    nodes: np.ndarray,
    measure: np.ndarray,
    center: np.ndarray,
    p: np.ndarray,
    inner: float,
    reach: float,
    threshold: float,
) -> np.ndarray:
    """Unit direction (3,) of the moment of a nodal measure; p where nothing stands out."""
    q, total = measure_moment(nodes, measure, center, inner, reach)
    strength = float(np.hypot(q[0], q[1]))
    if strength <= threshold * total or strength == 0.0:
        return np.array(p, dtype=float)
    return np.array([*(q / strength), 0.0])


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
    measure = nodal_sum(len(nodes), fibres, stiffness)
    return sensed_direction(nodes, measure, center, p, 0.0, reach, threshold)


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
    measure = tensile_virial(len(nodes), fibres, virial)
    return sensed_direction(nodes, measure, center, p, inner, reach, threshold)
