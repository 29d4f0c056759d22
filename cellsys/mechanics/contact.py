"""Where two cells touch: the gap between their membranes, and runs that end at contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DataError, ParameterError
from cellsys.geometry.surface import Mesh, Surface, contour, convex_triangles, gap
from cellsys.mechanics.spreading import SpreadingSystem
from cellsys.system import Event
from cellsys.trajectory import Trajectory, cell_names


@dataclass(frozen=True, eq=False)
class Outline:
    """The membrane of one cell over a run.

    Parameters
    ----------
    name : str
    x : (T, n, 3)
        Nodes, um.
    mesh : Mesh or None
        None: a contour seen from above, in the order of its nodes.
    """

    name: str
    x: np.ndarray
    mesh: Mesh | None

    @staticmethod
    def of(run: Trajectory, name: str) -> Outline:
        """Of a cell in a run.

        Its triangles are ``run.geometry["NAME.triangles"]``. Where a run carries none, nodes that
        all lie at one height are the corners of a contour, and others the convex surface that they
        span at the start: cells start as spheres.

        Raises
        ------
        DataError
            When the run has no such cell, or its triangles cannot be told.
        """
        if name not in cell_names(run.states):
            known = ", ".join(cell_names(run.states)) or "none"
            raise DataError(f"the run has no cell {name!r}; it has {known}")
        x = run.block(f"{name}.position")
        given = run.geometry.get(f"{name}.triangles")
        if given is not None:
            return Outline(name, x, Mesh(np.asarray(given)))
        if np.all(np.ptp(x[:, :, 2], axis=1) == 0.0):
            return Outline(name, x, None)
        try:
            return Outline(name, x, Mesh(convex_triangles(x[0])))
        except DataError as error:
            raise DataError(
                f"{name}: {error}; give the run geometry = {{'{name}.triangles': (m, 3)}}"
            ) from error

    def at(self, k: int) -> Surface:
        """The membrane at sample k."""
        if self.mesh is None:
            return contour(self.x[k, :, :2])
        return self.mesh.at(self.x[k])

    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest coordinates (T, 3) at every sample; a contour has no height."""
        x = self.x if self.mesh is not None else self.x * np.array([1.0, 1.0, 0.0])
        return x.min(axis=1), x.max(axis=1)


def _pair(run: Trajectory, first: str, second: str) -> tuple[Outline, Outline]:
    if first == second:
        raise ParameterError(f"a gap is between two cells, got {first!r} twice")
    a, b = Outline.of(run, first), Outline.of(run, second)
    if (a.mesh is None) != (b.mesh is None):
        flat, other = (a.name, b.name) if a.mesh is None else (b.name, a.name)
        raise DataError(
            f"{flat} is a contour and {other} a surface: there is no distance between the two; "
            "give both as contours seen from above, or both as surfaces"
        )
    return a, b


@checked
def edge_gap(run: Trajectory, first: str = "cell1", second: str = "cell2") -> np.ndarray:
    """Least distance of the membranes of two cells (T,), um; negative where they overlap.

    In space, of the two triangulated surfaces; of contours (see `Outline.of`) in their plane. 0
    at contact; where the cells overlap, minus how deep a point of both lies under either membrane
    (nothing in the model may forbid it). The equation is that of `cellsys.geometry.gap`.

    Raises
    ------
    DataError
        When the run has no such cells, or the triangles of a membrane cannot be told.
    """
    a, b = _pair(run, first, second)
    return np.array([gap(a.at(k), b.at(k)) for k in range(len(run))])


@checked
def contour_gap(first: np.ndarray, second: np.ndarray) -> float:
    """`edge_gap` of two closed contours (n, 2), um, their corners in order.

    Raises
    ------
    DimensionError, DataError
        Other shapes, NaN, or fewer than three corners.
    """
    return gap(contour(first), contour(second))


def gap_at(run: Trajectory, sample: int, first: str = "cell1", second: str = "cell2") -> float:
    """`edge_gap` at one sample, um."""
    a, b = _pair(run, first, second)
    return gap(a.at(sample), b.at(sample))


def touching(system: SpreadingSystem) -> Callable[[float, np.ndarray], bool]:
    """``until(t, x)`` for `simulate`: whether two cells of the state x touch."""
    states = system.states
    cells = [(f"{c.body.name}.position", c.body.membrane.mesh) for c in system.cells]

    def until(t: float, x: np.ndarray) -> bool:
        places = [states.view(x, name) for name, _ in cells]
        low = np.array([p.min(axis=0) for p in places])
        high = np.array([p.max(axis=0) for p in places])
        # Cells touch only where their boxes do, which few pairs of many cells have to be asked.
        near = np.all(low[:, None] <= high[None], axis=2)
        return any(
            gap(cells[i][1].at(places[i]), cells[j][1].at(places[j])) <= 0
            for i, j in zip(*np.nonzero(np.triu(near & near.T, 1)), strict=True)
        )

    return until


@checked
def until_contact(run: Trajectory, gap: float = 0.0) -> Trajectory:
    """The run up to the first contact of two cells, which becomes its last event.

    Contact is where the `edge_gap` of a pair falls to `gap` um, found by linear interpolation
    between samples; later samples are dropped. A run without contact is returned as it is.
    """
    if not np.isfinite(gap):
        raise ParameterError(f"gap must be finite, got {gap!r}")
    names = cell_names(run.states)
    boxes = {name: Outline.of(run, name).boxes() for name in names}
    first: tuple[float, int, str] | None = None
    for a, b in combinations(names, 2):
        (low_a, high_a), (low_b, high_b) = boxes[a], boxes[b]
        between = np.maximum(np.maximum(low_a - high_b, low_b - high_a), 0.0)
        # No gap is less than the distance of the boxes.
        maybe = np.flatnonzero(np.linalg.norm(between, axis=1) <= max(gap, 0.0))
        found = _first_below(run, (a, b), gap, maybe, None if first is None else first[1])
        if found is not None and (first is None or found[0] < first[0]):
            first = (*found, f"{a} and {b}")
    if first is None:
        return run
    time, k, who = first
    keep = max(k, 1)

    def cut(values: np.ndarray | None, rows: int = keep) -> np.ndarray | None:
        return None if values is None else values[:rows]

    return replace(
        run,
        t=run.t[:keep],
        x=run.x[:keep],
        events=(*(e for e in run.events if e.time <= time), Event(time, "contact", who)),
        p=cut(run.p),
        d=cut(run.d),
        amplitude=cut(run.amplitude),
        virial=cut(run.virial),
        stiffness=cut(run.stiffness),
        eta=cut(run.eta, keep - 1),
        u=cut(run.u, keep - 1),
    )


def _first_below(
    run: Trajectory, pair: tuple[str, str], level: float, maybe: np.ndarray, last: int | None
) -> tuple[float, int] | None:
    """Time and sample at which a pair's gap is first at most `level`, up to sample `last`."""
    if not maybe.size or (last is not None and maybe[0] > last):
        return None
    a, b = _pair(run, *pair)
    for k in (int(k) for k in maybe if last is None or k <= last):
        here = gap(a.at(k), b.at(k)) - level
        if here <= 0 and k == 0:
            return float(run.t[0]), 0
        if here <= 0:
            before = gap(a.at(k - 1), b.at(k - 1)) - level
            share = before / (before - here)
            return float(run.t[k - 1] + share * (run.t[k] - run.t[k - 1])), k
    return None
