"""Compiled loops of the sparse Cholesky factorisation in `cellsys.mechanics.cholesky`."""

from __future__ import annotations

import numpy as np

from cellsys.compiled import compiled


@compiled
def elimination_tree(indptr, indices, parent, count):
    """Parent (-1: root) and number of entries below the diagonal of every column of L.

    indptr, indices: compressed columns of a symmetric pattern. A row of L is the part of the
    tree that is reached from the entries of the matrix's row [Liu 1990].
    """
    n = parent.size
    parent[:] = -1
    ancestor = np.full(n, -1)
    for k in range(n):
        for e in range(indptr[k], indptr[k + 1]):
            i = indices[e]
            while i != -1 and i < k:
                above = ancestor[i]
                ancestor[i] = k
                if above == -1:
                    parent[i] = k
                i = above
    seen = np.full(n, -1)
    count[:] = 0
    for k in range(n):
        seen[k] = k
        for e in range(indptr[k], indptr[k + 1]):
            i = indices[e]
            while i < k and seen[i] != k:
                count[i] += 1
                seen[i] = k
                i = parent[i]


@compiled
def column_rows(indptr, indices, parent, start, rows):
    """Rows below the diagonal of every column of L, increasing; column j from start[j] on."""
    n = parent.size
    fill = start[:n].copy()
    seen = np.full(n, -1)
    for k in range(n):
        seen[k] = k
        for e in range(indptr[k], indptr[k + 1]):
            i = indices[e]
            while i < k and seen[i] != k:
                rows[fill[i]] = k
                fill[i] += 1
                seen[i] = k
                i = parent[i]


@compiled(vector=True)
def factorise(
    values, source, target, entries, first, start, rows, place, children, front, stack,
    panels, panel_at, corners, corner_at,
):  # fmt: skip
    """Multifrontal factorisation; returns the first column without a positive pivot, or -1.

    Supernode s: columns first[s]:first[s+1] and, below them, rows[start[s]:start[s+1]]. With its
    front [[A, B], [B^T, C]] it keeps S = A^-1 in `corners` and B^T S, row by row of S, in
    `panels`, and passes C - B^T S B to its parent, into whose front `place` maps its rows.
    """
    top = 0
    for s in range(first.size - 1):
        w = first[s + 1] - first[s]
        r = start[s + 1] - start[s]
        m = w + r
        f = front[: m * m].reshape((m, m))
        flat = front[: m * m]
        for e in range(m * m):
            flat[e] = 0.0
        for e in range(entries[s], entries[s + 1]):
            flat[target[e]] += values[source[e]]
        # The children lie on top of the stack, the last one uppermost.
        end = s - 1
        for _ in range(children[s]):
            size = start[end + 1] - start[end]
            top -= size * size
            update = stack[top : top + size * size].reshape((size, size))
            at = place[start[end] : start[end + 1]]
            for i in range(size):
                for j in range(i, size):
                    f[at[i], at[j]] += update[i, j]
            # Next child: the one before this child's whole subtree.
            end = _before(children, end)
        for i in range(w):
            for j in range(i):
                f[i, j] = f[j, i]
        across = stack[top + r * r : top + r * r + w * r].reshape((w, r))
        for i in range(w):
            for j in range(r):
                across[i, j] = f[i, w + j]
        for k in range(w):
            pivot = f[k, k]
            if not pivot > 0.0:
                return first[s] + k
            f[k, k] = 1.0
            p = f[k]
            for j in range(m):
                p[j] /= pivot
            for i in range(w):
                if i != k:
                    row = f[i]
                    factor = row[k]
                    row[k] = 0.0
                    for j in range(m):
                        row[j] -= factor * p[j]
        corner = corners[corner_at[s] : corner_at[s + 1]].reshape((w, w))
        panel = panels[panel_at[s] : panel_at[s + 1]].reshape((w, r))
        for i in range(w):
            for j in range(w):
                corner[i, j] = f[i, j]
            for j in range(r):
                panel[i, j] = f[i, w + j]
        update = stack[top : top + r * r].reshape((r, r))
        for i in range(r):
            row = update[i]
            for j in range(i, r):
                row[j] = f[w + i, w + j]
            k = 0
            while k + 4 <= w:
                a, b, c, d = across[k, i], across[k + 1, i], across[k + 2, i], across[k + 3, i]
                p, q, u, v = panel[k], panel[k + 1], panel[k + 2], panel[k + 3]
                for j in range(i, r):
                    row[j] -= a * p[j] + b * q[j] + c * u[j] + d * v[j]
                k += 4
            while k < w:
                a, p = across[k, i], panel[k]
                for j in range(i, r):
                    row[j] -= a * p[j]
                k += 1
        top += r * r
    return -1


