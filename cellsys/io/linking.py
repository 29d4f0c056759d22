"""Spots that no program has tracked, joined from frame to frame."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from cellsys.arguments import checked
from cellsys.errors import ParameterError
from cellsys.tracks import Tracks, numbered
from cellsys.units import real_number


@checked
def link_spots(tracks: Tracks, within: float) -> Tracks:
    """Join the spots of following frames so that the sum of their squared distances is least.

    The linear assignment of Jaqaman et al. (2008) for frame to frame, with the cost `within`^2 for
    a cell that ends or begins: no splits, merges or gaps are made.

    Parameters
    ----------
    tracks : Tracks
        Without links.
    within : float
        Longest way from one frame to the next, in its `length_unit`.

    Raises
    ------
    ParameterError
        Tracks that have links already, or `within` not above 0.
    """
    if not real_number(within, "within") > 0:
        raise ParameterError(f"within must be > 0 {tracks.length_unit}, got {within!r}")
    if len(tracks.links):
        raise ParameterError("tracks are linked already; within is for spots without tracks")
    order = np.argsort(tracks.frame, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(tracks.frame[order])) + 1)
    links: list[tuple[int, int]] = []
    for before, after in itertools.pairwise(groups):
        if not before.size or tracks.frame[after[0]] != tracks.frame[before[0]] + 1:
            continue
        cost = cdist(tracks.place[before], tracks.place[after], "sqeuclidean")
        apart = np.where(cost <= within**2, cost, 2.0 * within**2 + 1.0)
        rows, columns = linear_sum_assignment(np.minimum(apart, 2.0 * within**2))
        links += [
            (int(before[i]), int(after[j]))
            for i, j in zip(rows, columns, strict=True)
            if cost[i, j] <= within**2
        ]
    pairs = np.array(links, dtype=np.int64).reshape(-1, 2)
    return replace(
        tracks,
        links=pairs,
        track=numbered(pairs, len(tracks)),
        source={**tracks.source, "linked_within": float(within)},
    )
