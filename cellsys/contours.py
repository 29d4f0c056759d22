"""`CellOutlines`: the contours of cells seen from above, over time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, ParameterError, UnknownNameError
from cellsys.shown import Shown
from cellsys.tracks import LENGTHS, TIMES
from cellsys.units import shaped_array


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class CellOutlines(Shown):
    """Contours of cells, one for every cell and frame in which it is seen.

    Parameters
    ----------
    cell : tuple of str (S,)
        Whose contour it is.
    frame : int array (S,)
    t : array (S,)
        Time of the frame, in `time_unit`.
    outline : tuple of arrays (n, 2)
        Corners in order, in `length_unit`; the last does not repeat the first.
    length_unit, time_unit : str
        "um" or "px", "s" or "frame".
    touches_edge : bool array (S,), optional
        Whether the cell is cut by the edge of the image.
    source : mapping
        File, scale, how cells were found, what was left out.

    Raises
    ------
    DimensionError, DataError
        Shapes that do not fit, NaN, fewer than three corners, a cell twice in a frame.
    """

    cell: tuple[str, ...]
    frame: np.ndarray
    t: np.ndarray
    outline: tuple[np.ndarray, ...]
    length_unit: str = "um"
    time_unit: str = "s"
    touches_edge: np.ndarray | None = None
    source: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.cell)
        if len(self.outline) != n:
            raise DimensionError(f"outline must hold {n} contours, one per cell and frame")
        frame = shaped_array(self.frame, "frame", (n,)).astype(np.int64)
        object.__setattr__(self, "frame", frame)
        object.__setattr__(self, "t", shaped_array(self.t, "t", (n,)))
        if self.length_unit not in LENGTHS or self.time_unit not in TIMES:
            raise ParameterError(
                f"units must be one of {LENGTHS} and one of {TIMES}, got {self.length_unit!r} and "
                f"{self.time_unit!r}"
            )
        fixed = []
        for k, corners in enumerate(self.outline):
            corners = shaped_array(corners, f"outline[{k}]", (None, 2))
            if len(corners) > 1 and np.array_equal(corners[0], corners[-1]):
                corners = corners[:-1]
            if len(corners) < 3:
                raise DataError(f"outline[{k}] has {len(corners)} corners; three are the least")
            fixed.append(corners)
        object.__setattr__(self, "outline", tuple(fixed))
        if self.touches_edge is not None and np.shape(self.touches_edge) != (n,):
            raise DimensionError(f"touches_edge must have {n} values")
        pairs = list(zip(self.cell, frame.tolist(), strict=True))
        if len(set(pairs)) < n:
            twice = next(p for p, times in Counter(pairs).items() if times > 1)
            raise DataError(f"cell {twice[0]!r} has two contours in frame {twice[1]}")

    def __len__(self) -> int:
        return len(self.cell)

    def __str__(self) -> str:
        if not len(self):
            return "CellOutlines: none"
        return (
            f"CellOutlines: {len(self)} contours of {len(self.names)} cells, frames "
            f"{self.frame.min()} to {self.frame.max()}, {self.length_unit} and {self.time_unit}"
        )

    @cached_property
    def names(self) -> Sequence[str]:
        """Cells in the order in which they are first seen."""
        return list(dict.fromkeys(self.cell))

    def rows(self, cell: str) -> np.ndarray:
        """Contours of a cell in order of time."""
        found = np.array([k for k, name in enumerate(self.cell) if name == cell], dtype=int)
        if not found.size:
            raise UnknownNameError(f"no cell {cell!r}; there are {', '.join(self.names[:8])}")
        return found[np.argsort(self.frame[found], kind="stable")]