@compiled
def _before(children, s):
    """The supernode just before the subtree of s in postorder."""
    wanted = 1
    while wanted > 0:
        wanted += children[s] - 1
        s -= 1
    return s


@compiled(vector=True)
def solve(at, first, start, rows, panels, panel_at, corners, corner_at, work, rhs, out):
    """out[at] = A^-1 rhs[at] by the panels B^T S and corners S of `factorise`; work: (2 n,).

    at (n, k): where the n unknowns, in the order of the factor, lie in the vectors rhs and out, k
    right-hand sides one after the other.
    """
    for column in range(at.shape[1]):
        _solve(at, first, start, rows, panels, panel_at, corners, corner_at, work, rhs, out,
               column)  # fmt: skip


@compiled(vector=True)
def _solve(
    places, first, start, rows, panels, panel_at, corners, corner_at, work, rhs, out, column
):  # fmt: skip
    n = places.shape[0]
    b = work[:n]
    for i in range(n):
        b[i] = rhs[places[i, column]]
    for s in range(first.size - 1):
        c, w = first[s], first[s + 1] - first[s]
        r = start[s + 1] - start[s]
        if r == 0:
            continue
        panel = panels[panel_at[s] : panel_at[s + 1]].reshape((w, r))
        at = rows[start[s] : start[s + 1]]
        below = work[n : n + r]
        below[:] = 0.0
        k = 0
        while k + 4 <= w:
            p, q, u, v = panel[k], panel[k + 1], panel[k + 2], panel[k + 3]
            b0, b1, b2, b3 = b[c + k], b[c + k + 1], b[c + k + 2], b[c + k + 3]
            for i in range(r):
                below[i] += p[i] * b0 + q[i] * b1 + u[i] * b2 + v[i] * b3
            k += 4
        while k < w:
            p, b0 = panel[k], b[c + k]
            for i in range(r):
                below[i] += p[i] * b0
            k += 1
        for i in range(r):
            b[at[i]] -= below[i]
    for s in range(first.size - 2, -1, -1):
        c, w = first[s], first[s + 1] - first[s]
        r = start[s + 1] - start[s]
        panel = panels[panel_at[s] : panel_at[s + 1]].reshape((w, r))
        corner = corners[corner_at[s] : corner_at[s + 1]].reshape((w, w))
        at = rows[start[s] : start[s + 1]]
        below, inner = work[n : n + r], work[n + r : n + r + w]
        for i in range(r):
            below[i] = b[at[i]]
        inner[:] = 0.0
        for k in range(w):
            b0, row = b[c + k], corner[k]
            for i in range(w):
                inner[i] += row[i] * b0
        k = 0
        while k + 4 <= w:
            p, q, u, v = panel[k], panel[k + 1], panel[k + 2], panel[k + 3]
            s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
            for i in range(r):
                s0 += p[i] * below[i]
                s1 += q[i] * below[i]
                s2 += u[i] * below[i]
                s3 += v[i] * below[i]
            b[c + k] = inner[k] - s0
            b[c + k + 1] = inner[k + 1] - s1
            b[c + k + 2] = inner[k + 2] - s2
            b[c + k + 3] = inner[k + 3] - s3
            k += 4
        while k < w:
            p = panel[k]
            s0 = 0.0
            for i in range(r):
                s0 += p[i] * below[i]
            b[c + k] = inner[k] - s0
            k += 1
    for i in range(n):
        out[places[i, column]] = b[i]
