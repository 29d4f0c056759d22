"""A sensor that knows the network under the cell: its stiffness at rest, strained by the cell.

    d ~ K_d [1; z] + K_s s(c) + K_t t(z) + K_q [x^2; x y; y^2]
    s(c) = q_0(c)/|q_0(c)|,     t(z) = q/|q|,   q = a q_0(c) + M [1; z]

q_0(c) is the moment sum_j w_j k_j (x_j - c)/rho_j of the stiffness at rest about the place c =
(x, y), the sum whose direction the full-order model senses. The cell's own load stretches some
fibres and buckles others; what that adds to the moment is read out of z, learned from the nodal
stiffness (or, with a = 0, the nodal virial) that runs store. A moment is a vector: for an
equivariant cell only states of charge 1 can make one, with the same real weights along x and y.
Which inputs are used, the squares among them, is decided by leaving out one run at a time.

Of runs with a graded cue, g ~ K_d [1; z] + K_s g_0(c) + K_q [x^2; x y; y^2] with the contrast
g_0(c) at rest in place of a direction: a buckled fibre does not count there as a soft one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from cellsys.arguments import needs
from cellsys.errors import DataError, DimensionError
from cellsys.kinds import FILLED, Filled
from cellsys.laws.sensing import measure_moment
from cellsys.model.sensor import (
    StiffnessSensor,
    angle_error,
    contrasts,
    mean_strength,
    ridge_maps,
    ridge_weights,
    vector_error,
)
from cellsys.model.stiffness_map import INNER, REACH, StiffnessMap, unit_rows

RIDGES = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
# Inputs by name: columns of z, s(c), which stored moment t(z) is that of, squares of the place.
CHOICES: dict[str, tuple[str, bool, str, bool]] = {
    "local stiffness": ("none", True, "", False),
    "place": ("place", False, "", False),
    "place and local stiffness": ("place", True, "", False),
    "latent state": ("all", False, "", False),
    "latent state and local stiffness": ("all", True, "", False),
    "stress": ("none", False, "virial", False),
    "stress and local stiffness": ("none", True, "virial", False),
    "stiffness under strain": ("none", False, "stiffness", False),
    "place and its squares": ("place", False, "", True),
    "place, its squares and local stiffness": ("place", True, "", True),
}


@dataclass(frozen=True, eq=False, kw_only=True)
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
        Weights of the direction t(z).
    M : (2, 1 + m)
        What [1; z] adds to its moment.
    a : float
        Share of the moment at rest in it.
    K_q : (3, 3)
        Weights of x^2, x y and y^2.
    tried : mapping of str to float
        Error of every choice of inputs on the runs left out, as `training_error`.
    """

    K_s: Filled[np.ndarray] = FILLED
    map: Filled[StiffnessMap] = FILLED  # to be given: the fields of the base have defaults
    inputs: str = ""
    K_t: Filled[np.ndarray] = FILLED
    M: Filled[np.ndarray] = FILLED
    a: float = 0.0
    K_q: Filled[np.ndarray] = FILLED
    tried: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        needs(self.map, StiffnessMap, "map")
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
        object.__setattr__(self, "a", float(self.a))

    def _moment(self, z: np.ndarray) -> np.ndarray:
        """q (..., 2)."""
        q = self.M[:, 0] + z @ self.M[:, 1:].T
        return q + self.a * self.map.moment(z[..., -2:]) if self.a else q

    def raw(self, z: np.ndarray) -> np.ndarray:
        """The raw direction, not normalised: (3,) or (T, 3)."""
        z = np.asarray(z, dtype=float)
        d = super().raw(z)
        if self.K_s.any():
            d = d + self.map.at(z[..., -2:]) @ self.K_s.T
        if self.K_t.any():
            d = d + unit_rows(self._moment(z)) @ self.K_t.T
        if self.K_q.any():
            d = d + _squares(z[..., -2:]) @ self.K_q.T
        return d

    def on(self, nodes: np.ndarray, stiffness: np.ndarray) -> LocalSensor:
        """The same law on another network: nodes (N, 2 or 3) um, stiffness (N,) pN/um at rest.

        The stiffness is the sum over the fibres at each node, of a graded cue their mean.
        """
        known = StiffnessMap(nodes[:, :2], stiffness, self.map.reach, self.map.contrasts)
        return replace(self, map=known)

    def frozen(self, z: np.ndarray) -> StiffnessSensor:
        """The linear sensor with the same value and slope at z (m,)."""
        S = self.S_d.copy()
        at_rest = self.map.slope(z[-2:]) if self.K_s.any() or self.a else np.zeros((2, 2))
        if self.K_s.any():
            turning = np.eye(2) if self.map.contrasts else _turning(self.map.moment(z[-2:]))
            S[:, -2:] += self.K_s @ turning @ at_rest
        if self.K_t.any():
            moved = self.M[:, 1:].copy()
            moved[:, -2:] += self.a * at_rest
            S += self.K_t @ _turning(self._moment(z)) @ moved
        x, y = z[-2:]
        S[:, -2:] += self.K_q @ np.array([[2 * x, 0.0], [y, x], [0.0, 2 * y]])
        K_d = np.column_stack([self.raw(z) - S @ z, S])
        carried = {f.name: getattr(self, f.name) for f in fields(StiffnessSensor)}
        return StiffnessSensor(**carried | {"K_d": K_d})

    def arrays(self) -> Mapping[str, np.ndarray]:
        """Plain arrays for a file."""
        return {
            **super().arrays(),
            "K_s": self.K_s,
            "K_t": self.K_t,
            "M": self.M,
            "a": np.array(self.a),
            "K_q": self.K_q,
            "nodes": self.map.nodes,
            "stiffness": self.map.stiffness,
            "reach": np.array(self.map.reach),
            "contrasts": np.array(self.map.contrasts),
            "inputs": np.array(self.inputs),
            "tried": np.array(list(self.tried.values())),
            "tried_names": np.array(list(self.tried), dtype=np.str_),
        }


