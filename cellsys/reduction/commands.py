"""Commands of recorded runs: amplitude and heading features of every cell."""

from __future__ import annotations

import numpy as np

from cellsys.laws.polarity import heading_features
from cellsys.trajectory import Trajectory


def command_features(
    p: np.ndarray, amplitude: np.ndarray | None
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Inputs of a latent model: amplitude times (1, cos, sin, cos 2, sin 2) of each heading.

    p (T, cells, 3), amplitude (T, cells) or None for 1; returns (T, 5 cells) and their names.
    """
    features, names = [], []
    for c in range(p.shape[1]):
        shape = np.array([heading_features(row) for row in p[:, c]]).reshape(len(p), 4)
        a = np.ones(len(p)) if amplitude is None else amplitude[:, c]
        features.append(np.column_stack([a, a[:, None] * shape]))
        names += [f"cell{c + 1}.{n}" for n in ("amplitude", "cos", "sin", "cos2", "sin2")]
    return np.concatenate(features, axis=1), tuple(names)


def recorded_commands(
    runs: list[Trajectory],
) -> tuple[list[np.ndarray], tuple[str, ...]]:
    """Interval means (T - 1, n_c) of the command features of every run, and their names.

    Empty where a run recorded no polarity.
    """
    if any(r.p is None for r in runs):
        return [], ()
    tables, names = [], ()
    for run in runs:
        table, names = command_features(
            np.asarray(run.p), None if run.amplitude is None else np.asarray(run.amplitude)
        )
        tables.append(0.5 * (table[:-1] + table[1:]))
    return tables, names
