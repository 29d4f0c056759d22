"""The figure of the matrix's displacement in a report."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellsys.contracts import MatrixKind
from cellsys.figures import save_png, sheet
from cellsys.study.measure import MATRIX
from cellsys.trajectory import Trajectory


def draw_displacement(run: Trajectory, matrix: MatrixKind, path: Path) -> Path:
    """Write the field where it is greatest and at the end, one panel where that is the same."""
    u = run.block(MATRIX)
    greatest = int(np.linalg.norm(u, axis=2).max(axis=1).argmax())
    moments = {len(run) - 1: "at the end"} | {greatest: "greatest"}
    figure, axes = sheet((7.0 if len(moments) == 1 else 12.0, 5.6), 1, len(moments))
    for ax, k in zip(np.atleast_1d(axes), sorted(moments), strict=True):
        matrix.draw(run, ax, k=k)
        ax.set_title(f"{moments[k]}, t = {run.t[k]:g} s")
    return save_png(figure, path)
