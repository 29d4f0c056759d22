"""The offset b of z' = A z + B c + b in a plant, which python-control has no place for.

"input"      one more input, named ``one``, of column b: the affine model, driven by [c; 1]
"shifted"    in z - z*, with A z* + b = 0: the affine model about its equilibrium
"drop"       without b: differences of two runs
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import scipy.linalg as sla

from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.units import real_array

Offset = Literal["input", "shifted", "drop"]
ONE = "one"  # the input of the offset: constant 1


def signal_names(names: Sequence[str]) -> list[str]:
    """Names as python-control allows them: it takes no dots."""
    return [name.replace(".", "_") for name in names]


def with_offset(
    B: np.ndarray, b: np.ndarray, names: Sequence[str], offset: Offset
) -> tuple[np.ndarray, list[str]]:
    """Input matrix and names of a plant, the column b with them for ``"input"``.

    Raises
    ------
    ParameterError
        For an input that is itself called ``one``.
    """
    signals = signal_names(names)
    if offset != "input":
        return B, signals
    if ONE in signals:
        raise ParameterError(
            f"an input is called {ONE!r}, which is the name of the offset's own input; rename it, "
            "or take offset='shifted' or offset='drop'"
        )
    return np.column_stack([B, b]), [*signals, ONE]


def equilibrium(
    A: np.ndarray, B: np.ndarray, b: np.ndarray, commands: np.ndarray | None = None
) -> np.ndarray:
    """z* (m,) of A z* + B c + b = 0, the one of least norm where A is singular.

    Singular values below 1e-12 of the largest count as zero.

    Parameters
    ----------
    commands : (n_c,), optional
        c; zero when left out.

    Raises
    ------
    DataError
        Where there is none: the drive pushes an integrator.
    DimensionError
    """
    drive = np.array(b, dtype=float)
    if commands is not None:
        c = real_array(commands, "commands")
        if c.shape != (B.shape[1],):
            raise DimensionError(f"commands must have shape ({B.shape[1]},), got {c.shape}")
        drive = drive + B @ c
    z = sla.lstsq(A, -drive, cond=1e-12)[0]
    # Of a solution, what rounding leaves; of no solution, the share of b along the integrators.
    miss = float(np.linalg.norm(A @ z + drive))
    size = float(np.linalg.norm(A, 2) * np.linalg.norm(z) + np.linalg.norm(drive))
    if not miss <= 1e-10 * size:
        raise DataError(
            f"no equilibrium: A is singular, and {miss:.2g} 1/s of the drive's "
            f"{np.linalg.norm(drive):.2g} 1/s pushes an integrator; take offset='input', or "
            "commands at which it stands still"
        )
    return np.asarray(z)
