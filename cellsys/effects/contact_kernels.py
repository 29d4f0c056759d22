"""Compiled loop of contact: nodes pushed out of a closed surface."""

from __future__ import annotations

import numpy as np

from cellsys.compiled import compiled
from cellsys.geometry.surface_kernels import signed_distance


@compiled
def surface_contact(
    x, y, triangles, across, face, vertex, longest, stiffness, gap, reach,
    on_x, on_y, near_x, near_y,
):  # fmt: skip
    """Forces between nodes x and the closed surface (y, triangles); returns the energy.

    E = k/2 max(0, gap - d)^2 with d the distance of a node to the surface, negative inside. Nodes
    with d < reach are marked in `near_x`, the corners they face in `near_y`.
    """
    energy = 0.0
    low, high = np.full(3, 1e300), np.full(3, -1e300)
    middle, ball = np.zeros(3), 0.0
    for j in range(y.shape[0]):
        for k in range(3):
            middle[k] += y[j, k] / y.shape[0]
    for j in range(y.shape[0]):
        square = 0.0
        for k in range(3):
            square += (y[j, k] - middle[k]) ** 2
        ball = max(ball, square)
    ball = (np.sqrt(ball) + reach) ** 2
    for j in range(y.shape[0]):
        for k in range(3):
            low[k], high[k] = min(low[k], y[j, k] - reach), max(high[k], y[j, k] + reach)
    share, best_share = np.empty(3), np.empty(3)
    for i in range(x.shape[0]):
        p = x[i]
        if p[0] < low[0] or p[1] < low[1] or p[2] < low[2]:
            continue
        if p[0] > high[0] or p[1] > high[1] or p[2] > high[2]:
            continue
        square = 0.0
        for k in range(3):
            square += (p[k] - middle[k]) ** 2
        if square > ball:
            continue
        d, best_t = signed_distance(
            p, y, triangles, across, face, vertex, longest, share, best_share
        )
        sign = 1.0 if d >= 0.0 else -1.0
        distance = np.sqrt(d * d + 1e-18)
        if sign * distance >= reach:
            continue
        i0, i1, i2 = triangles[best_t, 0], triangles[best_t, 1], triangles[best_t, 2]
        near_x[i] += 1.0
        near_y[i0] += 1.0
        near_y[i1] += 1.0
        near_y[i2] += 1.0
        depth = gap - sign * distance
        if depth <= 0.0:
            continue
        energy += 0.5 * stiffness * depth * depth
        f = sign * stiffness * depth / distance
        for k in range(3):
            r = p[k] - best_share[0] * y[i0, k]
            r -= best_share[1] * y[i1, k] + best_share[2] * y[i2, k]
            on_x[i, k] += f * r
            on_y[i0, k] -= f * best_share[0] * r
            on_y[i1, k] -= f * best_share[1] * r
            on_y[i2, k] -= f * best_share[2] * r
    return energy
