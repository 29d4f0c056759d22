"""The command line: the same names as the Python interface.

Exit codes: 0 done, 1 a computation failed, 2 bad input (one line on standard error, no
traceback, nothing half-written).
"""

from __future__ import annotations

import os
import sys

from cellsys.cli import cost, couple, effects, models, scenes, sweep
from cellsys.cli.console import app, say_error

__all__ = ["app", "cost", "couple", "effects", "main", "models", "scenes", "sweep"]


def main() -> None:
    """Entry point of ``cellsys`` and ``python -m cellsys``."""
    # Vectors here are short: a second BLAS thread costs time. Numpy is not loaded yet.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    from cellsys.errors import CellsysError, IntegrationError

    try:
        app(standalone_mode=True)
    except IntegrationError as error:
        say_error(error)
        sys.exit(1)
    except (CellsysError, OSError) as error:
        say_error(error)
        sys.exit(2)
    except KeyboardInterrupt:
        # Outside any command: while starting up.
        sys.exit(1)
