"""Closed polarity loops of coupled cells, linearised about one common point.

Every cell at the same emergent z and polarity p, dp = T xi. Per eigenvalue omega of the
interaction, in the coordinates of `cellsys.population.printed.blocks` (z = T_omega x):

    [[M, G B_u T], [kappa S T_omega, -kappa p*.d*]]

Here cells do interact although [36] moves no pole of the plant: d is read from the shared field,
so the loop gain of the mean block grows with K.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.linalg as sla

from cellsys.drawable import Drawable
from cellsys.errors import MemoryBudgetError, ParameterError
from cellsys.population.poleset import PoleSet, pole_set
from cellsys.population.printed.printed_cells import PrintedCells


@dataclass(frozen=True, eq=False)
class CoupledLoop(Drawable):
    """Closed loops of K cells about one common point.

    Attributes
    ----------
    poles : PoleSet
        Closed-loop poles with multiplicities.
    plant_poles : PoleSet
        The same with the loops open.
    residual : float
        Rate at the point, per unit of state; not 0: frozen in time.
    n_cells : int
    """

    poles: PoleSet
    plant_poles: PoleSet
    residual: float
    n_cells: int

    _figure: ClassVar[str] = "coupled_loop"

    def __str__(self) -> str:
        return (
            f"{self.n_cells} closed loops: largest real part {self.poles.abscissa:.4g} 1/s "
            f"(plant {self.plant_poles.abscissa:.4g} 1/s)"
        )


def linearize(cells: PrintedCells, at: object = None) -> CoupledLoop:
    """Linearise `CoupledCells` with every cell at the same point.

    Parameters
    ----------
    cells : CoupledCells
        With a controller.
    at : None, float, (z, p), optional
        As in `ClosedLoop.linearize`; z is the emergent latent state there.
    """
    if cells.loop is None:
        raise ParameterError(
            "linearize needs a controller: a model with heading features as inputs and a sensor"
        )
    if cells.modes is None:
        raise MemoryBudgetError(
            "linearize needs the modal or graph route: make the weights symmetric"
        )
    point = cells.loop.linearize(at)
    if len(point.slow):
        raise ParameterError("linearize of coupled cells sets no slow modes apart")
    parts = []
    for block, n in zip(cells.blocks(), cells.modes.multiplicity, strict=True):
        drive = block.G @ point.B_heading
        read = point.kappa * (point.S_heading @ block.T)
        M = np.block(
            [[block.M, drive[:, None]], [read[None], np.array([[-point.kappa * point.strength]])]]
        )
        parts.append((sla.eigvals(M), int(n), block.omega))
    note = f"{cells.coupling.name}, closed loops about one common point"
    return CoupledLoop(pole_set(parts, note, None), cells.pole_set(), point.residual, cells.n_cells)
