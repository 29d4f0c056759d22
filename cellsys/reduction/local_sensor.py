"""A sensor that knows the stiffness of the network under the cell.

    d ~ K_d [1; z] + K_s s(c)        s(c): stiffest direction of the network at rest about place c

Where stiffness varies over the cell's reach (an inclusion), no linear map of the latent state can
follow the sensed direction; the stored nodal stiffness can. Which inputs are used is decided by
leaving out one run at a time: s(c), the place, the whole latent state, or both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellsys.errors import DataError, DimensionError
from cellsys.laws.lamellipodium import smoothstep
from cellsys.reduction.sensor import StiffnessSensor, angle_error, ridge_maps

REACH = 14.0  # um, sensing range of the full-order model
RIDGES = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)


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
    """

    nodes: np.ndarray
    stiffness: np.ndarray
    reach: float = REACH

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

    def at(self, place: np.ndarray) -> np.ndarray:
        """Unit direction (..., 2); zero where nothing stands out."""
        place = np.asarray(place, dtype=float)
        if place.ndim > 1:
            return np.array([self.at(c) for c in place])
        offset = self.nodes - place
        rho = np.sqrt((offset**2).sum(axis=1) + 1e-12)
        weight = (1.0 - smoothstep(rho, self.reach - 1.0, self.reach)) * self.stiffness
        q = (weight / rho) @ offset
        size = float(np.hypot(*q))
        return q / size if size > 1e-12 * float(np.abs(weight).sum()) else np.zeros(2)

    def slope(self, place: np.ndarray, h: float = 1e-3) -> np.ndarray:
        """ds/dc (2, 2), 1/um, by central differences."""
        place = np.asarray(place, dtype=float)
        columns = [(self.at(place + e) - self.at(place - e)) / (2 * h) for e in h * np.eye(2)]
        return np.column_stack(columns)


@dataclass(frozen=True, eq=False)
class LocalSensor(StiffnessSensor):
    """`StiffnessSensor` with the network's stiffest direction at the cell's place.

    The last two latent states are the place (x, y) of the centroid, um.

    Parameters
    ----------
    K_s : (3, 2)
    map : StiffnessMap
    inputs : str
        Which inputs were chosen.
    """

    K_s: np.ndarray | None = None
    map: StiffnessMap | None = None
    inputs: str = ""

    def raw(self, z: np.ndarray) -> np.ndarray:
        """K_d [1; z] + K_s s(c), not normalised: (3,) or (T, 3)."""
        z = np.asarray(z, dtype=float)
        return super().raw(z) + self.map.at(z[..., -2:]) @ self.K_s.T

    def frozen(self, z: np.ndarray) -> StiffnessSensor:
        """The linear sensor with the same value and slope at z (m,)."""
        S = self.S_d.copy()
        S[:, -2:] += self.K_s @ self.map.slope(z[-2:])
        K_d = np.column_stack([self.raw(z) - S @ z, S])
        return StiffnessSensor(
            K_d, self.ridge, self.training_error, self.held_out_error, self.constant_error
        )

    def arrays(self) -> Mapping[str, np.ndarray]:
        """Plain arrays for a file."""
        return {
            **super().arrays(),
            "K_s": self.K_s,
            "nodes": self.map.nodes,
            "stiffness": self.map.stiffness,
            "reach": np.array(self.map.reach),
            "inputs": np.array(self.inputs),
        }


def sensor_from(arrays: Mapping[str, np.ndarray]) -> StiffnessSensor:
    """The sensor whose `arrays` these are."""
    known = dict(arrays)
    if "K_s" not in known:
        return StiffnessSensor(**known)
    parts = [known.pop(k) for k in ("nodes", "stiffness", "reach")]
    known["inputs"] = str(known["inputs"])
    return LocalSensor(**known, map=StiffnessMap(parts[0], parts[1], float(parts[2])))


def fit_local_sensor(
    latent: Sequence[np.ndarray],
    directions: Sequence[np.ndarray],
    known: StiffnessMap,
    test_latent: Sequence[np.ndarray] | None = None,
    test_directions: Sequence[np.ndarray] | None = None,
) -> LocalSensor:
    """Ridge regression on the inputs and with the penalty that predict left-out runs best.

    Parameters
    ----------
    latent, directions : lists of (T_i, m) and (T_i, 3)
        The last two latent states are the place of the cell.
    known : StiffnessMap
    test_latent, test_directions : optional
        Held-out runs for the reported error.
    """
    if not latent or len(latent) != len(directions):
        raise DataError("a sensor needs as many runs of latent samples as of directions")
    m = latent[0].shape[1]
    place, state = [m - 2, m - 1], list(range(m))
    choices = {
        "local stiffness": ([], True),
        "place": (place, False),
        "place and local stiffness": (place, True),
        "latent state": (state, False),
        "latent state and local stiffness": (state, True),
    }
    local = [known.at(z[:, -2:]) for z in latent]

    def design(runs: Sequence[int], columns: list[int], with_map: bool) -> list[np.ndarray]:
        return [np.hstack([latent[i][:, columns]] + ([local[i]] if with_map else [])) for i in runs]

    everyone, best = range(len(latent)), (np.inf, "", 0.0)
    for name, (columns, with_map) in choices.items():
        total = np.zeros(len(RIDGES))
        for i in everyone:
            others = [k for k in everyone if k != i] or [i]
            maps = ridge_maps(
                design(others, columns, with_map), [directions[k] for k in others], RIDGES
            )
            X = design([i], columns, with_map)[0]
            total += [angle_error(K[:, 0] + X @ K[:, 1:].T, directions[i]) for K in maps]
        least = int(np.argmin(total))
        if total[least] < best[0]:
            best = (float(total[least]), name, RIDGES[least])
    _, name, ridge = best
    columns, with_map = choices[name]
    K = ridge_maps(design(everyone, columns, with_map), list(directions), (ridge,))[0]
    K_d = np.zeros((3, 1 + m))
    K_d[:, 0] = K[:, 0]
    K_d[:, [1 + c for c in columns]] = K[:, 1 : 1 + len(columns)]
    K_s = K[:, 1 + len(columns) :] if with_map else np.zeros((3, 2))
    sensor = LocalSensor(K_d, ridge, K_s=K_s, map=known, inputs=name)
    given = test_latent is not None and test_directions is not None
    shown = (test_latent, test_directions) if given else (latent, directions)
    truth, mean = np.concatenate(shown[1]), np.concatenate(directions).mean(axis=0)

    def error(z: Sequence[np.ndarray], d: Sequence[np.ndarray]) -> float:
        return angle_error(np.concatenate([sensor.raw(part) for part in z]), np.concatenate(d))

    return LocalSensor(
        K_d,
        ridge,
        error(latent, directions),
        error(*shown) if given else float("nan"),
        angle_error(np.tile(mean, (len(truth), 1)), truth),
        K_s,
        known,
        name,
    )
