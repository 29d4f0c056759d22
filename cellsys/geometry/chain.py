"""A 1-D matrix: nodes in a row between two walls, joined by equal springs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from cellsys.errors import DimensionError, ParameterError

# Numbers of a chain and of its cells lie within this factor of one unit: beyond, a run takes steps
# without end.
MOST = 1e9


@dataclass(frozen=True, kw_only=True)
class Chain:
    """N nodes at rest at i a, i = 1..N, between walls at 0 and (N + 1) a.

    Attached nodes have drag; the others are massless, so that the springs of a section between
    two attached nodes (or walls) l and r share its strain,

        e = (u_r - u_l)/((r - l) a) ,    T = stiffness (e + stiffening e^3)

    and thesis eq. 38's linear interpolation is their exact equilibrium.

    Parameters
    ----------
    nodes : int
        N.
    spacing : float
        a, um.
    stiffness : float
        Tension at unit strain, pN.
    stiffening : float
        Factor of the cubic term; 0 is the linear chain.
    drag : float
        Drag of an attached node, pN s/um.

    Notes
    -----
    Default numbers: a working set without dimensions [notes: mechanics, crawler].
    """

    nodes: int = 40
    spacing: float = 1.0
    stiffness: float = 100.0
    stiffening: float = 40.0
    drag: float = 0.5

    def __post_init__(self) -> None:
        if self.nodes < 2 or int(self.nodes) != self.nodes:
            raise ParameterError(f"Chain.nodes must be a whole number >= 2, got {self.nodes!r}")
        for name, unit in (("spacing", "um"), ("stiffness", "pN"), ("drag", "pN s/um")):
            value = getattr(self, name)
            if not 1.0 / MOST <= value <= MOST:
                raise ParameterError(
                    f"Chain.{name} must be > 0 {unit}, in [{1 / MOST:g}, {MOST:g}], got {value!r}"
                )
        if not 0 <= self.stiffening <= MOST:
            raise ParameterError(
                f"Chain.stiffening must be >= 0 and <= {MOST:g}, got {self.stiffening!r}"
            )

    @property
    def rest(self) -> np.ndarray:
        """Rest positions of the nodes (N,), um."""
        return self.spacing * np.arange(1, self.nodes + 1)

    def displacement(self, loads: np.ndarray) -> np.ndarray:
        """Static displacement (..., N), um, of the *linear* chain under nodal loads (..., N), pN.

        The chain's Green function: K u = f with K = stiffness/a tridiag(-1, 2, -1).
        """
        loads = np.asarray(loads, dtype=float)
        if loads.shape[-1:] != (self.nodes,):
            raise DimensionError(f"loads must end in {self.nodes} nodes, got {loads.shape}")
        k = self.stiffness / self.spacing
        bands = np.array([np.full(self.nodes, 2.0 * k), np.full(self.nodes, -k)])
        flat = loads.reshape(-1, self.nodes).T
        return sla.solveh_banded(bands, flat, lower=True).T.reshape(loads.shape)

    def loads(self, displacement: np.ndarray) -> np.ndarray:
        """Nodal loads (..., N), pN, that hold the springs at these displacements (..., N), um."""
        u = np.asarray(displacement, dtype=float)
        wall = np.zeros((*u.shape[:-1], 1))
        strain = np.diff(np.concatenate([wall, u, wall], axis=-1)) / self.spacing
        tension = self.stiffness * (strain + self.stiffening * strain**3)
        return tension[..., :-1] - tension[..., 1:]
