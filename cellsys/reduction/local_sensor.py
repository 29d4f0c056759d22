"""A sensor that knows the network under the cell: its stiffness at rest, and its stress.

    d ~ K_d [1; z] + K_s s(c) + K_t t(z) + K_q [x^2; x y; y^2]

s(c): stiffest direction of the network at rest about the place c = (x, y). t(z): direction of the
moment of tensile stress about the cell, itself a linear read-out of z learned from the nodal
virial that runs store. Where stiffness varies over the cell's reach (an inclusion), no linear map
of the latent state can follow the sensed direction; the network's own stiffness can. Which inputs
are used, the squares among them, is decided by leaving out one run at a time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cellsys.errors import DataError, DimensionError
from cellsys.laws.sensing import measure_moment
from cellsys.reduction.sensor import StiffnessSensor, angle_error, ridge_maps

REACH = 14.0  # um, sensing range of the full-order model
INNER = 4.0  # um, inner radius of the shell in which stress is read
RIDGES = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
# Inputs by name: columns of z, s(c), t(z), squares of the place.
CHOICES = {
    "local stiffness": ("none", True, False, False),
    "place": ("place", False, False, False),
    "place and local stiffness": ("place", True, False, False),
    "latent state": ("all", False, False, False),
    "latent state and local stiffness": ("all", True, False, False),
    "stress": ("none", False, True, False),
    "stress and local stiffness": ("none", True, True, False),
    "place and its squares": ("place", False, False, True),
    "place, its squares and local stiffness": ("place", True, False, True),
}


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
        q, total = measure_moment(self.nodes, self.stiffness, place, 0.0, self.reach)
        size = float(np.hypot(*q))
        return q / size if size > 1e-12 * total else np.zeros(2)

    def slope(self, place: np.ndarray, h: float = 1e-3) -> np.ndarray:
        """ds/dc (2, 2), 1/um, by central differences."""
        place = np.asarray(place, dtype=float)
        columns = [(self.at(place + e) - self.at(place - e)) / (2 * h) for e in h * np.eye(2)]
        return np.column_stack(columns)


@dataclass(frozen=True, eq=False)
class LocalSensor(StiffnessSensor):
    """`StiffnessSensor` with what is known of the network at the cell's place.

    The last two latent states are the place (x, y) of the centroid, um.

    Parameters
    ----------
    K_s : (3, 2)
    map : StiffnessMap
    inputs : str
        Which inputs were chosen.
    K_t : (3, 2)
        Weights of the direction of stress.
    M : (2, 1 + m)
        Its moment, pN um, from [1; z].
    K_q : (3, 3)
        Weights of x^2, x y and y^2.
    tried : mapping of str to float
        Mean angle error, deg, of every choice of inputs on the runs left out.
    """

    K_s: np.ndarray | None = None
    map: StiffnessMap | None = None
    inputs: str = ""
    K_t: np.ndarray | None = None
    M: np.ndarray | None = None
    K_q: np.ndarray | None = None
    tried: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, shape in (
            ("K_s", (3, 2)),
            ("K_t", (3, 2)),
            ("M", (2, self.K_d.shape[1])),
            ("K_q", (3, 3)),
        ):
            value = getattr(self, name)
            value = np.zeros(shape) if value is None else np.array(value, dtype=float)
            if value.shape != shape:
                raise DimensionError(f"{name} must be {shape}, got {value.shape}")
            object.__setattr__(self, name, value)

    def raw(self, z: np.ndarray) -> np.ndarray:
        """The raw direction, not normalised: (3,) or (T, 3)."""
        z = np.asarray(z, dtype=float)
        d = super().raw(z)
        if self.K_s.any():
            d = d + self.map.at(z[..., -2:]) @ self.K_s.T
        if self.K_t.any():
            d = d + _stress(self.M, z) @ self.K_t.T
        if self.K_q.any():
            d = d + _squares(z[..., -2:]) @ self.K_q.T
        return d

    def frozen(self, z: np.ndarray) -> StiffnessSensor:
        """The linear sensor with the same value and slope at z (m,)."""
        S = self.S_d.copy()
        if self.K_s.any():
            S[:, -2:] += self.K_s @ self.map.slope(z[-2:])
        if self.K_t.any():
            q = self.M[:, 0] + self.M[:, 1:] @ z
            size = float(np.hypot(*q))
            if size > 0:
                across = (np.eye(2) - np.outer(q, q) / size**2) / size
                S += self.K_t @ across @ self.M[:, 1:]
        x, y = z[-2:]
        S[:, -2:] += self.K_q @ np.array([[2 * x, 0.0], [y, x], [0.0, 2 * y]])
        K_d = np.column_stack([self.raw(z) - S @ z, S])
        return StiffnessSensor(
            K_d, self.ridge, self.training_error, self.held_out_error, self.constant_error
        )

    def arrays(self) -> Mapping[str, np.ndarray]:
        """Plain arrays for a file."""
        return {
            **super().arrays(),
            "K_s": self.K_s,
            "K_t": self.K_t,
            "M": self.M,
            "K_q": self.K_q,
            "nodes": self.map.nodes,
            "stiffness": self.map.stiffness,
            "reach": np.array(self.map.reach),
            "inputs": np.array(self.inputs),
            "tried": np.array(list(self.tried.values())),
            "tried_names": np.array(list(self.tried), dtype=np.str_),
        }


def sensor_from(arrays: Mapping[str, np.ndarray]) -> StiffnessSensor:
    """The sensor whose `arrays` these are."""
    known = dict(arrays)
    if "K_s" not in known:
        return StiffnessSensor(**known)
    parts = [known.pop(k) for k in ("nodes", "stiffness", "reach")]
    known["inputs"] = str(known["inputs"])
    names, tried = known.pop("tried_names"), known.pop("tried")
    known["tried"] = {str(k): float(v) for k, v in zip(names, tried, strict=True)}
    return LocalSensor(**known, map=StiffnessMap(parts[0], parts[1], float(parts[2])))


def _stress(M: np.ndarray, z: np.ndarray) -> np.ndarray:
    """t(z) (..., 2)."""
    q = M[:, 0] + np.asarray(z) @ M[:, 1:].T
    size = np.hypot(q[..., :1], q[..., 1:])
    return np.divide(q, size, out=np.zeros_like(q), where=size > 0)


def _squares(place: np.ndarray) -> np.ndarray:
    x, y = place[..., 0], place[..., 1]
    return np.stack([x * x, x * y, y * y], axis=-1)


@dataclass(frozen=True, eq=False)
class _Table:
    """Samples of all runs: what the choices take their columns from."""

    latent: Sequence[np.ndarray]
    directions: Sequence[np.ndarray]
    moments: Sequence[np.ndarray] | None
    local: Sequence[np.ndarray]

    def moment_map(self, runs: Sequence[int], ridge: float) -> np.ndarray | None:
        """M (2, 1 + m) from the runs' measured moments."""
        if self.moments is None:
            return None
        z, q = [self.latent[i] for i in runs], [self.moments[i] for i in runs]
        return ridge_maps(z, q, (ridge,))[0]

    def design(self, i: int, choice: str, M: np.ndarray | None) -> np.ndarray:
        """Regressors (T_i, width) of one run."""
        columns, with_map, with_stress, squared = CHOICES[choice]
        z = self.latent[i]
        parts = [{"none": z[:, :0], "place": z[:, -2:], "all": z}[columns]]
        parts += [self.local[i]] if with_map else []
        parts += [_stress(M, z)] if with_stress else []
        parts += [_squares(z[:, -2:])] if squared else []
        return np.hstack(parts)