def sensor_from(arrays: Mapping[str, np.ndarray]) -> StiffnessSensor:
    """The sensor whose `arrays` these are."""
    known: dict[str, Any] = dict(arrays)
    if "K_s" not in known:
        return StiffnessSensor(**known)
    parts = [known.pop(k) for k in ("nodes", "stiffness", "reach")]
    graded = bool(known.pop("contrasts", False))  # files of 0.2.0 hold directions alone
    known["inputs"], known["a"] = str(known["inputs"]), float(known["a"])
    names, tried = known.pop("tried_names"), known.pop("tried")
    known["tried"] = {str(k): float(v) for k, v in zip(names, tried, strict=True)}
    return LocalSensor(**known, map=StiffnessMap(parts[0], parts[1], float(parts[2]), graded))


def _turning(q: np.ndarray) -> np.ndarray:
    """d(q/|q|)/dq (2, 2)."""
    size = float(np.hypot(*q))
    return (np.eye(2) - np.outer(q, q) / size**2) / size if size > 0 else np.zeros((2, 2))


def _squares(place: np.ndarray) -> np.ndarray:
    x, y = place[..., 0], place[..., 1]
    return np.stack([x * x, x * y, y * y], axis=-1)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Table:
    """Samples of all runs: what the choices take their columns from."""

    latent: Sequence[np.ndarray]
    directions: Sequence[np.ndarray]
    moments: Mapping[str, Sequence[np.ndarray]]
    at_rest: Sequence[np.ndarray]
    charge: tuple[np.ndarray, np.ndarray] | None
    noise: float

    def error(self, predicted: np.ndarray, true: np.ndarray) -> float:
        """Of directions in deg, of contrasts their rms."""
        return vector_error(predicted, true) if self.noise else angle_error(predicted, true)

    def moment_map(self, kind: str, runs: Sequence[int], ridge: float) -> tuple[float, np.ndarray]:
        """a and M (2, 1 + m) from the moments measured in the runs."""
        z = [self.latent[i] for i in runs]
        q, rest = (np.concatenate([part[i] for i in runs])
                   for part in (self.moments[kind], self.at_rest))  # fmt: skip
        with_rest = kind == "stiffness"
        M = np.zeros((2, 1 + z[0].shape[1]))
        if self.charge is None:
            a = float(np.vdot(rest, q) / np.vdot(rest, rest)) if with_rest and rest.any() else 0.0
            return a, ridge_maps(z, np.split(q - a * rest, np.cumsum([len(v) for v in z])[:-1]),
                                 (ridge,))[0]  # fmt: skip
        stacked = np.concatenate(z)
        rows = [
            np.column_stack([rest[:, axis : axis + 1][:, : int(with_rest)], stacked[:, columns]])
            for axis, columns in enumerate(self.charge)
        ]
        found = ridge_weights(np.concatenate(rows), q.T.ravel(), ridge)
        for axis, columns in enumerate(self.charge):
            M[axis, 1 + columns] = found[int(with_rest) :]
        return (float(found[0]) if with_rest else 0.0), M

    def design(self, i: int, choice: str, known: tuple[float, np.ndarray] | None) -> np.ndarray:
        """Regressors (T_i, width) of one run."""
        columns, with_map, _, squared = CHOICES[choice]
        z = self.latent[i]
        parts = [{"none": z[:, :0], "place": z[:, -2:], "all": z}[columns]]
        at_rest = self.at_rest[i]
        parts += [at_rest if self.noise else unit_rows(at_rest)] if with_map else []
        if known is not None:
            a, M = known
            parts += [unit_rows(a * self.at_rest[i] + M[:, 0] + z @ M[:, 1:].T)]
        parts += [_squares(z[:, -2:])] if squared else []
        return np.hstack(parts)


