"""What a study writes besides its report: the run, and plain values for JSON."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cellsys.store import save_archive
from cellsys.trajectory import Trajectory
from cellsys.trajectory_file import KIND, SCHEMA, packed


def save_run(run: Trajectory, path: Path, more: Mapping[str, np.ndarray] | None = None) -> None:
    """`Trajectory.save` without the loads, which `cs.read_run` reads; `more` arrays beside it."""
    arrays, described = packed(vars(run), loads=False)
    save_archive(path, KIND, SCHEMA, {**arrays, **(more or {})}, described)


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