def fit_local_sensor(
    latent: Sequence[np.ndarray],
    directions: Sequence[np.ndarray],
    known: StiffnessMap,
    test_latent: Sequence[np.ndarray] | None = None,
    test_directions: Sequence[np.ndarray] | None = None,
    moments: Sequence[np.ndarray] | None = None,
) -> LocalSensor:
    """Ridge regression on the inputs and with the penalty that predict left-out runs best.

    Parameters
    ----------
    latent, directions : lists of (T_i, m) and (T_i, 3)
        The last two latent states are the place of the cell.
    known : StiffnessMap
    test_latent, test_directions : optional
        Held-out runs for the reported error.
    moments : list of (T_i, 2), optional
        Moment of tensile stress about the cell at the samples (`stress_moments`), pN um; without
        it stress is no input.
    """
    if not latent or len(latent) != len(directions):
        raise DataError("a sensor needs as many runs of latent samples as of directions")
    if moments is not None and [len(q) for q in moments] != [len(z) for z in latent]:
        raise DimensionError("moments must have one row (2,) for every latent sample")
    table = _Table(latent, directions, moments, [known.at(z[:, -2:]) for z in latent])
    everyone = range(len(latent))
    choices = [c for c, parts in CHOICES.items() if not parts[2] or moments is not None]
    total = {c: np.zeros(len(RIDGES)) for c in choices}
    for i in everyone:
        others = [k for k in everyone if k != i] or [i]
        maps = [table.moment_map(others, ridge) for ridge in RIDGES]
        given = [directions[k] for k in others]
        for choice in choices:
            # Only the direction of stress depends on the penalty, through M.
            own = [[r] for r in range(len(RIDGES))] if CHOICES[choice][2] else [range(len(RIDGES))]
            for group in own:
                M = maps[group[0]]
                X = [table.design(k, choice, M) for k in others]
                tried = ridge_maps(X, given, tuple(RIDGES[r] for r in group))
                X = table.design(i, choice, M)
                for r, K in zip(group, tried, strict=True):
                    total[choice][r] += angle_error(K[:, 0] + X @ K[:, 1:].T, directions[i])
    name = min(choices, key=lambda c: total[c].min())
    ridge = RIDGES[int(np.argmin(total[name]))]
    M = table.moment_map(everyone, ridge)
    K = ridge_maps([table.design(i, name, M) for i in everyone], list(directions), (ridge,))[0]
    m = latent[0].shape[1]
    columns, with_map, with_stress, squared = CHOICES[name]
    at = {"none": [], "place": [m - 2, m - 1], "all": list(range(m))}[columns]
    K_d, rest = np.zeros((3, 1 + m)), K[:, 1 + len(at) :]
    K_d[:, [0, *(1 + c for c in at)]] = K[:, : 1 + len(at)]
    K_s, rest = (rest[:, :2], rest[:, 2:]) if with_map else (None, rest)
    K_t, rest = (rest[:, :2], rest[:, 2:]) if with_stress else (None, rest)
    sensor = LocalSensor(
        K_d,
        ridge,
        K_s=K_s,
        map=known,
        inputs=name,
        K_t=K_t,
        M=M if with_stress else None,
        K_q=rest if squared else None,
        tried={c: float(total[c].min()) / len(latent) for c in choices},
    )
    return _measured(sensor, latent, directions, test_latent, test_directions)


