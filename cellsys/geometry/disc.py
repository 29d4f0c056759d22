"""Fibre-network disc: nodes, fibres, clamped rim, and its stiffness by a relaxed test."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from scipy.spatial import cKDTree

from cellsys.errors import ParameterError
from cellsys.geometry.network import FibreNetwork, spread_nodes

DENSITY = 2000.0 / (np.pi * 30.0**2 * 2.0)  # nodes per um^3: 2000 in the thesis's disc
COORDINATION = 9.0  # fibres per node: central-force networks are rigid above 6
RIM = 0.947  # nodes beyond this share of the radius are clamped (28.4 of 30 um)
SURFACE_DEPTH = 0.7  # um: nodes this close to the top plane carry adhesions


@dataclass(frozen=True, eq=False, kw_only=True)
class Disc(FibreNetwork):
    """A network of fibres filling a flat cylinder, top plane z = 0.

    Parameters
    ----------
    radius, thickness : float
        um.
    clamped : bool array (n,)
        Rim nodes that do not move; the rest is that of `FibreNetwork`.
    """

    radius: float
    thickness: float

    @property
    def flat(self) -> bool:
        """Cells lie on it."""
        return True


def disc_nodes(
    radius: float, thickness: float, n_nodes: int, rng: np.random.Generator
) -> np.ndarray:
    """Random points in a flat cylinder, -thickness <= z <= 0, none closer than about 0.87 spacings.

    See `spread_nodes`.
    """

    def throw(batch: int) -> np.ndarray:
        angle, r = rng.uniform(0, 2 * np.pi, batch), radius * np.sqrt(rng.uniform(0, 1, batch))
        depth = -thickness * rng.uniform(0, 1, batch)
        return np.column_stack([r * np.cos(angle), r * np.sin(angle), depth])

    return spread_nodes(throw, np.pi * radius**2 * thickness, n_nodes)


def connect(x: np.ndarray, coordination: float) -> np.ndarray:
    """The n z / 2 shortest node pairs, plus the three nearest of every node (no free ends)."""
    n_fibres = round(0.5 * coordination * len(x))
    tree = cKDTree(x)
    spacing = float(np.median(np.asarray(tree.query(x, k=2)[0])[:, 1]))
    reach = 1.2 * spacing
    while True:
        pairs = tree.query_pairs(reach, output_type="ndarray")
        if len(pairs) >= n_fibres:
            break
        reach *= 1.1
    d = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1)
    pairs = pairs[np.argsort(d, kind="stable")[:n_fibres]]
    near = np.asarray(tree.query(x, k=4)[1])[:, 1:]
    extra = np.column_stack([np.repeat(np.arange(len(x)), 3), near.ravel()])
    return np.unique(np.sort(np.concatenate([pairs, extra]), axis=1), axis=0).astype(np.int64)


class StiffnessAssembly:
    """Stiffness matrices (3n, 3n) of one network for many geometries and fibre stiffnesses.

    K = sum over fibres of (a - b) n n^T + b I on the two ends, a along the fibre, b across it.
    The sparsity pattern is found once.
    """

    def __init__(self, n_nodes: int, fibres: np.ndarray) -> None:
        self.fibres, self.size = fibres, 3 * n_nodes
        dof = np.concatenate(
            [3 * fibres[:, [0]] + np.arange(3), 3 * fibres[:, [1]] + np.arange(3)], 1
        )
        key = np.tile(dof, (1, 6)) * self.size + np.repeat(dof, 6, axis=1)
        keys, place = np.unique(key.ravel(), return_inverse=True)
        self._place, self._n_entries = place.ravel(), len(keys)
        self._indices = (keys % self.size).astype(np.int32)
        self._indptr = np.searchsorted(keys // self.size, np.arange(self.size + 1)).astype(np.int32)

    def __call__(self, x: np.ndarray, along: np.ndarray, across: np.ndarray) -> sp.csc_array:
        """K, pN/um, for node positions x (n, 3) um and fibre stiffnesses (m,), pN/um."""
        d = x[self.fibres[:, 1]] - x[self.fibres[:, 0]]
        n = d / np.sqrt((d**2).sum(axis=1) + 1e-12)[:, None]
        block = (along - across)[:, None, None] * n[:, :, None] * n[:, None, :]
        block[:, [0, 1, 2], [0, 1, 2]] += across[:, None]
        both = np.concatenate(
            [np.concatenate([block, -block], axis=2), np.concatenate([-block, block], axis=2)], 1
        )
        data = np.bincount(self._place, both.ravel(), self._n_entries)
        return sp.csc_array((data, self._indices, self._indptr), (self.size, self.size))


def relaxed_shear_modulus(
    x: np.ndarray, fibres: np.ndarray, stiffness: np.ndarray, rim: np.ndarray, volume: float
) -> float:
    """Shear modulus G, pN/um^2: affine in-plane shear on the rim, interior relaxed.

    From the energy U = G gamma^2 V / 2 of unit pure shear; free faces. A weak vertical spring
    (1e-6 of the mean stiffness) removes bending mechanisms that cost no energy.
    """
    K = StiffnessAssembly(len(x), fibres)(x, stiffness, np.zeros(len(fibres)))
    K = sp.csc_array(K + sp.diags_array(np.full(K.shape[0], 1e-6 * float(stiffness.mean()))))
    u = np.zeros_like(x)
    u[:, 0], u[:, 1] = 0.5 * x[:, 1], 0.5 * x[:, 0]
    free = np.flatnonzero(~np.repeat(rim, 3))
    held = np.flatnonzero(np.repeat(rim, 3))
    full = u.ravel().copy()
    full[free] = -spla.spsolve(K[free][:, free], K[free][:, held] @ full[held])
    return float(full @ (K @ full)) / volume


@lru_cache(maxsize=8)
def _network(radius: float, thickness: float, n_nodes: int, coordination: float, seed: int):
    rng = np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(101,)))
    x = disc_nodes(radius, thickness, n_nodes, rng)
    fibres = connect(x, coordination)
    length = np.linalg.norm(x[fibres[:, 1]] - x[fibres[:, 0]], axis=1)
    clamped = np.hypot(x[:, 0], x[:, 1]) > RIM * radius
    volume = np.pi * radius**2 * thickness
    G = relaxed_shear_modulus(x, fibres, 1.0 / length, clamped, volume)
    surface = np.flatnonzero((x[:, 2] > -SURFACE_DEPTH) & ~clamped)
    return x, fibres, length, clamped, surface, G


def disc(
    radius: float,
    modulus: float,
    *,
    thickness: float = 2.0,
    n_nodes: int | None = None,
    coordination: float = COORDINATION,
    seed: int = 0,
) -> Disc:
    """Random fibre disc with Young's modulus `modulus` by a relaxed shear test.

    All fibres have the same EA; EA is such that 2.5 G = modulus, G from
    `relaxed_shear_modulus` (central-force solid: Poisson's ratio 1/4).

    Parameters
    ----------
    radius, thickness : float
        um.
    modulus : float
        pN/um^2 (Pa).
    n_nodes : int, optional
        Default: the thesis's density, 2000 nodes in 60 um x 2 um.
    seed : int
        Of the network; the same seed gives the same network.
    """
    for name, value in (("radius", radius), ("modulus", modulus), ("thickness", thickness)):
        if not (np.isfinite(value) and value > 0):
            raise ParameterError(f"matrix {name} must be finite and > 0, got {value!r}")
    count = round(DENSITY * np.pi * radius**2 * thickness) if n_nodes is None else int(n_nodes)
    if count < 50:
        raise ParameterError(
            f"a matrix of {count} nodes is too coarse; use at least 50 (a larger disc or n_nodes)"
        )
    x, fibres, length, clamped, surface, G = _network(radius, thickness, count, coordination, seed)
    EA = modulus / (2.5 * G)
    return Disc(
        radius=radius,
        thickness=thickness,
        position=x,
        fibres=fibres,
        length=length,
        stiffness=EA / length,
        clamped=clamped,
        surface=surface,
    )
