"""`couple`: the one way to put K cells on one matrix."""

from __future__ import annotations

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import Cells, LinearModel, needs
from cellsys.errors import ParameterError
from cellsys.loop import PolarityLaw
from cellsys.model import StiffnessSensor
from cellsys.population.graph import InteractionGraph, check_positions
from cellsys.population.printed.forms import Superposition
from cellsys.population.request import Coupling, CouplingRequest
from cellsys.ports.field_sensor import FieldSensor
from cellsys.ports.ports import CellPort
from cellsys.units import real_array

MOST_CELLS = 10**15  # counts of poles stay whole numbers in 64 bits


@checked
def couple(
    model: LinearModel | CellPort,
    n_cells: int | None = None,
    coupling: Coupling | None = None,
    *,
    graph: InteractionGraph | np.ndarray | None = None,
    positions: np.ndarray | None = None,
    headings: np.ndarray | None = None,
    controller: PolarityLaw | None = None,
    sensor: StiffnessSensor | FieldSensor | None = None,
    normalise: bool = True,
) -> Cells:
    """K copies of one cell on one matrix.

    Parameters
    ----------
    model : LatentModel
        One cell with its matrix; with rows named ``field`` for the printed forms.
    n_cells : int
        K; may be left out where a graph, positions or LoadPorts say it.
    coupling : Superposition, MappedSuperposition, Feedback, LoadPorts or one of your own
        Anything with a name and `join(request)`; see `CouplingRequest`. Default `Superposition()`.
    graph : InteractionGraph or (K, K), optional
        Default: every cell meets every other with weight 1.
    positions : (K, 2) or (K, 3), optional
        um; kept with the result. The printed forms know no distance: give
        ``graph=InteractionGraph.attenuated(positions, length)`` for that.
    headings : (K,), optional
        Polarity angles at the start, rad; default 0. As a controller, for a model with a sensor.
    controller, sensor, normalise
        As in `closed_loop`, the same for every cell.

    Raises
    ------
    RepresentationError
        When the form needs rows of V and the model has none.
    ParameterError, DimensionError
    """
    coupling = Superposition() if coupling is None else coupling
    sizes = {}
    if graph is not None:
        graph = graph if isinstance(graph, InteractionGraph) else InteractionGraph(graph)
        sizes["graph"] = graph.n_cells
    if positions is not None:
        positions = check_positions(positions)
        sizes["positions"] = len(positions)
    if headings is not None:
        headings = np.atleast_1d(real_array(headings, "headings"))
        sizes["headings"] = len(headings)
    if n_cells is not None:
        if isinstance(n_cells, bool) or not isinstance(n_cells, (int, np.integer)) or n_cells < 1:
            raise ParameterError(f"n_cells must be a whole number >= 1, got {n_cells!r}")
        if n_cells > MOST_CELLS:
            raise ParameterError(f"n_cells must be at most {MOST_CELLS:.0e}, got {n_cells:.3e}")
        sizes["n_cells"] = int(n_cells)
    cells = coupling.join(
        CouplingRequest(
            model=model,
            sizes=sizes,
            graph=graph,
            positions=positions,
            headings=headings,
            controller=controller,
            sensor=sensor,
            normalise=normalise,
        )
    )
    needs(cells, Cells, f"{type(coupling).__name__}.join(...)")
    return cells
