"""`Tracks`: places of cells over time with who follows whom, from other programs or from masks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, ParameterError, UnknownNameError
from cellsys.shown import Shown
from cellsys.units import real_number, shaped_array

LENGTHS, TIMES = ("um", "px"), ("s", "frame")


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Tracks(Shown):
    """Spots of cells and the links between them.

    Parameters
    ----------
    frame : int array (S,)
        Frame of every spot, counted from any number.
    t : array (S,)
        Time of every spot, in `time_unit`.
    place : array (S, 3)
        x, y, z in `length_unit`; z is 0 in the plane.
    track : int array (S,)
        Number of the track of every spot, as its program gave it.
    links : int array (L, 2)
        Rows (earlier spot, later spot). A spot with two later ones splits, one with two earlier
        ones is a merge, and a link over more than one frame bridges a gap.
    length_unit, time_unit : str
        "um" or "px", "s" or "frame": nothing is converted before the scale is known (`scaled`).
    features : mapping of str to array (S,)
        What the file says of every spot besides, under its own names.
    source : mapping
        File, format, program, what was left out.

    Raises
    ------
    DimensionError, DataError
        Shapes that do not fit, NaN, a link that goes back in time, a spot that is not there.
    """

    frame: np.ndarray
    t: np.ndarray
    place: np.ndarray
    track: np.ndarray
    links: np.ndarray
    length_unit: str = "um"
    time_unit: str = "s"
    features: Mapping[str, np.ndarray] = field(default_factory=dict)
    source: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        place = shaped_array(self.place, "place", (None, 3))
        n = len(place)
        object.__setattr__(self, "place", place)
        object.__setattr__(self, "t", shaped_array(self.t, "t", (n,)))
        for name in ("frame", "track"):
            whole = shaped_array(getattr(self, name), name, (n,))
            if not np.all(whole == np.round(whole)):
                raise DataError(f"{name} must hold whole numbers")
            object.__setattr__(self, name, whole.astype(np.int64))
        links = np.asarray(self.links).reshape(-1, 2) if np.size(self.links) else np.zeros((0, 2))
        links = links.astype(np.int64)
        object.__setattr__(self, "links", links)
        if self.length_unit not in LENGTHS or self.time_unit not in TIMES:
            raise ParameterError(
                f"units must be one of {LENGTHS} and one of {TIMES}, got {self.length_unit!r} and "
                f"{self.time_unit!r}"
            )
        if links.size and not (links.min() >= 0 and links.max() < n):
            raise DataError(f"links name spots {links.min()} to {links.max()}, but there are {n}")
        back = self.frame[links[:, 0]] >= self.frame[links[:, 1]]
        if back.any():
            i, j = links[np.flatnonzero(back)[0]]
            raise DataError(
                f"the link from spot {i} (frame {self.frame[i]}) to spot {j} (frame "
                f"{self.frame[j]}) does not go forward in time"
            )
        for name, values in self.features.items():
            if np.shape(values) != (n,):
                raise DimensionError(f"features[{name!r}] must have {n} values, one per spot")

    def __len__(self) -> int:
        return len(self.place)

    def __str__(self) -> str:
        if not len(self):
            return "Tracks: no spot"
        return (
            f"Tracks: {len(self)} spots of {len(np.unique(self.track))} tracks ({len(self.cells)} "
            f"cells between splits and merges), frames {self.frame.min()} to {self.frame.max()}, "
            f"{self.length_unit} and {self.time_unit}\n{len(self.splits)} splits, "
            f"{len(self.merges)} merges, {len(self.gaps)} gaps"
        )

    @cached_property
    def splits(self) -> np.ndarray:
        """Spots that have more than one later spot."""
        return np.flatnonzero(np.bincount(self.links[:, 0], minlength=len(self)) > 1)

    @cached_property
    def merges(self) -> np.ndarray:
        """Spots that have more than one earlier spot."""
        return np.flatnonzero(np.bincount(self.links[:, 1], minlength=len(self)) > 1)

    @cached_property
    def gaps(self) -> np.ndarray:
        """Links (rows of `links`) that bridge one or more frames without a spot."""
        apart = self.frame[self.links[:, 1]] - self.frame[self.links[:, 0]]
        return np.flatnonzero(apart > 1)

    @cached_property
    def cells(self) -> Mapping[str, np.ndarray]:
        """Spots of every cell in order of time: a cell lives from a split or merge to the next.

        Named by its track; where a track has several cells, ``3``, ``3.1``, ``3.2`` in the order
        in which they begin.
        """
        n = len(self)
        if not n:
            return {}
        later = np.bincount(self.links[:, 0], minlength=n)
        earlier = np.bincount(self.links[:, 1], minlength=n)
        alone = (later[self.links[:, 0]] == 1) & (earlier[self.links[:, 1]] == 1)
        i, j = self.links[alone].T
        chain = connected_components(
            sp.coo_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False
        )[1]
        order = np.lexsort((self.frame, chain))
        groups = np.split(order, np.flatnonzero(np.diff(chain[order])) + 1)
        groups.sort(key=lambda g: (int(self.track[g[0]]), int(self.frame[g[0]]), int(g[0])))
        seen: Counter[int] = Counter()
        named = {}
        for group in groups:
            track = int(self.track[group[0]])
            named[f"{track}.{seen[track]}" if seen[track] else str(track)] = group
            seen[track] += 1
        return named

    def path(self, cell: str) -> np.ndarray:
        """Places (n, 3) of a cell in order of time."""
        return self.place[self._spots(cell)]

    def times(self, cell: str) -> np.ndarray:
        """Times (n,) of a cell."""
        return self.t[self._spots(cell)]

    def _spots(self, cell: str) -> np.ndarray:
        if cell not in self.cells:
            near = ", ".join(list(self.cells)[:8])
            raise UnknownNameError(f"no cell {cell!r} among the tracks; there are {near}, ...")
        return self.cells[cell]

    def scaled(
        self, *, pixel_size: float | None = None, frame_interval: float | None = None
    ) -> Tracks:
        """The same tracks in um and s.

        Parameters
        ----------
        pixel_size : float, optional
            um per px; needed where lengths are in px, refused where they are in um already.
        frame_interval : float, optional
            s per frame; needed where times are frames, refused where they are in s already.
        """
        place, t = self.place, self.t
        for name, value, unit, known in (
            ("pixel_size", pixel_size, self.length_unit, "um"),
            ("frame_interval", frame_interval, self.time_unit, "s"),
        ):
            if value is None:
                continue
            if unit == known:
                raise ParameterError(
                    f"{name} = {value!r}: these tracks are in {known} already; leave it out"
                )
            if not real_number(value, name) > 0:
                raise ParameterError(f"{name} must be > 0 {known}, got {value!r}")
        if pixel_size is not None:
            place = place * pixel_size
        if frame_interval is not None:
            t = t * frame_interval
        return replace(
            self,
            place=place,
            t=t,
            length_unit=self.length_unit if pixel_size is None else "um",
            time_unit=self.time_unit if frame_interval is None else "s",
        )


def chained(track: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Links (L, 2) between the spots of each track in order of frames, where none split."""
    order = np.lexsort((frame, track))
    same = track[order][1:] == track[order][:-1]
    return np.column_stack([order[:-1][same], order[1:][same]])


def numbered(links: Sequence[tuple[int, int]] | np.ndarray, n: int) -> np.ndarray:
    """Track of each of n spots, counted from 0 in the order of their first spot."""
    pairs = np.asarray(links, dtype=np.int64).reshape(-1, 2)
    graph = sp.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    labels = connected_components(graph, directed=False)[1]
    first: dict[int, int] = {}
    for label in labels.tolist():
        first.setdefault(label, len(first))
    return np.array([first[label] for label in labels.tolist()], dtype=np.int64)
