"""Results that hand themselves to other programs' tables.

`Exported.to_xarray` and `to_pandas` load `cellsys.io` by name at call time, as `plot` does with
`cellsys.figures`: the second and last upward step in the house. Neither xarray nor pandas is
loaded before it is asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from cellsys.drawable import Drawable

if TYPE_CHECKING:
    import pandas
    import xarray


class Exported(Drawable):
    """Mixin: `to_xarray` and `to_pandas` of a run."""

    def to_xarray(self) -> xarray.Dataset:
        """The run as a labelled data set; see `cellsys.io.to_xarray`."""
        made: xarray.Dataset = importlib.import_module("cellsys.io").to_xarray(self)
        return made

    def to_pandas(self) -> pandas.DataFrame:
        """The read-outs of the run by cell and time: `cs.observe` as a data frame."""
        made: pandas.DataFrame = (
            importlib.import_module("cellsys.observe").observe(self).to_pandas()
        )
        return made
