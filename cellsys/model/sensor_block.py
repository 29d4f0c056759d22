"""A sensor of latent states as a block of python-control: z in, sensed direction d out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from cellsys.state_space import block

if TYPE_CHECKING:
    from control import NonlinearIOSystem

XYZ = ("x", "y", "z")


def vector_names(name: str, cells: Sequence[str] = ("",)) -> list[str]:
    """``d_x, d_y, d_z``, or ``cell1_d_x, ...`` of cells called ``cell1_, ...``."""
    return [f"{cell}{name}_{axis}" for cell in cells for axis in XYZ]


def latent_names(m: int, cells: Sequence[str] = ("",), name: str = "z") -> list[str]:
    """``z[0], z[1], ...`` of each cell."""
    return [f"{cell}{name}[{i}]" for cell in cells for i in range(m)]


def sensor_block(
    read: Callable[[np.ndarray], np.ndarray],
    m: int,
    cells: Sequence[str] = ("",),
    *,
    name: str = "sensor",
    latent: str = "z",
    sensed: str = "d",
) -> NonlinearIOSystem:
    """The block of K sensors, K the number of `cells`.

    Parameters
    ----------
    read : callable
        Directions (K, 3) of latent states (K, m).
    latent, sensed : str
        What its signals are called.
    """

    def output(t: float, x: np.ndarray, u: np.ndarray, params: Mapping[str, float]) -> np.ndarray:
        return read(np.asarray(u).reshape(len(cells), m)).ravel()

    return block(name, latent_names(m, cells, latent), vector_names(sensed, cells), output)
