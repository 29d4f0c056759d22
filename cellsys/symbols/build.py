"""`symbolic`: loops as CasADi expressions with names, what shooting, fitting and steering take."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DimensionError, ParameterError
from cellsys.loop import ClosedLoop, ScheduledLoop
from cellsys.population.ported.equivariant_cells import EquivariantCells
from cellsys.population.ported.linear_cells import PortedCells
from cellsys.population.printed.cells import CoupledCells
from cellsys.symbols.cells import SymbolicRequest, ported_form, printed_form, single_form
from cellsys.symbols.form import SymbolicLoop
from cellsys.symbols.parts import INPUTS, PARAMETERS, known_names
from cellsys.symbols.steps import equivariant_form, scheduled_form, stepped_form

SymbolicSource = ClosedLoop | ScheduledLoop | CoupledCells | PortedCells | EquivariantCells


@checked
def symbolic(
    loop: SymbolicSource,
    *,
    parameters: Sequence[str] = ("kappa",),
    inputs: Sequence[str] = (),
    per_cell: bool = False,
    points: np.ndarray | None = None,
    place: np.ndarray | None = None,
) -> SymbolicLoop:
    """The loop as CasADi expressions with named states, inputs, parameters and outputs.

    Parameters
    ----------
    loop : ClosedLoop, ScheduledLoop, or coupled cells
        One cell; cells coupled in a printed form (with K m <= 1000); cells on a field, which is
        taken linear about rest. A loop with a step of its own gives that step, with the same
        numbers: that of a `ScheduledLoop` on its clock, that of equivariant cells on a field
        frozen at the end of training, loads where the cells stand.
    parameters : sequence of {"kappa", "K_d", "sensor.gain", "force", "A", "B", "offset", \
"coupling"}
        What is kept as a symbol; entries of arrays are named as ``K_d[0,3]``. "sensor.gain" is a
        factor on all of the sensor but its intercept, "force" one on the commands, "coupling" one
        on the weights of the interaction (1 each). A, B and offset are those of the continuous
        plant of one cell, coupling that of `Superposition` and `Feedback`; equivariant cells have
        kappa, K_d and sensor.gain.
    inputs : sequence of {"amplitude", "heading"}
        What becomes an input of each cell: amplitude (1), and the heading (rad) that commands are
        given for, instead of the polarity. Cells without a sensor keep theirs or are told it.
    per_cell : bool
        Each cell has its own kappa, K_d, sensor.gain and force: ``cell1_kappa, cell2_kappa``.
    points : (P, 2) or (P, 3), optional
        um; loads on the matrix at these become inputs ``load1_x, ...`` (pN). Cells on a field.
    place : (2, 1 + m), optional
        Map of [1; z] to the place of a cell, um, which becomes an output ``x, y``. Equivariant
        cells have their own.

    Raises
    ------
    ParameterError, DimensionError
        An unknown name, one that the loop has not got, or cells above the limit.
    """
    wanted = SymbolicRequest(
        parameters=known_names(parameters, PARAMETERS, "parameters"),
        inputs=known_names(inputs, INPUTS, "inputs"),
        per_cell=per_cell,
        points=points,
        place=place,
    )
    own = isinstance(loop, (ScheduledLoop, EquivariantCells))
    if place is not None and own:
        raise ParameterError("place: equivariant cells have their own; leave it out")
    if place is not None and place.shape != (2, 1 + loop.order):
        raise DimensionError(f"place must be (2, {1 + loop.order}), got {place.shape}")
    if isinstance(loop, ClosedLoop):
        return single_form(loop, wanted)
    if isinstance(loop, ScheduledLoop):
        return scheduled_form(loop, wanted)
    if isinstance(loop, CoupledCells):
        return printed_form(loop, wanted)
    if isinstance(loop, EquivariantCells):
        return equivariant_form(loop, wanted)
    return ported_form(loop, wanted) if loop.model.dt is None else stepped_form(loop, wanted)
