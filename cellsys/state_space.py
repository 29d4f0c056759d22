"""Matrices as `control.StateSpace`, whatever their shapes.

python-control takes an empty matrix of one row for one of no rows, so that a system without inputs
and with one state or one output cannot be written in it. Such a system gets one input, called
``none``, that does nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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


Signals = Sequence[str]
Formula = Callable[[float, np.ndarray, np.ndarray, Mapping[str, float]], np.ndarray]


def block(
    name: str,
    inputs: Signals,
    outputs: Signals,
    output: Formula | None,
    *,
    states: Signals = (),
    update: Formula | None = None,
    dt: float | None = None,
    params: Mapping[str, float] | None = None,
) -> control.NonlinearIOSystem:
    """A `control.NonlinearIOSystem` with named signals.

    Parameters
    ----------
    output, update : callable
        ``f(t, x, u, params)`` (p,) and dx/dt, or the state a step later, (n,); without `update` a
        block that has no state, without `output` one whose outputs are its states.
    dt : float or None
        s; 0 continuous, None what the others in the diagram have.
    """
    import control

    return control.nlsys(
        update,
        output,
        inputs=list(inputs),
        outputs=list(outputs),
        states=list(states) if states else None,
        dt=dt,
        name=name,
        params=dict(params or {}),
    )


def joined(
    name: str,
    blocks: Sequence[control.NonlinearIOSystem],
    outputs: Signals,
    inputs: Signals = (),
) -> control.InterconnectedSystem:
    """The diagram of these blocks: an input is fed by the output of its name.

    Parameters
    ----------
    outputs, inputs : sequence of str
        What the whole shows, and what it takes from outside.
    """
    import control

    return control.interconnect(list(blocks), inputs=list(inputs), outputs=list(outputs), name=name)
