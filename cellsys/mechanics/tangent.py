"""Sparse matrices that over-estimates of the tangent are put together from."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp


def laplacian(n: int, edges: np.ndarray, weight: np.ndarray) -> sp.csc_array:
    """Graph Laplacian (n, n) with one weight per edge."""
    i, j = edges.T
    rows, cols = np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])
    return sp.csc_array((np.concatenate([weight, weight, -weight, -weight]), (rows, cols)), (n, n))


def diagonal(values: np.ndarray) -> sp.csc_array:
    """Diagonal matrix in compressed columns."""
    return sp.csc_array(sp.diags_array(np.asarray(values, float)))
