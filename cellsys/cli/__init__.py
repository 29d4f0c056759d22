"""The command line: the same names as the Python interface.

Exit codes: 0 done, 1 a computation failed or was interrupted, 2 bad input (one line on standard
error, no traceback, nothing half-written), 129 ended by SIGHUP, 143 by SIGTERM.
"""

from __future__ import annotations

import os
import sys

from cellsys.cli import cache, cost, couple, doctor, effects, exchange, models, new, scenes, sweep
from cellsys.cli.console import app, say_error

__all__ = [
    "app",
    "cache",
    "cost",
    "couple",
    "doctor",
    "effects",
    "exchange",
    "main",
    "models",
    "new",
    "scenes",
    "sweep",
]


def main() -> None:
    """Entry point of ``cellsys`` and ``python -m cellsys``."""
    # Vectors here are short: a second BLAS thread costs time. Numpy is not loaded yet.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    from cellsys.cli.ending import Signals, leave_streams, told_in_one_line
    from cellsys.errors import CellsysError, ExecutorError, IntegrationError

    code: int | str | None = None
    with Signals() as signals, told_in_one_line():
        try:
            app(standalone_mode=True)
        except SystemExit as stop:
            code = stop.code
        except (IntegrationError, ExecutorError) as error:
            code = say_error(error, 1)
        except (CellsysError, OSError) as error:
            code = say_error(error, 2)
        except KeyboardInterrupt:
            code = 1  # outside any command: while starting up
    if signals.code is not None:
        # Also where what the signal raised was turned into something else on its way here.
        leave_streams()
        sys.exit(signals.code)
    sys.exit(code)
