"""Where K cells touch one shared field, and what their ports must be."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import LoadPort, MatrixField
from cellsys.errors import DimensionError, ParameterError
from cellsys.kinds import FILLED, Filled
from cellsys.population.graph import check_positions
from cellsys.ports.ports import PortPassivity
from cellsys.units import real_array


@checked
@dataclass(frozen=True, eq=False)
class Placement:
    """Where the ports of K cells touch one shared field.

    Parameters and errors are those of `LoadPorts`.
    """

    field: MatrixField
    positions: np.ndarray
    _: KW_ONLY
    headings: Filled[np.ndarray] = FILLED
    port: LoadPort | None = None
    allow_active: bool = False
    name: ClassVar[str] = "LoadPorts"

    def __post_init__(self) -> None:
        x = check_positions(self.positions)
        theta = np.zeros(len(x)) if self.headings is None else real_array(self.headings, "headings")
        if theta.shape != (len(x),) or not np.all(np.isfinite(theta)):
            raise DimensionError(f"headings must be {len(x)} finite angles in rad")
        object.__setattr__(self, "positions", x)
        object.__setattr__(self, "headings", theta)

    def check_port(self, passivity: PortPassivity) -> None:
        """Refuse an active port, with the reason.

        Raises
        ------
        ParameterError
            When the index is below -1e-10 and `allow_active` is not set.
        """
        if passivity.active and not self.allow_active:
            raise ParameterError(
                f"the velocity input C makes the port active: passivity index "
                f"{passivity.index:.2g} at {passivity.frequency:.3g} rad/s, bound -1e-10; freely "
                "fitted inputs become unstable from some number of cells on "
                "[notes: measurements, free ports]. Use "
                "CellPort.collocated(...), or allow_active=True to compute all the same"
            )
