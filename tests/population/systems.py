"""Latent models with a given split between cell and matrix."""

import numpy as np
import scipy.linalg as sla

from cellsys.model import LatentModel, StiffnessSensor
from tests.reduction.systems import stable_matrix

HEADINGS = ("cell1.cos", "cell1.sin", "cell1.cos2", "cell1.sin2")


def basis(gap, rng, n_alpha=None, n_phi=None):
    """Orthonormal V whose V_alpha has singular values sqrt(gap); rows alpha first."""
    gap = np.asarray(gap, float)
    m = len(gap)
    n_alpha, n_phi = n_alpha or m + 3, n_phi or m + 5
    U = sla.qr(rng.standard_normal((n_alpha, m)), mode="economic")[0]
    F = sla.qr(rng.standard_normal((n_phi, m)), mode="economic")[0]
    W = sla.qr(rng.standard_normal((m, m)))[0]
    return np.vstack([U * np.sqrt(gap), F * np.sqrt(1 - gap)]) @ W.T, n_alpha


def model(m=6, seed=0, gap=None, A=None, steered=False, centred=False, slowest=0.02):
    """A stable cell with the split `gap` = 1 - lambda; headings and a sensor when steered."""
    rng = np.random.default_rng(seed)
    gap = rng.uniform(0.1, 0.9, m) if gap is None else np.asarray(gap, float)
    V, n_alpha = basis(gap, rng)
    A = stable_matrix(m, rng, slowest=slowest, fastest=10 * slowest) if A is None else A
    names = HEADINGS if steered else ("u",)
    sensor = None
    if steered:
        K_d = rng.standard_normal((3, 1 + m))
        K_d[2] = 0.0
        sensor = StiffnessSensor(K_d=K_d)
    return LatentModel(
        A=A,
        B=0.05 * rng.standard_normal((m, len(names))),
        offset=0.02 * rng.standard_normal(m),
        V=V,
        mean=rng.standard_normal(len(V)) if centred else None,
        blocks={"component": range(n_alpha), "field": range(n_alpha, len(V))},
        input_names=names,
        sensor=sensor,
        z_start=rng.standard_normal(m),
    )


def match(a, b):
    """Largest distance of two pole sets after the best pairing."""
    from scipy.optimize import linear_sum_assignment

    a, b = np.asarray(a, complex), np.asarray(b, complex)
    assert a.shape == b.shape, (a.shape, b.shape)
    distance = np.abs(a[:, None] - b[None])
    i, j = linear_sum_assignment(distance)
    return distance[i, j].max()
