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
def space_weights(x, places, free, reach, count, total):
    """Weights (1 - d^2/reach^2)^3 of the free nodes around each membrane node, by rows.

    d is the distance of places as they are now. Nodes in the box around the cell are sorted into
    cubes of side `reach`. Rows lie one after the other in the returned `index` and `weight`;
    count, total (n,) are filled with their lengths and sums.
    """
    low, high = np.full(3, 1e300), np.full(3, -1e300)
    for i in range(x.shape[0]):
        for k in range(3):
            low[k], high[k] = min(low[k], x[i, k]), max(high[k], x[i, k])
    for k in range(3):
        low[k], high[k] = low[k] - reach, high[k] + reach
    b0 = int((high[0] - low[0]) / reach) + 1
    b1 = int((high[1] - low[1]) / reach) + 1
    b2 = int((high[2] - low[2]) / reach) + 1
    near = np.empty(free.size, np.int64)
    cube = np.empty(free.size, np.int64)
    start = np.zeros(b0 * b1 * b2 + 1, np.int64)
    found = 0
    for m in range(free.size):
        j = free[m]
        p0, p1, p2 = places[j, 0], places[j, 1], places[j, 2]
        if p0 < low[0] or p0 > high[0] or p1 < low[1] or p1 > high[1]:
            continue
        if p2 < low[2] or p2 > high[2]:
            continue
        c = int((p0 - low[0]) / reach) * b1 + int((p1 - low[1]) / reach)
        c = c * b2 + int((p2 - low[2]) / reach)
        near[found], cube[found] = j, c
        start[c + 1] += 1
        found += 1
    for c in range(start.size - 1):
        start[c + 1] += start[c]
    # Places side by side in the order of their cubes: the search below reads them in a row.
    order, place = np.empty(found, np.int64), start.copy()
    at0, at1, at2 = np.empty(found), np.empty(found), np.empty(found)
    for m in range(found):
        to, j = place[cube[m]], near[m]
        order[to] = j
        at0[to], at1[to], at2[to] = places[j, 0], places[j, 1], places[j, 2]
        place[cube[m]] += 1
    # Entries of each row: at most what lies in the cubes around it.
    n, most = x.shape[0], 0
    for i in range(n):
        g0 = int((x[i, 0] - low[0]) / reach)
        g1 = int((x[i, 1] - low[1]) / reach)
        g2 = int((x[i, 2] - low[2]) / reach)
        for c0 in range(max(g0 - 1, 0), min(g0 + 2, b0)):
            for c1 in range(max(g1 - 1, 0), min(g1 + 2, b1)):
                row = (c0 * b1 + c1) * b2
                most += start[row + min(g2 + 2, b2)] - start[row + max(g2 - 1, 0)]
    index_of, weight_of = np.empty(most, np.int64), np.empty(most)
    closer = 1.0 / (reach * reach)
    k = 0
    for i in range(n):
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        first, whole = k, 0.0
        g0 = int((x0 - low[0]) / reach)
        g1 = int((x1 - low[1]) / reach)
        g2 = int((x2 - low[2]) / reach)
        for c0 in range(max(g0 - 1, 0), min(g0 + 2, b0)):
            for c1 in range(max(g1 - 1, 0), min(g1 + 2, b1)):
                row = (c0 * b1 + c1) * b2
                # Cubes along z lie one after the other.
                for m in range(start[row + max(g2 - 1, 0)], start[row + min(g2 + 2, b2)]):
                    d0, d1, d2 = at0[m] - x0, at1[m] - x1, at2[m] - x2
                    q = 1.0 - (d0 * d0 + d1 * d1 + d2 * d2) * closer
                    if q > 0.0:
                        index_of[k], weight_of[k] = order[m], q * q * q
                        whole += q * q * q
                        k += 1
        count[i], total[i] = k - first, whole
    return index_of[:k], weight_of[:k]


@compiled
def by_rows(index_of, weight_of, count, factor, index, weight):
    """Rows of `space_weights` times `factor` (n,), padded to the longest: as `surface_weights`."""
    k = 0
    for i in range(count.size):
        for m in range(count[i]):
            index[i, m], weight[i, m] = index_of[k], factor[i] * weight_of[k]
            k += 1


@compiled
def binding_rates(x, rim, k_on, height, width, rate):
    """k_on in the height of the bonds, 1/s, times the share `rim`."""
    for i in range(rate.size):
        rate[i] = rim[i] * _binding(x[i, 2], k_on, height, width)


