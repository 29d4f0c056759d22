"""Sensed direction: where the matrix around a cell is stiffest, or most stressed.

    q = sum_j w_j s_j (x_j - c)/rho_j ,   S = sum_j w_j s_j ,   d = q/|q| if |q| > eps S else p

That is the literal form: a direction, however little stands out. The graded cue has a strength,

    s_j = mean over the fibres at j of k max(g', 1),     m = sum_j w_j s_j / sum_j w_j
    g   = sum_j w_j (s_j - m) (x_j - c)/rho_j / sum_j w_j s_j ,
    d   = (g/g0) x/(1 + x^2),   x = |g|/g0,   |d| = x^2/(1 + x^2) < 1 ,

with the mean per fibre, so that the density of nodes drops out, and a fibre that the cell itself
has buckled counted as an unbuckled one. g0 is of the size of what a homogeneous network shows
[notes: mechanics, sensing].

rho_j is the horizontal distance from the cell's centroid c; inside a gel, of 3 `axes`, the
distance in space. w_j falls smoothly from 1 to 0 over
the last um of the range (and over 1 um at the inner radius): a hard edge is a switch.
Stiffness and stress compared: [notes: measurements, sensor].
"""

from __future__ import annotations

import numpy as np

from cellsys.laws.arrays import Vector, operations
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


def fibre_ends(n_nodes: int, fibres: np.ndarray) -> np.ndarray:
    """Number of fibres at each node, at least 1: the mean of no fibre is 0."""
    return np.maximum(np.bincount(fibres.ravel(), minlength=n_nodes), 1)


def nodal_mean(fibres: np.ndarray, value: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Mean over the fibres at each node, `ends` of `fibre_ends`."""
    return nodal_sum(len(ends), fibres, value) / ends


def measure_moment(
    nodes: np.ndarray,
    measure: np.ndarray,
    center: np.ndarray,
    inner: float,
    reach: float,
    axes: int = 2,
) -> tuple[np.ndarray, float]:
    """q (axes,) and S of a nodal measure (n,) about `center`; `inner` 0 takes the whole disc.

    nodes (n, 2) or (n, 3) um; q and S in the unit of the measure.
    """
    offset = nodes[:, :axes] - center[:axes]
    rho = np.sqrt((offset**2).sum(axis=1) + 1e-12)
    window = 1.0 - smoothstep(rho, reach - 1.0, reach)
    if inner > 0:
        window = window * smoothstep(rho, inner, inner + 1.0)
    weight = window * measure
    return (weight / rho) @ offset, float(np.abs(weight).sum())


def contrast(
    nodes: np.ndarray, measure: np.ndarray, center: np.ndarray, reach: float, axes: int = 2
) -> np.ndarray:
    """g (axes,) of a nodal measure (n,) >= 0 about `center`: 0 where it is the same everywhere.

    nodes (n, 2) or (n, 3) um. A slope of the measure of a share a per um gives a reach/3.
    """
    offset = nodes[:, :axes] - center[:axes]
    rho = np.sqrt((offset**2).sum(axis=1) + 1e-12)
    window = 1.0 - smoothstep(rho, reach - 1.0, reach)
    total, whole = float(window.sum()), float(window @ measure)
    if total == 0.0 or whole == 0.0:
        return np.zeros(axes)
    return (window * (measure - whole / total) / rho) @ offset / whole


def graded(g: np.ndarray, noise: float) -> np.ndarray:
    """Cue d (..., axes) of a contrast g (..., axes): |d| = x^2/(1 + x^2), x = |g|/noise."""
    x = np.asarray(g, dtype=float) / noise
    size = np.hypot.reduce(x, axis=-1, keepdims=True)
    # x |x|/(1 + |x|^2) without a square that overflows
    return x / (size + np.divide(1.0, size, out=np.full_like(size, np.inf), where=size > 0))


def cue(g: Vector, noise: float) -> Vector:
    """`graded` of one contrast as a vector of any length, numpy or CasADi."""
    ops = operations(g)
    size = ops.sqrt(ops.dot(g, g) + 1e-300) / noise
    return g / (noise * (size + 1.0 / size))


def cue_rows(g: np.ndarray, noise: float) -> np.ndarray:
    """`cue` for rows of contrasts: (..., n) -> (..., n)."""
    size = np.sqrt(np.vecdot(g, g) + 1e-300)[..., None] / noise
    return g / (noise * (size + 1.0 / size))


def ungraded(d: np.ndarray, noise: float) -> np.ndarray:
    """Contrast g (..., axes) whose cue is d (..., axes), |d| < 1: the inverse of `graded`."""
    d = np.asarray(d, dtype=float)
    size = np.hypot.reduce(d, axis=-1, keepdims=True)
    slope = np.sqrt(size * (1.0 - size))
    return noise * np.divide(d, slope, out=np.zeros_like(d), where=slope > 0)


def cue_slope(g: np.ndarray, noise: float) -> np.ndarray:
    """dd/dg (n, n) of `cue` at g (n,): zero at g = 0."""
    x = np.asarray(g, dtype=float) / noise
    size = float(np.linalg.norm(x))
    if size == 0.0:
        return np.zeros((len(x), len(x)))
    along = np.outer(x, x) / size**2
    radial, across = 2.0 * size / (1.0 + size**2) ** 2, size / (1.0 + size**2)
    return (radial * along + across * (np.eye(len(x)) - along)) / noise


def sensed_direction(
    nodes: np.ndarray,
    measure: np.ndarray,
    center: np.ndarray,
    p: np.ndarray,
    inner: float,
    reach: float,
    threshold: float,
    axes: int = 2,
) -> np.ndarray:
    """Unit direction (3,) of the moment of a nodal measure; p where nothing stands out."""
    q, total = measure_moment(nodes, measure, center, inner, reach, axes)
    strength = float(np.hypot.reduce(q))
    if strength <= threshold * total or strength == 0.0:
        return np.array(p, dtype=float)
    d = np.zeros(3)
    d[:axes] = q / strength
    return d


def stiffest_direction(
    nodes: np.ndarray,
    fibres: np.ndarray,
    stiffness: np.ndarray,
    center: np.ndarray,
    p: np.ndarray,
    reach: float,
    threshold: float,
    axes: int = 2,
) -> np.ndarray:
    """Unit direction d (3,), in the substrate plane or in space, of greatest tangent stiffness.

    nodes (n, 3) um; fibres (m, 2); stiffness (m,) tangent, pN/um; center, p (3,).
    """
    measure = nodal_sum(len(nodes), fibres, stiffness)
    return sensed_direction(nodes, measure, center, p, 0.0, reach, threshold, axes)


def stress_direction(
    nodes: np.ndarray,
    fibres: np.ndarray,
    virial: np.ndarray,
    center: np.ndarray,
    p: np.ndarray,
    inner: float,
    reach: float,
    threshold: float,
    axes: int = 2,
) -> np.ndarray:
    """Unit direction d (3,) of greatest tensile stress in the shell inner < rho < reach.

    virial (m,): tension times length of each fibre, pN um; compression does not count.
    """
    measure = tensile_virial(len(nodes), fibres, virial)
    return sensed_direction(nodes, measure, center, p, inner, reach, threshold, axes)
