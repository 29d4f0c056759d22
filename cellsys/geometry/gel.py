"""A gel of fibres in space: cylinder or box along x, cavities for its cells, relaxed modulus.

The length of a fibre is that of the material (its pore size), not that of a grid: what a gel does
depends on how many nodes it has, which belongs to every number that is told of it
[notes: matrix, gel].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from scipy.sparse.csgraph import connected_components

from cellsys.errors import DataError, ParameterError
from cellsys.geometry.disc import COORDINATION, StiffnessAssembly, connect
from cellsys.geometry.network import FibreNetwork, spread_nodes

GRIP = 3.0  # um at either end that are held
MARGIN = 0.3  # um between a cell and the nearest nodes
FLOPPY = 6.0  # fibres per node: central forces alone are rigid above
LEAST_FIBRES = 3  # of a node in space: with fewer it is not held
SHELL = 1.5  # spacings: enough nodes in a slice of 10 um for a mean
_SOLVED = 1e-8  # residual of the relaxed test; the energy is off by its square
_WEAK = 1e-6  # of the mean stiffness of a fibre: a spring at every node of the test
_HANGING = 0.05  # of the nodes may be left hanging by cavities and taken away with them


@dataclass(frozen=True, eq=False, kw_only=True)
class Gel(FibreNetwork):
    """A network of fibres in space, its axis x.

    Parameters
    ----------
    shape : {"cylinder", "box"}
    size : (float, float, float)
        Along x, y and z, um; a cylinder's y and z are its diameter.
    surface : int array
        Nodes that adhesions can reach: all that are not held. The rest is that of
        `FibreNetwork`.
    lateral : int array
        Nodes of the lateral boundary, within `SHELL` spacings of it.
    """

    shape: str
    size: tuple[float, float, float]
    lateral: np.ndarray

    def describe(self) -> dict[str, np.ndarray]:
        """With its lateral boundary and size."""
        lateral = {"matrix.lateral": self.lateral, "matrix.outward": self.outward}
        return {**super().describe(), **lateral, "matrix.size": np.array(self.size)}

    @property
    def outward(self) -> np.ndarray:
        """Unit normals of the lateral boundary at its nodes (n_lateral, 3)."""
        x = self.position[self.lateral] * np.array([0.0, 1.0, 1.0])
        if self.shape == "box":
            depth = 0.5 * np.asarray(self.size) - np.abs(x)
            near = depth[:, 1] <= depth[:, 2]
            x = x * np.column_stack([0.0 * near, near, ~near])
        return x / np.linalg.norm(x, axis=1, keepdims=True)

    @property
    def spacing(self) -> float:
        """Volume per node to the power 1/3, um."""
        return float(np.cbrt(volume_of(self.shape, self.size) / len(self.position)))


def volume_of(shape: str, size: tuple[float, float, float]) -> float:
    """Volume, um^3, of a cylinder or a box of this size."""
    return float(np.prod(size)) * (0.25 * np.pi if shape == "cylinder" else 1.0)


def depth_of(shape: str, size: tuple[float, float, float], x: np.ndarray) -> np.ndarray:
    """How far points (n, 3) lie inside the lateral boundary (n,), um."""
    if shape == "cylinder":
        return 0.5 * size[1] - np.hypot(x[:, 1], x[:, 2])
    return np.minimum(0.5 * size[1] - np.abs(x[:, 1]), 0.5 * size[2] - np.abs(x[:, 2]))


def relaxed_uniaxial_modulus(
    x: np.ndarray, fibres: np.ndarray, stiffness: np.ndarray, held: np.ndarray, volume: float
) -> float:
    """Young's modulus E, pN/um^2: the `held` ends gripped and moved along x, all else relaxed.

        U = E eps^2 V/2 at unit strain eps; the lateral surface is free.

    Raises
    ------
    DataError
        When the network is too floppy for the test to converge.
    """
    K = StiffnessAssembly(len(x), fibres)(x, stiffness, np.zeros(len(fibres)))
    u = np.zeros_like(x)
    u[:, 0] = x[:, 0]
    given = np.zeros(x.shape, bool)
    given[held] = True
    free = np.flatnonzero(~given.ravel())
    rows = sp.csr_array(K)[free]
    # Hardly any: networks of few fibres have motions that cost nothing.
    A = sp.csr_array(rows[:, free] + sp.diags_array(np.full(len(free), _WEAK * stiffness.mean())))
    load = -(rows @ np.where(given, u, 0.0).ravel())
    scale = 1.0 / np.maximum(A.diagonal(), 1e-12)
    preconditioner = sp.diags_array(scale)
    found, failed = spla.cg(
        A, load, x0=u.ravel()[free], rtol=_SOLVED, maxiter=20_000, M=preconditioner
    )
    if failed:
        raise DataError(
            f"the relaxed test of a network of {len(x)} nodes and {len(fibres)} fibres does not "
            "converge: it is floppy; raise matrix.coordination"
        )
    full = u.ravel().copy()
    full[free] = found
    return float(full @ (K @ full)) / volume


def _lateral(shape: str, size: tuple[float, float, float], x: np.ndarray) -> np.ndarray:
    """Nodes within `SHELL` spacings of the lateral boundary."""
    spacing = np.cbrt(volume_of(shape, size) / len(x))
    return np.flatnonzero(depth_of(shape, size, x) < SHELL * spacing)


@lru_cache(maxsize=4)
def _network(
    shape: str, size: tuple[float, float, float], n_nodes: int, coordination: float, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Nodes, fibres, held ends and the modulus of fibres of EA = 1 pN, without cavities."""
    rng = np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(103,)))

    def throw(batch: int) -> np.ndarray:
        along = size[0] * rng.uniform(-0.5, 0.5, batch)
        if shape == "box":
            across = np.asarray(size[1:]) * rng.uniform(-0.5, 0.5, (batch, 2))
            return np.column_stack([along, across])
        angle = rng.uniform(0, 2 * np.pi, batch)
        r = 0.5 * size[1] * np.sqrt(rng.uniform(0, 1, batch))
        return np.column_stack([along, r * np.cos(angle), r * np.sin(angle)])

    volume = volume_of(shape, size)
    x = spread_nodes(throw, volume, n_nodes)
    fibres = connect(x, coordination)
    length = np.linalg.norm(x[fibres[:, 1]] - x[fibres[:, 0]], axis=1)
    held = np.abs(x[:, 0]) > 0.5 * size[0] - GRIP
    modulus = relaxed_uniaxial_modulus(x, fibres, 1.0 / length, held, volume)
    return x, fibres, held, modulus


