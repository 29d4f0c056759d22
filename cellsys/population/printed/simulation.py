"""Runs of coupled cells: exact flows composed, or an integrator on the whole system."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cellsys.contracts import Integrator
from cellsys.errors import ParameterError
from cellsys.integrate.capabilities import ComposesFlows, Splits
from cellsys.integrate.simulate import simulate
from cellsys.integrate.splitting import Splitting
from cellsys.loop.loop_system import model_error
from cellsys.population.printed.printed_cells import PrintedCells
from cellsys.population.printed.system import coupled_system
from cellsys.trajectory import Trajectory

SERVE = "DOP853, Radau, LSODA or CVODES"


def run(
    cells: PrintedCells,
    t: np.ndarray,
    integrator: Integrator | None,
    z0: np.ndarray | None,
    p0: np.ndarray | None,
    progress: Callable[[float], None] | None = None,
) -> Trajectory:
    """Simulate `CoupledCells`; see `CoupledCells.simulate`."""
    system = coupled_system(cells, z0, p0, emergent=True)
    if not isinstance(system, Splits):
        if integrator is None:
            raise ParameterError(
                f"the route of these cells is {cells.route}; simulate() needs an integrator there "
                f"({SERVE})"
            )
        if isinstance(integrator, ComposesFlows):
            raise ParameterError(
                f"{type(integrator).__name__} composes exact flows of coupled cells, and the route "
                f"of these is {cells.route}; use {SERVE}, or make the weights symmetric"
            )
    method = Splitting() if integrator is None else integrator
    return simulate(
        system,
        method.of_cells() if isinstance(method, ComposesFlows) else method,
        t,
        auxiliaries=False,
        progress=progress,
        label=f"{cells.n_cells} coupled cells, {cells.coupling.name}",
        model_error=model_error(cells.model),
    )