@compiled
def clutch_loads(x, u, n, stretch, index, weight, count, hold, k_b, k_ad, cell, matrix):
    """Forces of the stretch on the cell, opposite on the matrix; hold: sums of the weights.

    Bonds in the plane have a zipper besides, vertical.
    """
    flat = stretch.shape[1] == 2
    f = np.empty(3)
    for i in range(x.shape[0]):
        if count[i] == 0:
            continue
        for k in range(stretch.shape[1]):
            f[k] = k_b * stretch[i, k]
        if flat:
            gap = x[i, 2]
            for m in range(count[i]):
                gap -= weight[i, m] * u[index[i, m], 2]
            f[2] = -k_ad * n[i] * gap
        for k in range(3):
            cell[i, k] += hold[i] * f[k]
        for m in range(count[i]):
            j, w = index[i, m], weight[i, m]
            matrix[j, 0] -= w * f[0]
            matrix[j, 1] -= w * f[1]
            matrix[j, 2] -= w * f[2]


@compiled
def own_loads(stretch, k_b, load):
    """|k_b S| of every clutch."""
    for i in range(load.size):
        square = 0.0
        for k in range(stretch.shape[1]):
            square += stretch[i, k] ** 2
        load[i] = k_b * np.sqrt(square)


@compiled
def total_loads(stretch, carried, k_b, load):
    """|k_b S + r| of every clutch, r (nodes, 3) what it carries besides, in the clutch's axes."""
    for i in range(load.size):
        square = 0.0
        for k in range(stretch.shape[1]):
            f = k_b * stretch[i, k] + carried[i, k]
            square += f * f
        load[i] = np.sqrt(square)


@compiled
def _middle(x, axes):
    middle = np.empty(axes)
    for k in range(axes):
        middle[k] = x[:, k].mean()
    return middle


@compiled
def clutch_rates(x, n, stretch, on, slip, load, k_off0, f_b, v_m, n_rate, s_rate):
    """Right-hand sides of n and S; slip (nodes, axes) = v_matrix - v_cell, um/s.

    on, load, k_off0 (nodes,): binding, 1/s, load, pN, and unloaded unbinding, 1/s, of every clutch.
    """
    axes = stretch.shape[1]
    c = _middle(x, axes)
    for i in range(x.shape[0]):
        off = _unbinding(n[i], load[i], k_off0[i], f_b)
        square = 0.0
        for k in range(axes):
            square += (x[i, k] - c[k]) ** 2
        r = np.sqrt(square + 1e-12)
        n_rate[i] = on[i] * (1.0 - n[i]) - off * n[i]
        for k in range(axes):
            away = v_m * (x[i, k] - c[k]) / r
            s_rate[i, k] = n[i] * (slip[i, k] + away) - off * stretch[i, k]


@compiled
def clutch_advance(x, n, stretch, on, slip, dt, bound, load, k_off0, f_b, v_m, n_new, s_new):
    """n and S after dt: exact exponentials at the rates of x, `bound` and load, S driven by the
    mean n. bound (nodes,): the strength that carries the load when the rates are taken.
    """
    axes = stretch.shape[1]
    c = _middle(x, axes)
    for i in range(x.shape[0]):
        off = _unbinding(bound[i], load[i], k_off0[i], f_b)
        square = 0.0
        for k in range(axes):
            square += (x[i, k] - c[k]) ** 2
        r = np.sqrt(square + 1e-12)
        rest = on[i] / (on[i] + off)
        n_new[i] = rest + (n[i] - rest) * np.exp(-(on[i] + off) * dt)
        decay = np.exp(-off * dt)
        # Bonds formed during the step carry their share of it: the mean of n, not its start.
        gain = 0.5 * (n[i] + n_new[i]) * (1.0 - decay) / off
        for k in range(axes):
            away = v_m * (x[i, k] - c[k]) / r
            s_new[i, k] = stretch[i, k] * decay + gain * (slip[i, k] + away)


@compiled
def slip(before, after, x, x_end, index, weight, count, hold, dt, out):
    """out[i] = mean velocity of the matrix at node i minus that of the node, in its axes."""
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            s = hold[i] * (x[i, k] - x_end[i, k])
            for m in range(count[i]):
                j, w = index[i, m], weight[i, m]
                s += w * (after[j, k] - before[j, k])
            out[i, k] = s / dt


@compiled
def gather(values, index, weight, count, out):
    """out[i] = sum_j w_ij values[j], as many components as `out` has."""
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            out[i, k] = 0.0
        for m in range(count[i]):
            j, w = index[i, m], weight[i, m]
            for k in range(out.shape[1]):
                out[i, k] += w * values[j, k]


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
