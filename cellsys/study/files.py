"""What a study writes besides its report: the run, and plain values for JSON."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cellsys.store import save_archive
from cellsys.trajectory import Trajectory


def save_run(run: Trajectory, path: Path, more: Mapping[str, np.ndarray] | None = None) -> None:
    """Times, states, polarity and sensed direction of a run, with their names; `more` arrays."""
    arrays = {"t": run.t, "x": np.asarray(run.x), **(more or {})}
    arrays |= {k: np.asarray(getattr(run, k)) for k in ("p", "d") if getattr(run, k) is not None}
    described = {
        "label": run.label,
        "states": [[b.name, list(b.shape), b.unit, b.role, b.kind] for b in run.states],
        "statistics": plain(run.statistics),
        "events": [e.name for e in run.events],
    }
    save_archive(path, "run", 1, arrays, described)


def plain(value: object) -> Any:
    """Plain values; inf and NaN as strings, which JSON has no numbers for."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    return value
