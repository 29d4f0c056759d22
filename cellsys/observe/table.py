"""`ReadOutTable`: read-outs per cell and time, and per pair and time, with units in their names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DimensionError, ParameterError, UnknownNameError
from cellsys.kinds import Takes
from cellsys.observe.motion import MeanSquares
from cellsys.shown import Shown
from cellsys.store.atomic import atomic_path

if TYPE_CHECKING:
    import pandas


# Names of cells stand among the numbers.
Columns = Annotated[Mapping[str, np.ndarray], Takes(Mapping[str, object])]


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class ReadOutTable(Shown):
    """What `cs.observe` finds, as columns; NaN where a read-out does not exist.

    The unit of a column stands at the end of its name: ``area_um2``, ``speed_um_s``, and
    ``area_px2``, ``speed_px_frame`` of a movie whose scale is not known. Rates and directions of
    movement, and forces, are those of the interval that follows the row's time.

    Parameters
    ----------
    cells : mapping of str to array (R,)
        Per cell and time: ``cell``, time, ``x``, ``y`` (centroid), ``area``, ``perimeter``,
        ``elongation_axis_deg`` in [0, 180), ``aspect_ratio``, ``movement_direction_deg``,
        ``directionality_deg``, ``speed``; of runs with forces ``volume_um3``,
        ``traction_sum_pN``, ``net_traction_pN``, ``net_traction_percent``, ``dipole_pN_um``,
        ``strain_energy_fJ``, ``cue_strength``.
    pairs : mapping of str to array (P,)
        Per pair and time: ``first``, ``second``, time, ``centroid_distance``,
        ``contour_distance`` (negative where contours overlap), ``first_to_second_deg`` and
        ``second_to_first_deg`` (angle in [0, 180] between the directionality of the one, or its
        movement where there is no contour, and the way to the centroid of the other).
    motion : mapping of str to array (C,)
        Per cell: ``cell``, ``mean_speed``, ``path_length``, ``net_displacement``,
        ``persistence_ratio``, ``persistence_time``.
    msd : MeanSquares
    length_unit, time_unit : str
    source : mapping
    """

    cells: Columns
    pairs: Columns
    motion: Columns
    msd: MeanSquares
    length_unit: str
    time_unit: str
    source: Mapping[str, object]

    def __post_init__(self) -> None:
        for name in ("cells", "pairs", "motion"):
            table = getattr(self, name)
            if len({np.shape(column) for column in table.values()}) > 1:
                raise DimensionError(f"the columns of {name} must be of one length")

    def __str__(self) -> str:
        shown = [n for n in self.cells if n not in ("cell", f"t_{self.time_unit}")]
        names = ", ".join(dict.fromkeys(self.cells["cell"].tolist()))
        names = names if len(names) <= 60 else f"{names[:57]}..."
        count = len(next(iter(self.pairs.values()), []))
        return (
            f"ReadOutTable: {len(self.cells['cell'])} rows of cells {names}; {count} rows of "
            f"pairs\n{', '.join(shown)}\n{self.msd}"
        )

    def _rows(self) -> tuple[list[str], list[list[object]]]:
        return list(self.cells), [
            list(row) for row in zip(*(c.tolist() for c in self.cells.values()), strict=True)
        ]

    def of(self, cell: str, name: str) -> np.ndarray:
        """A column of one cell over time; `name` with or without its unit."""
        known = list(dict.fromkeys(self.cells["cell"].tolist()))
        if cell not in known:
            raise UnknownNameError(f"no cell {cell!r}; there are {', '.join(known[:8])}")
        return self.cells[_column(self.cells, name)][self.cells["cell"] == cell]

    def pair(self, first: str, second: str, name: str) -> np.ndarray:
        """A column of one pair over time; `name` with or without its unit."""
        if not self.pairs:
            raise UnknownNameError("the table holds no pairs of cells")
        found = (self.pairs["first"] == first) & (self.pairs["second"] == second)
        if not found.any():
            raise UnknownNameError(f"no pair {first!r}, {second!r} among the pairs of the table")
        return self.pairs[_column(self.pairs, name)][found]

    def to_csv(self, path: str | Path, *, part: str = "cells") -> Path:
        """Write ``cells``, ``pairs`` or ``motion`` as CSV, units in the header; NaN stays empty."""
        table = self._part(part)
        target = Path(path)
        columns = [c.tolist() for c in table.values()]
        with atomic_path(target) as temporary:
            with temporary.open("w", encoding="utf-8", newline="") as file:
                file.write(",".join(_header(name) for name in table) + "\n")
                for row in zip(*columns, strict=True):
                    file.write(",".join(_cell(v) for v in row) + "\n")
        return target

    def to_pandas(self, *, part: str = "cells") -> pandas.DataFrame:
        """``cells``, ``pairs`` or ``motion`` as a data frame, indexed by cell (pair) and time.

        Raises
        ------
        ParameterError
            Without pandas (extra ``data``).
        """
        try:
            import pandas
        except ImportError as error:
            raise ParameterError("to_pandas needs pandas: pip install 'cellsys[data]'") from error
        table = self._part(part)
        keys = [n for n in table if n in ("cell", "first", "second", f"t_{self.time_unit}")]
        return pandas.DataFrame(dict(table)).set_index(keys)

    def _part(self, part: str) -> Mapping[str, np.ndarray]:
        known = {"cells": self.cells, "pairs": self.pairs, "motion": self.motion}
        if part not in known:
            raise ParameterError(f"part must be one of {', '.join(known)}, got {part!r}")
        return known[part]


def _column(table: Mapping[str, np.ndarray], name: str) -> str:
    if name in table:
        return name
    found = [n for n in table if n.startswith(f"{name}_")]
    if len(found) != 1:
        raise UnknownNameError(f"no read-out {name!r}; there are {', '.join(table)}")
    return found[0]


_UNITS = ("um2", "px2", "um3", "um_s", "px_s", "um_frame", "px_frame", "pN_um", "um", "px", "s",
          "frame", "deg", "pN", "percent", "fJ")  # fmt: skip


def _header(name: str) -> str:
    """``area_um2`` -> ``area [um2]``."""
    for unit in _UNITS:
        if name.endswith(f"_{unit}"):
            text = {"um_s": "um/s", "px_s": "px/s", "um_frame": "um/frame", "px_frame": "px/frame",
                    "pN_um": "pN um", "um2": "um^2", "px2": "px^2", "um3": "um^3",
                    "percent": "%"}.get(unit, unit)  # fmt: skip
            return f"{name.removesuffix(f'_{unit}')} [{text}]"
    return name


def _cell(value: object) -> str:
    if isinstance(value, float):
        return repr(value) if value == value else ""
    text = str(value)
    return f'"{text}"' if "," in text or '"' in text else text
