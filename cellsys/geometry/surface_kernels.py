"""Distances to and between triangles, compiled: what every contact and every gap is read from.

A segment of a contour is a triangle whose last two corners are one point.
"""

from __future__ import annotations

import numpy as np

from cellsys.compiled import compiled


@compiled
def closest_on_triangle(p, a, b, c, share):
    """Shares of the corners in the point of triangle abc closest to p (Ericson 2005, 5.1.5).

    A share is exactly 0 where the point lies on the edge opposite to that corner.
    """
    ab0, ab1, ab2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    ac0, ac1, ac2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    ap0, ap1, ap2 = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    bp0, bp1, bp2 = p[0] - b[0], p[1] - b[1], p[2] - b[2]
    cp0, cp1, cp2 = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    d1 = ab0 * ap0 + ab1 * ap1 + ab2 * ap2
    d2 = ac0 * ap0 + ac1 * ap1 + ac2 * ap2
    d3 = ab0 * bp0 + ab1 * bp1 + ab2 * bp2
    d4 = ac0 * bp0 + ac1 * bp1 + ac2 * bp2
    d5 = ab0 * cp0 + ab1 * cp1 + ab2 * cp2
    d6 = ac0 * cp0 + ac1 * cp1 + ac2 * cp2
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    share[0], share[1], share[2] = 0.0, 0.0, 0.0
    if d1 <= 0.0 and d2 <= 0.0:
        share[0] = 1.0
    elif d3 >= 0.0 and d4 <= d3:
        share[1] = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        share[2] = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        share[1] = d1 / (d1 - d3)
        share[0] = 1.0 - share[1]
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        share[2] = d2 / (d2 - d6)
        share[0] = 1.0 - share[2]
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        share[2] = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        share[1] = 1.0 - share[2]
    else:
        total = va + vb + vc
        share[1], share[2] = vb / total, vc / total
        share[0] = 1.0 - share[1] - share[2]


@compiled
def square_to_triangle(p, a, b, c, share):
    """Squared distance of p to triangle abc; `share` as in `closest_on_triangle`."""
    closest_on_triangle(p, a, b, c, share)
    square = 0.0
    for k in range(3):
        r = p[k] - share[0] * a[k] - share[1] * b[k] - share[2] * c[k]
        square += r * r
    return square


@compiled
def square_of_segments(p, q, r, s):
    """Squared distance of the segments pq and rs (Ericson 2005, 5.1.9)."""
    a = e = b = c = f = 0.0
    for k in range(3):
        u, v, w = q[k] - p[k], s[k] - r[k], p[k] - r[k]
        a += u * u
        e += v * v
        b += u * v
        c += u * w
        f += v * w
    x = y = 0.0
    if a > 0.0 and e > 0.0:
        across = a * e - b * b
        if across > 0.0:
            x = min(max((b * f - c * e) / across, 0.0), 1.0)
        y = (b * x + f) / e
        if y < 0.0:
            y, x = 0.0, min(max(-c / a, 0.0), 1.0)
        elif y > 1.0:
            y, x = 1.0, min(max((b - c) / a, 0.0), 1.0)
    elif a > 0.0:
        x = min(max(-c / a, 0.0), 1.0)
    elif e > 0.0:
        y = min(max(f / e, 0.0), 1.0)
    square = 0.0
    for k in range(3):
        d = p[k] + x * (q[k] - p[k]) - r[k] - y * (s[k] - r[k])
        square += d * d
    return square


@compiled
def _volume(a, b, c, d):
    """Six times the signed volume of a tetrahedron."""
    u0, u1, u2 = a[0] - d[0], a[1] - d[1], a[2] - d[2]
    v0, v1, v2 = b[0] - d[0], b[1] - d[1], b[2] - d[2]
    w0, w1, w2 = c[0] - d[0], c[1] - d[1], c[2] - d[2]
    cross = u0 * (v1 * w2 - v2 * w1) + u1 * (v2 * w0 - v0 * w2)
    return cross + u2 * (v0 * w1 - v1 * w0)


@compiled
def _pierces(p, q, a, b, c):
    """Whether the segment pq goes through the inside of triangle abc."""
    if _volume(a, b, c, p) * _volume(a, b, c, q) >= 0.0:
        return False
    u, v, w = _volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)
    return (u > 0.0 and v > 0.0 and w > 0.0) or (u < 0.0 and v < 0.0 and w < 0.0)


@compiled
def _between(x, i, y, j):
    """How far triangle i of x and j of y are apart along the line of their middles."""
    square, low, high = 0.0, 1e300, -1e300
    for k in range(3):
        d = 0.0
        for m in range(3):
            d += y[j[m], k] - x[i[m], k]
        square += d * d
    for n in range(3):
        p = q = 0.0
        for k in range(3):
            d = 0.0
            for m in range(3):
                d += y[j[m], k] - x[i[m], k]
            p += d * x[i[n], k]
            q += d * y[j[n], k]
        high, low = max(high, p), min(low, q)
    return (low - high) / (np.sqrt(square) + 1e-300)


