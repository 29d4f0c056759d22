"""Compiled loops of the 1-D crawler: auxiliaries, rates, guards and the jump of an attachment.

Layout of x for K cells on N nodes: 8 K cell states (order of thesis eq. 37), N node
displacements, then (i_lead, i_trail) of every cell. Rows of `cells`: mass, drag, drag2,
stiffness, stiffness3, damping, length, G1, G2, grab, break, heading. `chain`: spacing, stiffness,
stiffening, drag.
"""

from __future__ import annotations

import numpy as np

from cellsys.compiled import compiled

LEAD, TRAIL, P_LEAD, P_TRAIL, ECM1, ECM2, D_ECM, D_CELL = range(8)
ETA = 10  # auxiliaries of one cell


@compiled
def attached(x, K, N):
    """Indices of walls and attached nodes in order, and their displacement slots.

    Held nodes are states, so an integrator that differences the rates (Radau) moves them too, by
    more than a node in time; kept on the chain they make a column that nothing depends on.
    """
    index = np.empty(2 * K + 2, np.int64)
    who = np.empty(2 * K + 2, np.int64)
    index[0], who[0] = 0, -1
    n = 1
    for c in range(K):
        for end in range(2):
            i = min(max(int(x[8 * K + N + 2 * c + end]), 1), N)
            j = n
            while index[j - 1] > i:
                index[j], who[j] = index[j - 1], who[j - 1]
                j -= 1
            index[j], who[j] = i, 2 * c + end
            n += 1
    index[n], who[n] = N + 1, -1
    return index, who


@compiled
def position(x, who, index, spacing):
    """Displacement of a wall (0) or of an attached node, um."""
    if who < 0:
        return 0.0
    slot = ECM2 if who % 2 == 0 else ECM1
    return x[8 * (who // 2) + slot] - spacing * index


@compiled
def auxiliaries(x, cells, chain, N, eta):
    """Fill eta (10 K + N): thesis eq. 40 per cell plus e_Blead, then node velocities."""
    K = cells.shape[0]
    spacing, stiffness, stiffening, drag = chain[0], chain[1], chain[2], chain[3]
    index, who = attached(x, K, N)
    left = 0.0
    velocity = np.zeros(2 * K + 2)
    for j in range(1, 2 * K + 2):
        u0 = position(x, who[j - 1], index[j - 1], spacing)
        u1 = position(x, who[j], index[j], spacing)
        strain = (u1 - u0) / (max(index[j] - index[j - 1], 1) * spacing)
        tension = stiffness * (strain + stiffening * strain * strain * strain)
        if j > 1:
            close(x, cells, drag, who[j - 1], left, tension, eta, velocity, j - 1)
        left = tension
    for c in range(K):
        m, h = cells[c, 0], cells[c, 11]
        v_lead, v_trail = x[8 * c + P_LEAD] / m, x[8 * c + P_TRAIL] / m
        s = x[8 * c + D_CELL] - cells[c, 6]
        rate = h * (v_lead - v_trail)
        base = ETA * c
        eta[base] = v_trail
        eta[base + 1] = v_lead
        eta[base + 2] = cells[c, 3] * s + cells[c, 4] * s * s * s + cells[c, 5] * rate
        eta[base + 3] = cells[c, 1] * v_trail + cells[c, 2] * v_trail * abs(v_trail)
        eta[base + 9] = cells[c, 1] * v_lead + cells[c, 2] * v_lead * abs(v_lead)
    fill(index, velocity, eta, ETA * K)


@compiled
def close(x, cells, drag, who, left, right, eta, velocity, j):
    """Balance of one attached node between its two sections, thesis eq. 42."""
    c = who // 2
    trail = who % 2 == 1
    base = ETA * c
    mass = x[8 * c + (TRAIL if trail else LEAD)]
    node = x[8 * c + (ECM1 if trail else ECM2)]
    pull = cells[c, 7 if trail else 8] * (mass - node)
    v = (right - left + pull) / drag
    velocity[j] = v
    forward = cells[c, 11] > 0
    if trail:
        eta[base + 4] = v
        eta[base + 6] = left if forward else right
        eta[base + 8] = right if forward else left
    else:
        eta[base + 5] = v
        eta[base + 7] = right if forward else left


@compiled
def fill(index, values, out, offset):
    """Linear interpolation between attached nodes, thesis eq. 38 with its first branch i/N_1."""
    for j in range(1, index.size):
        a, b = index[j - 1], index[j]
        for i in range(a + 1, b):
            share = (i - a) / (b - a)
            out[offset + i - 1] = values[j - 1] + share * (values[j] - values[j - 1])
        if j < index.size - 1:
            out[offset + b - 1] = values[j]


@compiled
def rates(x, cells, chain, N, out):
    """dx/dt written out (the same as W_eta eta)."""
    K = cells.shape[0]
    eta = np.zeros(ETA * K + N)
    auxiliaries(x, cells, chain, N, eta)
    drag = chain[3]
    for c in range(K):
        h, e, b = cells[c, 11], ETA * c, 8 * c
        out[b + LEAD] = eta[e + 1]
        out[b + TRAIL] = eta[e]
        out[b + P_LEAD] = (
            h * (eta[e + 7] - eta[e + 8] - eta[e + 2]) - eta[e + 9] - drag * eta[e + 5]
        )
        out[b + P_TRAIL] = (
            h * (eta[e + 2] + eta[e + 8] - eta[e + 6]) - eta[e + 3] - drag * eta[e + 4]
        )
        out[b + ECM1] = eta[e + 4]
        out[b + ECM2] = eta[e + 5]
        out[b + D_ECM] = h * (eta[e + 5] - eta[e + 4])
        out[b + D_CELL] = h * (eta[e + 1] - eta[e])
    for i in range(N):
        out[8 * K + i] = eta[ETA * K + i]
    for i in range(2 * K):
        out[8 * K + N + i] = 0.0


@compiled
def guard(x, cells, N, c, trail):
    """Distance to the next switch, um; 1 where the next node is taken or is the wall."""
    K = cells.shape[0]
    h = int(cells[c, 11])
    start = 8 * K + N
    lead_index, trail_index = int(x[start + 2 * c]), int(x[start + 2 * c + 1])
    target = (trail_index if trail else lead_index) + h
    if target < 1 or target > N:
        return 1.0
    for k in range(2 * K):
        if int(x[start + k]) == target:
            return 1.0
    if trail:
        return cells[c, 10] - h * (x[8 * c + TRAIL] - x[8 * c + ECM1])
    return h * (x[8 * c + ECM2] - x[8 * c + LEAD]) - cells[c, 9]


@compiled
def regrab(x, cells, chain, N, c, trail):
    """New state after the lead or trail has let go and taken the next node ahead."""
    K = cells.shape[0]
    out = x.copy()
    h, start = int(cells[c, 11]), 8 * K + N
    slot = start + 2 * c + (1 if trail else 0)
    target = int(x[slot]) + h
    out[slot] = target
    out[8 * c + (ECM1 if trail else ECM2)] = chain[0] * target + x[8 * K + target - 1]
    out[8 * c + D_ECM] = h * (out[8 * c + ECM2] - out[8 * c + ECM1])
    relax(out, K, N, chain[0])
    return out


@compiled
def relax(x, K, N, spacing):
    """Put every node on the line between its attached neighbours."""
    index, who = attached(x, K, N)
    values = np.zeros(2 * K + 2)
    for j in range(2 * K + 2):
        values[j] = position(x, who[j], index[j], spacing)
    fill(index, values, x, 8 * K)