def fit_local_sensor(
    latent: Sequence[np.ndarray],
    directions: Sequence[np.ndarray],
    known: StiffnessMap,
    test_latent: Sequence[np.ndarray] | None = None,
    test_directions: Sequence[np.ndarray] | None = None,
    moments: Mapping[str, Sequence[np.ndarray]] | None = None,
    charge: tuple[np.ndarray, np.ndarray] | None = None,
    noise: float = 0.0,
) -> LocalSensor:
    """Ridge regression on the inputs and with the penalty that predict left-out runs best.

    Parameters
    ----------
    latent, directions : lists of (T_i, m) and (T_i, 3)
        The last two latent states are the place of the cell.
    known : StiffnessMap
    test_latent, test_directions : optional
        Held-out runs for the reported error.
    moments : mapping of str to list of (T_i, 2), optional
        Moments about the cell at the samples (`nodal_moments`) of the nodal ``virial`` and
        ``stiffness``; what is missing is no input.
    charge : two index arrays, optional
        Latent states that turn like a vector: their x parts and, in the same order, y parts.
        Moments are then read from these alone.
    noise : float
        g0 of graded cues; 0: the directions have length 1. The map must then hold contrasts, and
        the moments of strained fibres are no inputs.
    """
    if not latent or len(latent) != len(directions):
        raise DataError("a sensor needs as many runs of latent samples as of directions")
    moments = {} if moments is None or noise else moments
    if bool(noise) != known.contrasts:
        raise DataError(
            "a graded cue is learned beside contrasts at rest, a direction beside directions: "
            f"noise = {noise:g} and contrasts = {known.contrasts} do not go together"
        )
    directions = contrasts(directions, noise)
    if test_directions is not None:
        test_directions = contrasts(test_directions, noise)
    for name, each in moments.items():
        if [np.shape(q) for q in each] != [(len(z), 2) for z in latent]:
            raise DimensionError(f"moments of {name} must be (T_i, 2), a row per latent sample")
    at_rest = [known.moment(z[:, -2:]) for z in latent]
    table = _Table(
        latent=latent,
        directions=directions,
        moments=moments,
        at_rest=at_rest,
        charge=charge,
        noise=noise,
    )
    everyone = range(len(latent))
    choices = [c for c, parts in CHOICES.items() if not parts[2] or parts[2] in moments]
    total = {c: np.zeros(len(RIDGES)) for c in choices}
    for i in everyone:
        others = [k for k in everyone if k != i] or [i]
        given = [directions[k] for k in others]
        for choice in choices:
            kind = CHOICES[choice][2]
            # Only the direction of a moment depends on the penalty, through M.
            for group in [[r] for r in range(len(RIDGES))] if kind else [range(len(RIDGES))]:
                M = table.moment_map(kind, others, RIDGES[group[0]]) if kind else None
                X = [table.design(k, choice, M) for k in others]
                tried = ridge_maps(X, given, tuple(RIDGES[r] for r in group))
                own = table.design(i, choice, M)
                for r, K in zip(group, tried, strict=True):
                    total[choice][r] += table.error(K[:, 0] + own @ K[:, 1:].T, directions[i])
    name = min(choices, key=lambda c: total[c].min())
    sensor = _chosen(table, known, name, RIDGES[int(np.argmin(total[name]))])
    left_out = {c: float(total[c].min()) / len(latent) for c in choices}
    sensor = replace(sensor, tried=left_out, noise=noise, strength=mean_strength(directions, noise))
    return _measured(sensor, table, test_latent, test_directions)


