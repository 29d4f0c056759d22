"""Results that know how to draw themselves.

`Drawable.plot` loads `cellsys.figures` by name at call time. It is the one upward step in the
house, and it keeps matplotlib out of every import that does not draw.
"""

from __future__ import annotations

import importlib
from typing import ClassVar

from cellsys.shown import Shown


def draw_by(figure: str, *drawn: object, ax: object = None, error: float | None = None) -> object:
    """Call the function of `cellsys.figures` of this name, with its `error` where there is one."""
    draw = getattr(importlib.import_module("cellsys.figures"), figure)
    return draw(*drawn, ax=ax) if error is None else draw(*drawn, ax=ax, error=error)


class Drawable(Shown):
    """Mixin: `plot(ax=None)` calls the function of `cellsys.figures` named by `_figure`."""

    _figure: ClassVar[str]

    def plot(self, ax: object = None) -> object:
        """Draw into `ax` (new axes when None) and return what was drawn; never calls ``show``."""
        return draw_by(self._figure, self, ax=ax)
