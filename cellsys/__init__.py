"""cellsys: a cell on its matrix as a control system.

Plant (mechanics of cell and matrix, full-order or reduced), controller (polarity law), sensor
(direction of greatest stiffness), closed into one loop. Names are loaded when first used.
"""

import lazy_loader as _lazy

from cellsys.version import __version__

_lazily, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
__all__ = [*__all__, "__version__"]
__docformat__ = "numpy"  # how pdoc reads the docstrings


def __getattr__(name: str) -> object:
    try:
        return _lazily(name)
    except AttributeError:  # a name of an earlier version? The table is read only now
        from cellsys.renamed import old_names

        return old_names(__name__, _lazily, frames=1)(name)