def gel(
    size: tuple[float, float, float],
    modulus: float,
    *,
    n_nodes: int,
    shape: str = "cylinder",
    coordination: float = COORDINATION,
    ends: str = "clamped",
    cavities: tuple[tuple[float, float, float, float], ...] = (),
    seed: int = 0,
) -> Gel:
    """Random fibre gel along x, of Young's modulus `modulus` by a relaxed uniaxial test.

    All fibres have the same EA, such that the network without cavities has the modulus (fibres
    unbuckled). Then nodes inside the cavities are taken out, and with them those that are left
    with fewer than `LEAST_FIBRES` fibres.

    Parameters
    ----------
    size : (float, float, float)
        Along x, y, z, um.
    modulus : float
        pN/um^2 (Pa).
    n_nodes : int
        Of the network without cavities.
    ends : {"clamped", "free"}
        Whether the `GRIP` um at either end are held.
    cavities : tuple of (x, y, z, radius)
        Places of cells, um; nodes stay `MARGIN` away.
    seed : int
        The same seed gives the same network.

    Raises
    ------
    ParameterError
        A size, a modulus or a number of nodes out of its range.
    DataError
        A cavity that leaves fibres hanging, or a network too floppy to have a modulus.
    """
    for name, value in (("length", size[0]), ("width", size[1]), ("height", size[2]),
                        ("modulus", modulus)):  # fmt: skip
        if not (np.isfinite(value) and value > 0):
            raise ParameterError(f"gel {name} must be finite and > 0, got {value!r}")
    if n_nodes < 50:
        raise ParameterError(f"a gel of {n_nodes} nodes is too coarse; use at least 50")
    x, fibres, held, unit = _network(shape, size, int(n_nodes), coordination, seed)
    keep = np.ones(len(x), bool)
    for *centre, radius in cavities:
        keep &= np.linalg.norm(x - centre, axis=1) > radius + MARGIN
    inside = int((~keep).sum())
    whole = keep[fibres].all(axis=1)
    while True:
        count = np.bincount(fibres[whole].ravel(), minlength=len(x))
        loose = keep & (count < LEAST_FIBRES)
        if not loose.any():
            break
        keep &= ~loose
        whole = keep[fibres].all(axis=1)
    hanging = len(x) - inside - int(keep.sum())
    label = np.cumsum(keep) - 1
    kept, pairs = x[keep], label[fibres[whole]]
    _check_one_piece(kept, pairs, hanging, len(cavities))
    length = np.linalg.norm(kept[pairs[:, 1]] - kept[pairs[:, 0]], axis=1)
    clamped = held[keep] if ends == "clamped" else np.zeros(len(kept), bool)
    return Gel(
        shape=shape,
        size=size,
        position=kept,
        fibres=pairs,
        length=length,
        stiffness=modulus / unit / length,
        clamped=clamped,
        surface=np.flatnonzero(~clamped),
        lateral=_lateral(shape, size, kept),
    )


def _check_one_piece(x: np.ndarray, fibres: np.ndarray, hanging: int, cavities: int) -> None:
    """Refuse a network that the cavities have cut, or left full of loose ends."""
    if len(fibres):
        ones = np.ones(len(fibres))
        graph = sp.coo_array((ones, (fibres[:, 0], fibres[:, 1])), (len(x), len(x)))
        pieces, label = connected_components(graph, directed=False)
        loose = len(x) - int(np.bincount(label).max())
    else:
        pieces, loose = 2, len(x)
    if pieces > 1:
        raise DataError(
            f"the cavities of {cavities} cells leave {loose} nodes of the gel hanging in "
            f"{pieces - 1} pieces that nothing holds; move the cells inward and apart, widen the "
            "gel, or set more matrix.nodes"
        )
    if hanging > _HANGING * len(x):
        raise DataError(
            f"the cavities of {cavities} cells leave {hanging} nodes of {len(x)} with fewer than "
            f"{LEAST_FIBRES} fibres, more than {100 * _HANGING:g} %; set more matrix.nodes, or "
            "take smaller or fewer cells"
        )