def _chosen(table: _Table, known: StiffnessMap, name: str, ridge: float) -> LocalSensor:
    """The sensor of one choice from all runs."""
    columns, with_map, kind, squared = CHOICES[name]
    everyone = range(len(table.latent))
    moment = table.moment_map(kind, everyone, ridge) if kind else None
    X = [table.design(i, name, moment) for i in everyone]
    K = ridge_maps(X, list(table.directions), (ridge,))[0]
    m = table.latent[0].shape[1]
    at = {"none": [], "place": [m - 2, m - 1], "all": list(range(m))}[columns]
    K_d, rest = np.zeros((3, 1 + m)), K[:, 1 + len(at) :]
    K_d[:, [0, *(1 + c for c in at)]] = K[:, : 1 + len(at)]
    K_s, rest = (rest[:, :2], rest[:, 2:]) if with_map else (FILLED, rest)
    K_t, rest = (rest[:, :2], rest[:, 2:]) if moment else (FILLED, rest)
    a, M = moment or (0.0, FILLED)
    return LocalSensor(
        K_d=K_d, ridge=ridge, K_s=K_s, map=known, inputs=name, K_t=K_t, M=M, a=a,
        K_q=rest if squared else FILLED,
    )  # fmt: skip


def _measured(
    sensor: LocalSensor,
    table: _Table,
    test_latent: Sequence[np.ndarray] | None,
    test_directions: Sequence[np.ndarray] | None,
) -> LocalSensor:
    """The sensor with its errors on training and held-out runs and the constant direction's."""
    held_out, latent, directions = None, table.latent, table.directions
    if test_latent is not None and test_directions is not None:
        held_out = (test_latent, test_directions)
    truth = np.concatenate((held_out or (latent, directions))[1])
    mean = np.concatenate(directions).mean(axis=0)

    def error(z: Sequence[np.ndarray], d: Sequence[np.ndarray]) -> float:
        return table.error(np.concatenate([sensor.raw(part) for part in z]), np.concatenate(d))

    return replace(
        sensor,
        training_error=error(latent, directions),
        held_out_error=error(*held_out) if held_out else float("nan"),
        constant_error=table.error(np.tile(mean, (len(truth), 1)), truth),
    )


def nodal_moments(
    rest: np.ndarray,
    displacement: np.ndarray,
    nodal: Mapping[str, np.ndarray],
    centers: np.ndarray,
) -> dict[str, np.ndarray]:
    """Moments (T, 2) of stored nodal measures about the cell at every sample.

    Parameters
    ----------
    rest, displacement : (N, 3) and (T, N, 3)
        um.
    nodal : mapping of str to (T, N)
        ``virial``, read in a shell from `INNER` to `REACH`, and ``stiffness``, read within `REACH`.
    centers : (T, 2)
        Centroids of the cell, um.
    """
    return {
        name: np.array(
            [
                measure_moment(rest + u, s, c, INNER if name == "virial" else 0.0, REACH)[0]
                for u, s, c in zip(displacement, values, centers, strict=True)
            ]
        )
        for name, values in nodal.items()
    }
