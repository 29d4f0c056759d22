"""Where a port touches the matrix, and a plain linear matrix to touch.

E (n_f, order) gathers y = E q' at a place; its transpose scatters loads, E^T f. One E for both
is what makes the exchange conserve power.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import MatrixField
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.shown import Shown
from cellsys.system import is_sparse
from cellsys.units import real_array


@checked
@dataclass(frozen=True)
class PatchPort:
    """Total force of a cell on the nodes within `radius` of its place, weight 1 - (r/radius)^2.

    Parameters
    ----------
    radius : float
        um.
    components : int
        2 (in the plane) or 3.
    turns : bool
        Loads are given in the cell's frame, turned by its heading.
    """

    radius: float = 8.0
    components: int = 2
    turns: bool = True

    def __post_init__(self) -> None:
        if not (np.isfinite(self.radius) and self.radius > 0):
            raise ParameterError(f"PatchPort.radius must be > 0 um, got {self.radius!r}")
        if self.components not in (2, 3):
            raise ParameterError(f"components must be 2 or 3, got {self.components!r}")

    @property
    def n_loads(self) -> int:
        """Number of load coordinates."""
        return self.components

    def gather(self, field: MatrixField, position: np.ndarray, heading: float) -> np.ndarray:
        """E (components, order) at a place; ParameterError when no node lies under it."""
        surface = np.asarray(field.surface)
        offset = np.asarray(field.nodes)[surface, :2] - np.asarray(position)[:2]
        share = 1.0 - (offset**2).sum(axis=1) / self.radius**2
        under = share > 0
        if not under.any():
            raise ParameterError(
                f"no matrix node within {self.radius:g} um of {np.asarray(position)[:2]}; move the "
                "cell onto the matrix"
            )
        weight = share[under] / share[under].sum()
        force = np.zeros((self.components, *np.shape(field.nodes)))
        for i in range(self.components):
            force[i, surface[under], i] = weight
        E = field.project(force)
        if not self.turns:
            return E
        c, s = np.cos(heading), np.sin(heading)
        turn = np.eye(self.components)
        turn[:2, :2] = [[c, s], [-s, c]]
        return turn @ E


@checked
@dataclass(frozen=True, eq=False)
class LinearField:
    """A linear elastic matrix in nodal coordinates: C q' = -K q + load.

    Parameters
    ----------
    nodes : (n, 3)
        Rest positions, um.
    stiffness : (3 n, 3 n)
        K, pN/um, node-major.
    drag : float
        C_e of every node, pN s/um.
    """

    nodes: np.ndarray
    stiffness: np.ndarray
    drag: float = 1.0

    def __post_init__(self) -> None:
        nodes = real_array(self.nodes, "nodes").copy()
        K = real_array(self.stiffness, "stiffness").copy()
        if nodes.ndim != 2 or nodes.shape[1] != 3 or K.shape != (nodes.size, nodes.size):
            raise DimensionError(
                f"nodes must be (n, 3) and stiffness (3 n, 3 n), got {nodes.shape}, {K.shape}"
            )
        if not (np.all(np.isfinite(nodes)) and np.all(np.isfinite(K))):
            raise DataError("nodes or stiffness hold NaN or inf")
        if not (np.isfinite(self.drag) and self.drag > 0):
            raise ParameterError(f"drag must be > 0 pN s/um, got {self.drag!r}")
        object.__setattr__(self, "nodes", nodes)
        object.__setattr__(self, "stiffness", K)

    @property
    def order(self) -> int:
        """Number of coordinates, 3 n."""
        return self.nodes.size

    @property
    def surface(self) -> np.ndarray:
        """All nodes."""
        return np.arange(len(self.nodes))

    def project(self, f: np.ndarray) -> np.ndarray:
        """Nodal loads (..., n, 3) as loads on the coordinates (..., 3 n)."""
        return np.asarray(f, float).reshape(*np.shape(f)[:-2], -1)

    def displacement(self, q: np.ndarray) -> np.ndarray:
        """(..., 3 n) as (..., n, 3)."""
        return np.asarray(q, float).reshape(*np.shape(q)[:-1], -1, 3)


@dataclass(frozen=True)
class RestPassivity(Shown):
    """Passivity of the matrix C q' = -K q + load at every port E that gathers as it scatters.

    Attributes
    ----------
    drag : float
    softest : float
        Smallest eigenvalue of K over its largest; >= 0 for a storage q^T K q / 2 >= 0.
    asymmetry : float
        |K - K^T| / |K|.
    certified : bool
    """

    drag: float
    softest: float
    asymmetry: float
    certified: bool

    def __str__(self) -> str:
        kind = "certified" if self.certified else "not certified"
        return (
            f"matrix {kind}: softest over stiffest {self.softest:.2g}, asymmetry "
            f"{self.asymmetry:.1e}, drag {self.drag:g} pN s/um"
        )


def dense_stiffness(field: MatrixField) -> np.ndarray:
    """Hess U at rest (order, order) as a dense array, pN/um."""
    K = field.stiffness
    return np.asarray(K.toarray() if is_sparse(K) else K, dtype=float)


def field_passivity(field: MatrixField) -> RestPassivity:
    """Check K >= 0 and symmetric, drag > 0, of the field at rest."""
    K = dense_stiffness(field)
    size = float(np.abs(K).max(initial=0.0))
    values = sla.eigvalsh(0.5 * (K + K.T))
    softest = float(values[0] / max(values[-1], 1e-300))
    asymmetry = float(np.abs(K - K.T).max(initial=0.0)) / max(size, 1e-300)
    rounding = 1e-14 * len(K)
    drag = float(field.drag)
    return RestPassivity(
        drag, softest, asymmetry, softest >= -rounding and asymmetry <= rounding and drag > 0
    )
