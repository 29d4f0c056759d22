"""Where two cells touch: the gap between their membranes, and runs that end at contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np

from cellsys.errors import DataError, ParameterError
from cellsys.system import Event, Layout
from cellsys.trajectory import Trajectory


def cell_names(run: Trajectory) -> list[str]:
    """``cell1``, ``cell2``, ... of a run."""
    return [b.name.split(".")[0] for b in run.states if b.name.endswith(".position")]


def edge_gap(run: Trajectory, first: str = "cell1", second: str = "cell2") -> np.ndarray:
    """Free distance between two cells along the line of their centres (T,), um.

    The distance of the centres minus how far each membrane reaches towards the other;
    0 at contact, negative where the membranes overlap (nothing in the model may forbid it).
    """
    return gap_of(run.block(f"{first}.position"), run.block(f"{second}.position"))


def gap_of(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """`edge_gap` (T,) of membranes with node positions a, b (T, n, 3), um."""
    between = (b.mean(axis=1) - a.mean(axis=1))[:, :2]
    distance = np.linalg.norm(between, axis=1)
    if np.any(distance == 0):
        raise DataError("two cells have the same centre: there is no line between them")
    e = between / distance[:, None]
    reach = [
        np.einsum("tni,ti->tn", x[:, :, :2] - x[:, :, :2].mean(axis=1)[:, None], s * e).max(axis=1)
        for x, s in ((a, 1.0), (b, -1.0))
    ]
    return distance - reach[0] - reach[1]


def touching(states: Layout) -> Callable[[float, np.ndarray], bool]:
    """``until(t, x)`` for `simulate`: whether two cells of the state x touch."""
    names = [b.name for b in states if b.name.endswith(".position")]

    def until(t: float, x: np.ndarray) -> bool:
        places = [states.view(x, name)[None] for name in names]
        return any(gap_of(a, b)[0] <= 0 for a, b in combinations(places, 2))

    return until


def until_contact(run: Trajectory, gap: float = 0.0) -> Trajectory:
    """The run up to the first contact of two cells, which becomes its last event.

    Contact is where the `edge_gap` of a pair falls to `gap` um, found by linear interpolation
    between samples; later samples are dropped. A run without contact is returned as it is.
    """
    if not np.isfinite(gap):
        raise ParameterError(f"gap must be finite, got {gap!r}")
    first: tuple[float, int, str] | None = None
    for a, b in combinations(cell_names(run), 2):
        g = edge_gap(run, a, b) - gap
        below = np.flatnonzero(g <= 0)
        if not below.size:
            continue
        k = int(below[0])
        time = float(run.t[0])
        if k:
            share = g[k - 1] / (g[k - 1] - g[k])
            time = float(run.t[k - 1] + share * (run.t[k] - run.t[k - 1]))
        if first is None or time < first[0]:
            first = (time, k, f"{a} and {b}")
    if first is None:
        return run
    time, k, who = first
    keep = max(k, 1)
    rows = {n: None if getattr(run, n) is None else getattr(run, n)[:keep]
            for n in ("p", "d", "amplitude", "virial", "stiffness")}  # fmt: skip
    steps = {n: None if getattr(run, n) is None else getattr(run, n)[: keep - 1]
             for n in ("eta", "u")}  # fmt: skip
    events = (*(e for e in run.events if e.time <= time), Event(time, "contact", who))
    return replace(run, t=run.t[:keep], x=run.x[:keep], events=events, **rows, **steps)