@compiled
def _square_of_pair(x, i, y, j, best, share):
    """The lesser of `best` and the squared distance of two triangles; 0 where one pierces."""
    for m in range(3):
        p, q = x[i[m]], x[i[(m + 1) % 3]]
        if _pierces(p, q, y[j[0]], y[j[1]], y[j[2]]):
            return 0.0
        best = min(best, square_to_triangle(p, y[j[0]], y[j[1]], y[j[2]], share))
        for n in range(3):
            best = min(best, square_of_segments(p, q, y[j[n]], y[j[(n + 1) % 3]]))
        p, q = y[j[m]], y[j[(m + 1) % 3]]
        if _pierces(p, q, x[i[0]], x[i[1]], x[i[2]]):
            return 0.0
        best = min(best, square_to_triangle(p, x[i[0]], x[i[1]], x[i[2]], share))
    return best


@compiled
def least_square_of_pairs(x, tx, y, ty, rows, columns, lower, best):
    """Least squared distance of triangles, pair by pair; 0 where two go through each other.

    `lower` are lower bounds of the distances, in order; the search ends where they pass `best`, a
    squared distance that two points of the surfaces have.
    """
    share = np.empty(3)
    for k in range(rows.shape[0]):
        if lower[k] > 0.0 and lower[k] * lower[k] >= best:
            break
        i, j = tx[rows[k]], ty[columns[k]]
        apart = _between(x, i, y, j)
        if apart > 0.0 and apart * apart >= best:
            continue
        best = _square_of_pair(x, i, y, j, best, share)
        if best == 0.0:
            break
    return best


@compiled
def mark_crossing(x, tx, y, ty, rows, columns, touch, on_x, on_y):
    """Mark the triangles that go through one of the other surface, or to `touch` (squared) of it.

    All others lie on one side of the other surface.
    """
    share = np.empty(3)
    for k in range(rows.shape[0]):
        i, j = tx[rows[k]], ty[columns[k]]
        if _between(x, i, y, j) <= 0.0 and _square_of_pair(x, i, y, j, 1e300, share) <= touch:
            on_x[rows[k]] = on_y[columns[k]] = True


@compiled
def pseudonormals(x, triangles, face, vertex):
    """Unit normals of the triangles, their sums at the nodes by angle; returns 6 x the volume.

    On which side of a closed surface a point lies is the sign of its product with the normal of
    the closest feature, and at a node only this sum is one (Baerentzen & Aanaes 2005).
    """
    vertex[:] = 0.0
    volume = 0.0
    for t in range(triangles.shape[0]):
        a, b, c = x[triangles[t, 0]], x[triangles[t, 1]], x[triangles[t, 2]]
        u0, u1, u2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        v0, v1, v2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        n0, n1, n2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
        size = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) + 1e-300
        face[t, 0], face[t, 1], face[t, 2] = n0 / size, n1 / size, n2 / size
        volume += _volume(a, b, c, x[0])
        for k in range(3):
            o, p, q = x[triangles[t, k]], x[triangles[t, (k + 1) % 3]], x[triangles[t, k - 1]]
            along, pp, qq = 0.0, 0.0, 0.0
            for m in range(3):
                along += (p[m] - o[m]) * (q[m] - o[m])
                pp += (p[m] - o[m]) ** 2
                qq += (q[m] - o[m]) ** 2
            angle = np.arccos(min(max(along / (np.sqrt(pp * qq) + 1e-300), -1.0), 1.0))
            for m in range(3):
                vertex[triangles[t, k], m] += angle * face[t, m]
    return volume


