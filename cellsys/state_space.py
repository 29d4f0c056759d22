"""Matrices as `control.StateSpace`, whatever their shapes.

python-control takes an empty matrix of one row for one of no rows, so that a system without inputs
and with one state or one output cannot be written in it. Such a system gets one input, called
``none``, that does nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import control


def state_space(
    A: np.ndarray,
    B: np.ndarray,
    C: np.ndarray,
    D: np.ndarray,
    dt: float,
    *,
    states: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    name: str | None = None,
) -> control.StateSpace:
    """The system with these matrices (n, n), (n, m), (p, n), (p, m) and names.

    Parameters
    ----------
    dt : float
        s; 0 for a continuous system.
    """
    import control

    if B.shape[1] == 0 and 1 in (len(B), len(D)):
        B, D, inputs = np.zeros((len(B), 1)), np.zeros((len(D), 1)), ["none"]
    return control.ss(
        A,
        B,
        C,
        D,
        dt,
        states=list(states) if states else None,
        inputs=list(inputs) if inputs else None,
        outputs=list(outputs) if outputs else None,
        name=name,
        remove_useless_states=False,
    )
