"""Read-outs with their error, and the displacement of the matrix, in a report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cellsys.figures import displacement_field, save_png, sheet
from cellsys.study.measure import short_number
from cellsys.trajectory import Trajectory

MATRIX = "matrix.displacement"
MEASURED = ("crawl_um", "displacement_max_um", "displacement_rms_end_um")  # 0 where nothing moves


def matrix_row(run: Trajectory) -> dict[str, float]:
    """Greatest displacement of any node over the run and when, rms at the end, error; or nothing.

    um and s. The error is `Trajectory.error_of`: what is below it is not to be told from zero.
    """
    if MATRIX not in run.states:
        return {}
    u = np.linalg.norm(run.block(MATRIX), axis=2)
    return {
        "displacement_max_um": float(u.max()),
        "displacement_max_at_s": float(run.t[u.max(axis=1).argmax()]),
        "displacement_rms_end_um": float(np.sqrt(np.mean(u[-1] ** 2))),
        "displacement_error_um": run.error_of(MATRIX),
    }


def texts(row: Mapping[str, float]) -> dict[str, str]:
    """The values of a row as text; what was measured and is below its own error says so instead.

    The error is the row's entry that ends in ``_error_um``.
    """
    error = max((v for k, v in row.items() if k.endswith("_error_um")), default=-1.0)
    return {
        key: f"below its error, {error:.2g}" if key in MEASURED and not value > error
        else short_number(value, 4)
        for key, value in row.items()
    }  # fmt: skip


def draw_displacement(run: Trajectory, path: Path) -> Path:
    """Write the field where it is greatest and at the end, one panel where that is the same."""
    u, rest = run.block(MATRIX), run.geometry["matrix.rest"]
    greatest = int(np.linalg.norm(u, axis=2).max(axis=1).argmax())
    moments = {len(run) - 1: "at the end"} | {greatest: "greatest"}
    figure, axes = sheet((7.0 if len(moments) == 1 else 12.0, 5.6), 1, len(moments))
    for ax, k in zip(np.atleast_1d(axes), sorted(moments), strict=True):
        displacement_field(rest, u[k], ax, error=run.error_of(MATRIX))
        ax.set_title(f"{moments[k]}, t = {run.t[k]:g} s")
    return save_png(figure, path)
