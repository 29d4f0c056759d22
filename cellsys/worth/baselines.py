"""Predictors that need no model but know the training runs' commands.

nearest run          the motion of the training run whose mean polarity so far is closest
linear in polarity   displacement at each time, least squares on the mean polarity so far
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.linalg as sla

from cellsys.samples.snapshots import RunData, Snapshots, read_rows

_TIMES = 61  # at most so many samples of a run are compared


def command_baselines(
    training: Snapshots,
    run: RunData,
    rows: Mapping[str, np.ndarray | slice],
    read: dict[tuple[int, int], np.ndarray],
) -> dict[str, dict[str, float]]:
    """Relative errors {block: {name: error}} of both on one run; empty without commands.

    A training run is never predicted from itself; the linear one needs four others. `read` keeps
    what was read of the training runs for the next call.
    """
    known = [r for r in training.runs if r is not run and len(r.x) >= len(run.x)]
    columns = [
        i for i, n in enumerate(training.command_names) if n.rpartition(".")[2] in ("cos", "sin")
    ]
    if run.commands is None or not columns or not known:
        return {}
    T = len(run.x)
    at = np.unique(np.linspace(0, T - 1, min(T, _TIMES)).astype(int))

    def push(r: RunData) -> np.ndarray:
        mean = np.cumsum(np.asarray(r.commands)[:, columns], axis=0)
        mean = mean / np.arange(1, len(mean) + 1)[:, None]
        return mean[np.maximum(at, 1) - 1]

    def motion(r: RunData) -> np.ndarray:
        if (id(r), T) not in read:
            x = np.stack([read_rows(r.x, int(k), int(k) + 1)[0] for k in at])
            read[id(r), T] = x - x[0]
        return read[id(r), T]

    truth, own = motion(run), push(run)
    pushes = np.array([push(r) for r in known])
    moved = [motion(r) for r in known]
    found = {"nearest run": moved[int(np.argmin([np.linalg.norm(p - own) for p in pushes]))]}
    if len(known) >= 4:
        linear = np.zeros_like(truth)
        for k in range(len(at)):
            design = np.column_stack([np.ones(len(known)), pushes[:, k]])
            weights = sla.lstsq(design.T, np.append(1.0, own[k]), cond=1e-8)[0]
            for weight, m in zip(weights, moved, strict=True):
                linear[k] += weight * m[k]
        found["linear in polarity"] = linear
    out: dict[str, dict[str, float]] = {}
    for block, cols in rows.items():
        size = float(np.linalg.norm(truth[:, cols]))
        out[block] = {
            name: float(np.linalg.norm((path - truth)[:, cols])) / size if size > 0 else 0.0
            for name, path in found.items()
        }
    return out
