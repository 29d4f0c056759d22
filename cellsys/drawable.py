"""Results that know how to draw themselves.

`Drawable.plot` loads `cellsys.figures` by name at call time. It is the one upward step in the
house, and it keeps matplotlib out of every import that does not draw.
"""

from __future__ import annotations

import importlib
from typing import Any, ClassVar

from cellsys.shown import Shown


class Drawable(Shown):
    """Mixin: `plot(ax=None)` calls the function of `cellsys.figures` named by `_figure`."""

    _figure: ClassVar[str]

    def plot(self, ax: Any = None) -> Any:
        """Draw into `ax` (new axes when None) and return what was drawn; never calls ``show``."""
        figures = importlib.import_module("cellsys.figures")
        return getattr(figures, self._figure)(self, ax=ax)
