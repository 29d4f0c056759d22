"""Commands of recorded runs: amplitude and heading features of every cell."""

from __future__ import annotations

import re

import numpy as np

from cellsys.errors import DataError
from cellsys.laws.arrays import Values
from cellsys.laws.polarity import heading_features
from cellsys.trajectory import Trajectory


def command_features(
    p: np.ndarray, amplitude: np.ndarray | None
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Inputs of a latent model: amplitude times (1, cos, sin, cos 2, sin 2) of each heading.

    p (T, cells, 3), amplitude (T, cells) or None for 1; returns (T, 5 cells) and their names.
    `DataError` where p or the amplitude is not finite, or too large to be squared.
    """
    for what, values in (("polarity", p), ("amplitude", amplitude)):
        if values is not None and not np.all(np.abs(values) < 1e100):
            raise DataError(f"{what} of a run holds NaN, inf or more than 1e100; repair that run")
    features, names = [], []
    for c in range(p.shape[1]):
        shape = np.array([heading_features(row) for row in p[:, c]]).reshape(len(p), 4)
        a = np.ones(len(p)) if amplitude is None else amplitude[:, c]
        features.append(np.column_stack([a, a[:, None] * shape]))
        names += [f"cell{c + 1}.{n}" for n in ("amplitude", "cos", "sin", "cos2", "sin2")]
    return np.concatenate(features, axis=1), tuple(names)


def harmonic(name: str) -> tuple[str, int, int] | None:
    """("cos" | "sin" | "amplitude", q, power of the amplitude) of a feature name, or None.

    ``cell1.cos3`` is a cos 3 theta, ``cell1.unit_cos3`` cos 3 theta, ``cell1.squared_cos3``
    a^2 cos 3 theta; ``cell1.amplitude`` is a, ``cell1.amplitude_squared`` a^2.
    """
    found = re.fullmatch(
        r"(?:.*\.)?(?:amplitude(_squared)?|(unit_|squared_)?(cos|sin)([1-9]\d*)?)", name
    )
    if found is None:
        return None
    squared, weight, kind, order = found.groups()
    if kind is None:
        return "amplitude", 0, 2 if squared else 1
    return kind, int(order or 1), {"unit_": 0, None: 1, "squared_": 2}[weight]


def feature_of(name: str) -> tuple[str, int, int]:
    """`harmonic` of a name that is one; DataError for another."""
    found = harmonic(name)
    if found is None:
        raise DataError(f"{name!r} is no heading feature such as amplitude, cos or sin2")
    return found


def harmonic_value(name: str, amplitude: Values, theta: Values) -> Values:
    """Value of a feature for an amplitude and a heading theta, rad (arrays alike)."""
    kind, q, power = feature_of(name)
    if kind == "amplitude":
        return amplitude**power
    return amplitude**power * (np.cos(q * theta) if kind == "cos" else np.sin(q * theta))


def named_command(table: np.ndarray, known: tuple[str, ...], name: str) -> np.ndarray:
    """One command (T,) from recorded ones (T, n_c), or a harmonic made from them."""
    if name in known:
        return table[:, known.index(name)]
    cell = name.rpartition(".")[0]
    needed = [f"{cell}.{part}" for part in ("amplitude", "cos", "sin")]
    if harmonic(name) is None or not set(needed) <= set(known):
        raise DataError(f"no command {name!r} among {', '.join(known) or 'none'}")
    amplitude, x, y = (table[:, known.index(n)] for n in needed)
    return harmonic_value(name, amplitude, np.arctan2(y, x))


def recorded_commands(
    runs: list[Trajectory],
) -> tuple[list[np.ndarray], tuple[str, ...]]:
    """Interval means (T - 1, n_c) of the command features of every run, and their names.

    Empty where a run recorded no polarity.
    """
    if any(r.p is None for r in runs):
        return [], ()
    tables: list[np.ndarray] = []
    names: tuple[str, ...] = ()
    for run in runs:
        table, names = command_features(
            np.asarray(run.p), None if run.amplitude is None else np.asarray(run.amplitude)
        )
        tables.append(0.5 * (table[:-1] + table[1:]))
    return tables, names
