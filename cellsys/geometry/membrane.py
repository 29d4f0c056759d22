"""Closed triangulated membrane: golden-spiral sphere and its measures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cellsys.compiled import compiled
from cellsys.errors import ParameterError
from cellsys.geometry.surface import Mesh, convex_triangles

NODES = 189  # thesis code, Appendix A.1


@dataclass(frozen=True, eq=False)
class Membrane:
    """Connectivity and rest shape of one closed membrane.

    Parameters
    ----------
    position : array (n, 3)
        Initial node positions, um.
    triangles : int array (2 n - 4, 3)
        Outward oriented.
    edges : int array (3 n - 6, 2)
        Each edge once.
    """

    position: np.ndarray
    triangles: np.ndarray
    edges: np.ndarray

    @cached_property
    def edge_length(self) -> np.ndarray:
        """Initial edge lengths (n_edges,), um."""
        a, b = self.edges.T
        return np.linalg.norm(self.position[b] - self.position[a], axis=1)

    @cached_property
    def triangle_area(self) -> np.ndarray:
        """Initial triangle areas (n_triangles,), um^2."""
        a, b, c = (self.position[self.triangles[:, i]] for i in range(3))
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)

    @cached_property
    def mesh(self) -> Mesh:
        """The triangles as a closed surface."""
        return Mesh(self.triangles)

    @cached_property
    def volume(self) -> float:
        """Initial enclosed volume, um^3."""
        return enclosed_volume(self.position, self.triangles)


def sphere(radius: float, center: tuple[float, float, float], n_nodes: int = NODES) -> Membrane:
    """Golden-spiral sphere, triangulated by its convex hull, oriented outward.

    Node k lies at cos(theta) = 1 - 2 (k + 1/2)/n, phi = pi (1 + sqrt 5)(k + 1/2).

    Raises
    ------
    ParameterError
        For radius <= 0 or fewer than 12 nodes.
    """
    if not radius > 0:
        raise ParameterError(f"radius must be > 0 um, got {radius!r}")
    if n_nodes < 12:
        raise ParameterError(f"a membrane needs at least 12 nodes, got {n_nodes!r}")
    k = np.arange(n_nodes) + 0.5
    theta, phi = np.arccos(1.0 - 2.0 * k / n_nodes), np.pi * (1.0 + np.sqrt(5.0)) * k
    unit = np.column_stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    )
    triangles = convex_triangles(unit)
    pairs = np.sort(
        np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    )
    edges = np.unique(pairs, axis=0)
    return Membrane(radius * unit + np.asarray(center, float), triangles, edges)


def enclosed_volume(position: np.ndarray, triangles: np.ndarray) -> float:
    """Signed volume, um^3: sum over triangles of a . (b x c) / 6, about the centroid."""
    p = position - position.mean(axis=0)
    a, b, c = (p[triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


@compiled
def volume_gradient(position, triangles, gradient):
    """Volume and its gradient dV/dx_k = sum of (b - a) x (c - a) / 6 over triangles at k."""
    gradient[:] = 0.0
    volume = 0.0
    origin = position[0]
    for t in range(triangles.shape[0]):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        a0, a1, a2 = position[i, 0], position[i, 1], position[i, 2]
        b0, b1, b2 = position[j, 0] - a0, position[j, 1] - a1, position[j, 2] - a2
        c0, c1, c2 = position[k, 0] - a0, position[k, 1] - a1, position[k, 2] - a2
        n0 = (b1 * c2 - b2 * c1) / 6.0
        n1 = (b2 * c0 - b0 * c2) / 6.0
        n2 = (b0 * c1 - b1 * c0) / 6.0
        volume += (a0 - origin[0]) * n0 + (a1 - origin[1]) * n1 + (a2 - origin[2]) * n2
        for node in (i, j, k):
            gradient[node, 0] += n0
            gradient[node, 1] += n1
            gradient[node, 2] += n2
    return volume