@compiled
def longest_side(x, triangles):
    """Longest distance of a corner from the first corner of its triangle."""
    longest = 0.0
    for t in range(triangles.shape[0]):
        a = x[triangles[t, 0]]
        for k in (1, 2):
            b = x[triangles[t, k]]
            longest = max(longest, (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
    return np.sqrt(longest)


@compiled
def signed_distance(p, y, triangles, across, face, vertex, longest, share, best_share):
    """Distance of p to a closed surface, negative inside, and the triangle that is closest.

    `best_share` are the shares of its corners in the closest point, `across` (m, 3) the triangles
    over the edge opposite to each corner.
    """
    best, where = 1e300, -1
    for t in range(triangles.shape[0]):
        a = y[triangles[t, 0]]
        best = min(best, (p[0] - a[0]) ** 2 + (p[1] - a[1]) ** 2 + (p[2] - a[2]) ** 2)
    best *= 1.0 + 1e-12  # a corner is no better than itself
    limit = (np.sqrt(best) + longest) ** 2 * 1.0001
    for t in range(triangles.shape[0]):
        a = y[triangles[t, 0]]
        if (p[0] - a[0]) ** 2 + (p[1] - a[1]) ** 2 + (p[2] - a[2]) ** 2 > limit:
            continue
        b, c = y[triangles[t, 1]], y[triangles[t, 2]]
        square = square_to_triangle(p, a, b, c, share)
        if square < best or (where < 0 and square <= best):
            best, where = square, t
            limit = (np.sqrt(best) + longest) ** 2 * 1.0001
            best_share[0], best_share[1], best_share[2] = share[0], share[1], share[2]
    zeros, corner, edge = 0, 0, 0
    for k in range(3):
        if best_share[k] == 0.0:
            zeros += 1
            edge = k
        else:
            corner = k
    height = 0.0
    for m in range(3):
        if zeros == 2:
            n = vertex[triangles[where, corner], m]
        else:
            n = face[where, m]
            if zeros == 1:
                n += face[across[where, edge], m]
        r = p[m]
        for k in range(3):
            r -= best_share[k] * y[triangles[where, k], m]
        height += n * r
    distance = np.sqrt(best)
    return (distance if height >= 0.0 else -distance), where


@compiled
def _cut(piece, segment, stack, held):
    """Put the halves of a segment, or the quarters of a triangle, on a stack; its new height."""
    for m in range(3):
        a, b, c = piece[0, m], piece[1, m], piece[2, m]
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        stack[held, 0, m], stack[held, 1, m], stack[held, 2, m] = a, ab, ca
        if segment:
            stack[held + 1, 0, m], stack[held + 1, 1, m], stack[held + 1, 2, m] = ab, b, b
        else:
            stack[held + 1, 0, m], stack[held + 1, 1, m], stack[held + 1, 2, m] = b, bc, ab
            stack[held + 2, 0, m], stack[held + 2, 1, m], stack[held + 2, 2, m] = c, ca, bc
            stack[held + 3, 0, m], stack[held + 3, 1, m], stack[held + 3, 2, m] = ab, bc, ca
    return held + (2 if segment else 4)


@compiled
def deepest(x, tx, crossing, y, ty, across, face, vertex, longest, tolerance):
    """Greatest depth under the surface y of a point of the triangles x; 0 where none is inside.

    `crossing` are those that go through y; all others are inside or outside as their corners.
    Triangles are cut in four until what is left cannot be deeper by more than `tolerance`: depth
    changes no faster than the place, and no point of a piece is deeper than its corners are far
    from one triangle of y (Lipschitz and convexity of the distance).
    """
    share, best_share, c, best = np.empty(3), np.empty(3), np.empty(3), 0.0
    inside = np.zeros(x.shape[0], dtype=np.bool_)
    for i in range(x.shape[0]):
        d, _ = signed_distance(x[i], y, ty, across, face, vertex, longest, share, best_share)
        inside[i] = d < 0.0
        best = max(best, -d)
    stack, piece = np.empty((400, 3, 3)), np.empty((3, 3))
    for t in range(tx.shape[0]):
        if not crossing[t] and not inside[tx[t, 0]]:
            continue
        for k in range(3):
            for m in range(3):
                stack[0, k, m] = x[tx[t, k], m]
        held = 1
        while held > 0:
            held -= 1
            for m in range(3):
                c[m] = 0.0
                for k in range(3):
                    piece[k, m] = stack[held, k, m]
                    c[m] += piece[k, m] / 3.0
            d, g = signed_distance(c, y, ty, across, face, vertex, longest, share, best_share)
            best = max(best, -d)
            reach, bound = 0.0, 0.0
            for k in range(3):
                far = 0.0
                for m in range(3):
                    far += (piece[k, m] - c[m]) ** 2
                reach = max(reach, far)
                square = square_to_triangle(piece[k], y[ty[g, 0]], y[ty[g, 1]], y[ty[g, 2]], share)
                bound = max(bound, square)
            bound = min(np.sqrt(reach) - d, np.sqrt(bound))
            if bound <= best + tolerance or held + 4 > stack.shape[0]:
                continue
            held = _cut(piece, tx[t, 1] == tx[t, 2], stack, held)
    return best


@compiled
def deepest_inside(points, x, tx, ax, fx, vx, lx, y, ty, ay, fy, vy, ly):
    """Greatest depth under either of two surfaces of the points that lie in both; 0 without one."""
    share, best_share, best = np.empty(3), np.empty(3), 0.0
    for i in range(points.shape[0]):
        d, _ = signed_distance(points[i], x, tx, ax, fx, vx, lx, share, best_share)
        if d > 0.0:
            continue
        e, _ = signed_distance(points[i], y, ty, ay, fy, vy, ly, share, best_share)
        if e <= 0.0:
            best = max(best, -d, -e)
    return best
