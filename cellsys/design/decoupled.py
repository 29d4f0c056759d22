"""A loop in coordinates in which its plant falls into blocks of one or two states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg as sla

from cellsys.loop import ClosedLoop
from cellsys.model import LatentModel, StiffnessSensor

_WORST = 1e8  # condition of the coordinates: half the digits of a double are left


def decoupled(
    loop: ClosedLoop, place: np.ndarray | None
) -> tuple[ClosedLoop, np.ndarray | None] | None:
    """The loop and its map to places, [1; z] -> um, with z = T w; None where T is near singular.

    A step of the plant then costs m products instead of m^2.
    """
    A, B, b = loop.model.continuous_matrices()
    values, vectors = sla.eig(A)
    columns: list[np.ndarray] = []
    blocks: list[np.ndarray] = []
    for value, v in zip(values, vectors.T, strict=True):
        if value.imag == 0:
            columns.append(v.real)
            blocks.append(np.array([[value.real]]))
        elif value.imag > 0:
            columns += [v.real, v.imag]
            blocks.append(np.array([[value.real, value.imag], [-value.imag, value.real]]))
    T = np.column_stack(columns)
    if np.linalg.cond(T) > _WORST:
        return None
    inside = sla.solve(T, np.column_stack([B, b, loop.z0]))
    K_d = np.column_stack([loop.sensor.K_d[:, 0], loop.sensor.S_d @ T])
    sensor = StiffnessSensor(K_d=K_d)
    model = LatentModel(
        A=sla.block_diag(*blocks),
        B=inside[:, :-2],
        offset=inside[:, -2],
        input_names=loop.model.input_names,
    )
    moved = None if place is None else np.column_stack([place[:, 0], place[:, 1:] @ T])
    return replace(loop, model=model, sensor=sensor, z0=inside[:, -1]), moved
