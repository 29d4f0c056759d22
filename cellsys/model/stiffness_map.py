"""The stiffness of a network at rest about a place: its moment, its direction, its contrast."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellsys.errors import DataError, DimensionError
from cellsys.laws.sensing import contrast, measure_moment

REACH = 14.0  # um, sensing range of the full-order model
INNER = 4.0  # um, inner radius of the shell in which stress is read


@dataclass(frozen=True, eq=False)
class StiffnessMap:
    """s(c) from nodal stiffness at rest.

    Parameters
    ----------
    nodes : (N, 2)
        um.
    stiffness : (N,)
        Sum over the fibres at each node, pN/um.
    reach : float
        um.
    contrasts : bool
        The stiffness is the mean over the fibres at each node, and read as a contrast g_0(c).
    """

    nodes: np.ndarray
    stiffness: np.ndarray
    reach: float = REACH
    contrasts: bool = False

    def __post_init__(self) -> None:
        nodes, stiffness = (np.asarray(v, dtype=float) for v in (self.nodes, self.stiffness))
        if nodes.ndim != 2 or nodes.shape[1] != 2 or stiffness.shape != (len(nodes),):
            raise DimensionError(
                f"a stiffness map needs nodes (N, 2) and stiffness (N,), got {nodes.shape} and "
                f"{stiffness.shape}"
            )
        if not (np.all(np.isfinite(nodes)) and np.all(np.isfinite(stiffness))):
            raise DataError("nodes or stiffness of a stiffness map hold NaN or inf")
        object.__setattr__(self, "nodes", nodes)
        object.__setattr__(self, "stiffness", stiffness)

    def moment(self, place: np.ndarray) -> np.ndarray:
        """q_0 (..., 2), pN/um, zero where nothing stands out; or the contrast g_0."""
        place = np.asarray(place, dtype=float)
        if place.ndim > 1:
            return np.array([self.moment(c) for c in place])
        if self.contrasts:
            return contrast(self.nodes, self.stiffness, place, self.reach)
        q, total = measure_moment(self.nodes, self.stiffness, place, 0.0, self.reach)
        return q if float(np.hypot(*q)) > 1e-12 * total else np.zeros(2)

    def at(self, place: np.ndarray) -> np.ndarray:
        """Unit direction s (..., 2), zero where nothing stands out; or the contrast g_0."""
        moment = self.moment(place)
        return moment if self.contrasts else unit_rows(moment)

    def slope(self, place: np.ndarray, h: float = 1e-3) -> np.ndarray:
        """dq_0/dc (2, 2), pN/um^2, by central differences."""
        place = np.asarray(place, dtype=float)
        ends = [(self.moment(place + e), self.moment(place - e)) for e in h * np.eye(2)]
        return np.column_stack([(a - b) / (2 * h) for a, b in ends])


def unit_rows(q: np.ndarray) -> np.ndarray:
    """Directions (..., 2); zero stays zero."""
    size = np.hypot(q[..., :1], q[..., 1:])
    return np.divide(q, size, out=np.zeros_like(q), where=size > 0)
