"""What an integrator that solves a whole run at once returns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from cellsys.system import Event


@dataclass(frozen=True, eq=False, kw_only=True)
class Solution:
    """Samples, interval averages, statistics and events of a run.

    Parameters
    ----------
    x : (T, n)
        States.
    eta, u : (T - 1, n_eta), (T - 1, n) or None
        Averages over the intervals between samples; None where they were not asked for.
    statistics : dict
        Counts and times.
    events : list of Event
    estimate : callable or None
        () -> (n,): the method's own estimate of its largest global error in each state, worked
        out when called; None where it has none.
    """

    x: np.ndarray
    eta: np.ndarray | None
    u: np.ndarray | None
    statistics: Mapping[str, float | str | None]
    events: list[Event] = field(default_factory=list)
    estimate: Callable[[], np.ndarray] | None = None
