"""What every network of fibres has, flat or in space."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree


@dataclass(frozen=True, eq=False, kw_only=True)
class FibreNetwork:
    """Nodes and the fibres between them.

    Parameters
    ----------
    position : array (n, 3)
        Rest positions of the nodes, um.
    fibres : int array (n_fibres, 2)
        Node pairs.
    length : array (n_fibres,)
        Rest lengths, um.
    stiffness : array (n_fibres,)
        Axial stiffness EA/length of each fibre, pN/um.
    clamped : bool array (n,)
        Nodes that do not move.
    surface : int array
        Nodes that adhesions can reach.
    """

    position: np.ndarray
    fibres: np.ndarray
    length: np.ndarray
    stiffness: np.ndarray
    clamped: np.ndarray
    surface: np.ndarray

    @property
    def flat(self) -> bool:
        """Whether cells lie on it; else they lie in it, and all it does has three axes."""
        return False

    def describe(self) -> dict[str, np.ndarray]:
        """What a run keeps of it in its ``geometry``."""
        return {
            "matrix.rest": self.position,
            "matrix.surface": self.surface,
            "matrix.fibres": self.fibres,
        }


def offsets(network: FibreNetwork, x: float, y: float) -> np.ndarray:
    """Nodes from the place (x, y), um: (n, 2) of a flat network, else (n, 3) from (x, y, 0)."""
    axes = 2 if network.flat else 3
    return network.position[:, :axes] - np.array([x, y, 0.0])[:axes]


def spread_nodes(throw: Callable[[int], np.ndarray], volume: float, n_nodes: int) -> np.ndarray:
    """Random points (n_nodes, 3), none closer than about 0.87 spacings.

    Dart throwing in batches (Poisson-disc sampling): `throw(k)` gives k points that fill the
    `volume`, um^3, evenly. The least distance shrinks by 2 % whenever 60 batches in a row have not
    filled it.
    """
    spacing = (volume / n_nodes) ** (1.0 / 3.0)
    least, x, tries = 0.87 * spacing, np.zeros((0, 3)), 0
    while len(x) < n_nodes:
        if tries == 60:
            least, tries = 0.98 * least, 0
        tries += 1
        darts = throw(max(2 * n_nodes, 200))
        if len(x):
            darts = darts[np.asarray(cKDTree(x).query(darts)[0]) >= least]
        # Among darts of one batch the earlier one stands.
        standing = np.ones(len(darts), bool)
        pairs = cKDTree(darts).query_pairs(least, output_type="ndarray") if len(darts) else ()
        for i, j in sorted(map(tuple, np.sort(pairs, axis=1))) if len(pairs) else ():
            if standing[i]:
                standing[j] = False
        x = np.concatenate([x, darts[standing]])[:n_nodes]
    return x
