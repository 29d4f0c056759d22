"""Compiled recursions of training: the roll-out and its adjoint, row by row.

A step of a few rows of a few states is less work than calling numpy for it. The same in numpy is
in the tests.
"""

from __future__ import annotations

import numpy as np

from cellsys.compiled import compiled


@compiled(vector=True)
def forward(A: np.ndarray, x: np.ndarray) -> None:
    """x_k+1 += x_k A_k in place; A (K, m, m), x (K + 1, R, m) holding x_0 and the drive."""
    K, m = A.shape[0], A.shape[1]
    for k in range(K):
        for r in range(x.shape[1]):
            for i in range(m):
                value = x[k, r, i]
                for j in range(m):
                    x[k + 1, r, j] += value * A[k, i, j]


@compiled(vector=True)
def backward(A: np.ndarray, x: np.ndarray) -> None:
    """x_k += x_k+1 A_k for k = K - 1 .. 1 in place; shapes as in `forward`."""
    m = A.shape[1]
    for k in range(A.shape[0] - 1, 0, -1):
        for r in range(x.shape[1]):
            for i in range(m):
                value = x[k + 1, r, i]
                for j in range(m):
                    x[k, r, j] += value * A[k, i, j]
