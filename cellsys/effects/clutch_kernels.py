"""Compiled loops of the motor clutch: weights, loads, exact update of bonds and stretches."""

from __future__ import annotations

import numpy as np

from cellsys.compiled import compiled
from cellsys.laws.clutch import binding_rate, unbinding_rate

_binding = compiled(inline=True)(binding_rate)
_unbinding = compiled(inline=True)(unbinding_rate)


@compiled
def surface_weights(x, rest, cell_start, cell_nodes, origin, bins, reach, index, weight, count):
    """Weights (1 - d^2/reach^2)^3 of the surface nodes around each membrane node, summing to 1.

    d is horizontal, to the *rest* positions. cell_start, cell_nodes: nodes sorted into square
    bins of side `reach`. Rows without a node in reach get count 0.
    """
    for i in range(x.shape[0]):
        bx = int(np.floor((x[i, 0] - origin) / reach))
        by = int(np.floor((x[i, 1] - origin) / reach))
        k = 0
        total = 0.0
        for gx in range(max(bx - 1, 0), min(bx + 2, bins)):
            for gy in range(max(by - 1, 0), min(by + 2, bins)):
                c = gx * bins + gy
                for m in range(cell_start[c], cell_start[c + 1]):
                    j = cell_nodes[m]
                    d0, d1 = rest[j, 0] - x[i, 0], rest[j, 1] - x[i, 1]
                    q = 1.0 - (d0 * d0 + d1 * d1) / (reach * reach)
                    if q > 0.0 and k < index.shape[1]:
                        index[i, k] = j
                        weight[i, k] = q * q * q
                        total += q * q * q
                        k += 1
        count[i] = k
        for m in range(k):
            weight[i, m] /= total


@compiled
def clutch_loads(x, u, n, stretch, index, weight, count, k_b, k_ad, cell, matrix):
    """Forces of stretch (horizontal) and zipper (vertical) on the cell, opposite on the matrix."""
    for i in range(x.shape[0]):
        if count[i] == 0:
            continue
        gap = x[i, 2]
        for m in range(count[i]):
            gap -= weight[i, m] * u[index[i, m], 2]
        f0, f1, f2 = k_b * stretch[i, 0], k_b * stretch[i, 1], -k_ad * n[i] * gap
        cell[i, 0] += f0
        cell[i, 1] += f1
        cell[i, 2] += f2
        for m in range(count[i]):
            j, w = index[i, m], weight[i, m]
            matrix[j, 0] -= w * f0
            matrix[j, 1] -= w * f1
            matrix[j, 2] -= w * f2


@compiled
def own_loads(stretch, k_b, load):
    """|k_b S| of every clutch."""
    for i in range(load.size):
        load[i] = k_b * np.sqrt(stretch[i, 0] ** 2 + stretch[i, 1] ** 2)


@compiled
def total_loads(stretch, carried, k_b, load):
    """|k_b S + r| of every clutch, r (nodes, 2 or 3) what it carries besides, in the plane."""
    for i in range(load.size):
        f0, f1 = k_b * stretch[i, 0] + carried[i, 0], k_b * stretch[i, 1] + carried[i, 1]
        load[i] = np.sqrt(f0 * f0 + f1 * f1)


@compiled
def clutch_rates(
    x, n, stretch, reach_rim, slip, load, k_on, height, width, k_off0, f_b, v_m, n_rate, s_rate
):
    """Right-hand sides of n and S; slip (nodes, 2) = v_matrix - v_cell, um/s.

    load, k_off0 (nodes,): load, pN, and unloaded unbinding, 1/s, of every clutch.
    """
    c0, c1 = x[:, 0].mean(), x[:, 1].mean()
    for i in range(x.shape[0]):
        off = _unbinding(n[i], load[i], k_off0[i], f_b)
        d0, d1 = x[i, 0] - c0, x[i, 1] - c1
        r = np.sqrt(d0 * d0 + d1 * d1 + 1e-12)
        on = reach_rim[i] * _binding(x[i, 2], k_on, height, width)
        n_rate[i] = on * (1.0 - n[i]) - off * n[i]
        s_rate[i, 0] = n[i] * (slip[i, 0] + v_m * d0 / r) - off * stretch[i, 0]
        s_rate[i, 1] = n[i] * (slip[i, 1] + v_m * d1 / r) - off * stretch[i, 1]


@compiled
def clutch_advance(
    x, n, stretch, reach_rim, slip, dt, bound, load, k_on, height, width, k_off0, f_b, v_m,
    n_new, s_new,
):  # fmt: skip
    """n and S after dt: exact exponentials at the rates of x, `bound` and load, S driven by the
    mean n. bound (nodes,): the strength that carries the load when the rates are taken.
    """
    c0, c1 = x[:, 0].mean(), x[:, 1].mean()
    for i in range(x.shape[0]):
        off = _unbinding(bound[i], load[i], k_off0[i], f_b)
        d0, d1 = x[i, 0] - c0, x[i, 1] - c1
        r = np.sqrt(d0 * d0 + d1 * d1 + 1e-12)
        on = reach_rim[i] * _binding(x[i, 2], k_on, height, width)
        rest = on / (on + off)
        n_new[i] = rest + (n[i] - rest) * np.exp(-(on + off) * dt)
        decay = np.exp(-off * dt)
        # Bonds formed during the step carry their share of it: the mean of n, not its start.
        gain = 0.5 * (n[i] + n_new[i]) * (1.0 - decay) / off
        s_new[i, 0] = stretch[i, 0] * decay + gain * (slip[i, 0] + v_m * d0 / r)
        s_new[i, 1] = stretch[i, 1] * decay + gain * (slip[i, 1] + v_m * d1 / r)


@compiled
def slip(before, after, x, x_end, index, weight, count, dt, out):
    """out[i] = mean velocity of the matrix under node i minus that of the node, horizontal."""
    for i in range(out.shape[0]):
        s0, s1 = x[i, 0] - x_end[i, 0], x[i, 1] - x_end[i, 1]
        for m in range(count[i]):
            j, w = index[i, m], weight[i, m]
            s0 += w * (after[j, 0] - before[j, 0])
            s1 += w * (after[j, 1] - before[j, 1])
        out[i, 0], out[i, 1] = s0 / dt, s1 / dt


@compiled
def gather(values, index, weight, count, out):
    """out[i] = sum_j w_ij values[j], first two components."""
    for i in range(out.shape[0]):
        out[i, 0] = 0.0
        out[i, 1] = 0.0
        for m in range(count[i]):
            j, w = index[i, m], weight[i, m]
            out[i, 0] += w * values[j, 0]
            out[i, 1] += w * values[j, 1]


@compiled
def gather_scalar(values, index, weight, count, out):
    """out[i] = sum_j w_ij values[j], values (nodes,)."""
    for i in range(out.size):
        out[i] = 0.0
        for m in range(count[i]):
            out[i] += weight[i, m] * values[index[i, m]]


@compiled
def put_weight(lift, index, weight, count, matrix):
    """matrix[k, z] -= sum_i w_ik lift_i: what lifts the nodes of a cell presses on the matrix."""
    for i in range(lift.size):
        for m in range(count[i]):
            matrix[index[i, m], 2] -= weight[i, m] * lift[i]
