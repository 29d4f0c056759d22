"""Compiled loop of the lamellipodium that pushes itself off the clutches around it."""

from __future__ import annotations

import numpy as np

from cellsys.compiled import compiled
from cellsys.laws.lamellipodium import node_force

_share = compiled(inline=True)(node_force)


@compiled
def sector_push(x, p, force, height, edge, full, downward, push):
    """Force of every node (n, 3), pN, at full engagement, as `laws.lamellipodium.protrusion`."""
    push[:] = 0.0
    heading = np.sqrt(p[0] * p[0] + p[1] * p[1])
    if heading == 0.0 or force == 0.0:
        return
    h0, h1 = p[0] / heading, p[1] / heading
    c0, c1 = x[:, 0].mean(), x[:, 1].mean()
    for i in range(x.shape[0]):
        if x[i, 2] >= height:
            continue
        d0, d1 = x[i, 0] - c0, x[i, 1] - c1
        size = force * _share(d0, d1, x[i, 2], h0, h1, height, edge, full)
        r = np.sqrt(d0 * d0 + d1 * d1 + 1e-12)
        push[i, 0], push[i, 1], push[i, 2] = size * d0 / r, size * d1 / r, -downward * size


@compiled
def push_off(x, push, strength, pull, index, weight, count, rest, u, reach, half, cell, carried):
    """Engaged push on the membrane and what the clutches carry of it.

    x, push, cell, carried (n, 3); strength, count (n,); pull (n, 2); index, weight (n, most);
    rest, u (N, 3). Writes ``cell`` = g_i f_i and ``carried`` = r_j, pN.

        K_ij = n_j (1 - |x_i - x_j|^2/l^2)_+^3 in the plane, 0 where clutch j has no matrix,
        phi_ij = K_ij/(sum_j K_ij + n_0),   g_i = sum_j phi_ij,   r_j = sum_i phi_ij f_i + c_j

    c_j = omega n_j e_z x (y_j - y) with y_j where clutch j acts on the matrix and y their mean
    turns the sum of all couples about the normal, of push, reaction and `pull`, to zero.
    """
    n = x.shape[0]
    kernel = np.empty(n)
    bonds = np.empty(n, np.int64)  # clutches that have a matrix under them
    there = 0
    for j in range(n):
        if count[j] > 0 and strength[j] > 0.0:
            bonds[there] = j
            there += 1
    near = reach * reach
    cell[:] = 0.0
    carried[:] = 0.0
    couple = 0.0
    for i in range(n):
        if push[i, 0] == 0.0 and push[i, 1] == 0.0 and push[i, 2] == 0.0:
            continue
        total = half
        for b in range(there):
            j = bonds[b]
            kernel[b] = 0.0
            d0, d1 = x[i, 0] - x[j, 0], x[i, 1] - x[j, 1]
            q = 1.0 - (d0 * d0 + d1 * d1) / near
            if q > 0.0:
                kernel[b] = strength[j] * q * q * q
                total += kernel[b]
        engaged = 0.0
        for b in range(there):
            if kernel[b] > 0.0:
                share = kernel[b] / total
                engaged += share
                for axis in range(3):
                    carried[bonds[b], axis] += share * push[i, axis]
        for axis in range(3):
            cell[i, axis] = engaged * push[i, axis]
        couple += x[i, 0] * cell[i, 1] - x[i, 1] * cell[i, 0]
    # Where each clutch acts: y_j, kept in `place`.
    place = np.zeros((n, 2))
    mean0, mean1, whole = 0.0, 0.0, 0.0
    for j in range(n):
        if count[j] == 0:
            continue
        for m in range(count[j]):
            k, w = index[j, m], weight[j, m]
            place[j, 0] += w * (rest[k, 0] + u[k, 0])
            place[j, 1] += w * (rest[k, 1] + u[k, 1])
        couple -= place[j, 0] * carried[j, 1] - place[j, 1] * carried[j, 0]
        d0, d1 = x[j, 0] - place[j, 0], x[j, 1] - place[j, 1]
        couple += d0 * pull[j, 1] - d1 * pull[j, 0]
        mean0 += strength[j] * place[j, 0]
        mean1 += strength[j] * place[j, 1]
        whole += strength[j]
    if whole == 0.0:
        return
    mean0, mean1 = mean0 / whole, mean1 / whole
    inertia = 0.0
    for j in range(n):
        if count[j] > 0:
            place[j, 0] -= mean0
            place[j, 1] -= mean1
            inertia += strength[j] * (place[j, 0] ** 2 + place[j, 1] ** 2)
    if inertia == 0.0:
        return  # clutches in one point carry no couple
    turn = couple / inertia
    for j in range(n):
        if count[j] > 0:
            carried[j, 0] -= turn * strength[j] * place[j, 1]
            carried[j, 1] += turn * strength[j] * place[j, 0]


@compiled
def put_down(carried, index, weight, count, matrix):
    """matrix[k] -= sum_j w_jk r_j: what the clutches carry, on the matrix."""
    for j in range(carried.shape[0]):
        for m in range(count[j]):
            k, w = index[j, m], weight[j, m]
            for axis in range(3):
                matrix[k, axis] -= w * carried[j, axis]
