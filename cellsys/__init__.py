"""cellsys: a cell on its matrix as a control system.

Plant (mechanics of cell and matrix, full-order or reduced), controller (polarity law), sensor
(direction of greatest stiffness), closed into one loop. Names are loaded when first used.
"""

import lazy_loader as _lazy

from cellsys.renamed import old_names as _old_names
from cellsys.version import __version__

_lazily, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
__getattr__ = _old_names(__name__, _lazily)
__all__ = [*__all__, "__version__"]
__docformat__ = "numpy"  # how pdoc reads the docstrings