def _measured(
    sensor: LocalSensor,
    latent: Sequence[np.ndarray],
    directions: Sequence[np.ndarray],
    test_latent: Sequence[np.ndarray] | None,
    test_directions: Sequence[np.ndarray] | None,
) -> LocalSensor:
    """The sensor with its errors on training and held-out runs and the constant direction's."""
    given = test_latent is not None and test_directions is not None
    shown = (test_latent, test_directions) if given else (latent, directions)
    truth, mean = np.concatenate(shown[1]), np.concatenate(directions).mean(axis=0)

    def error(z: Sequence[np.ndarray], d: Sequence[np.ndarray]) -> float:
        return angle_error(np.concatenate([sensor.raw(part) for part in z]), np.concatenate(d))

    return replace(
        sensor,
        training_error=error(latent, directions),
        held_out_error=error(*shown) if given else float("nan"),
        constant_error=angle_error(np.tile(mean, (len(truth), 1)), truth),
    )


def stress_moments(
    rest: np.ndarray, displacement: np.ndarray, virial: np.ndarray, centers: np.ndarray
) -> np.ndarray:
    """Moment (T, 2) of tensile stress about the cell at every sample, pN um.

    Parameters
    ----------
    rest, displacement, virial : (N, 3), (T, N, 3) and (T, N)
        um, um and pN um; as runs store them.
    centers : (T, 2)
        Centroids of the cell, um.
    """
    return np.array(
        [
            measure_moment(rest + u, s, c, INNER, REACH)[0]
            for u, s, c in zip(displacement, virial, centers, strict=True)
        ]
    )
