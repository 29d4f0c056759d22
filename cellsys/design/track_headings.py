"""Headings of tracked cells, and the way from each to its nearest neighbour."""

from __future__ import annotations

import numpy as np

from cellsys.tracks import Tracks


def headings_of(tracks: Tracks) -> dict[str, np.ndarray]:
    """Direction of the step after each spot of every cell, NaN after the last, rad."""
    found = {}
    for name in tracks.cells:
        step = np.diff(tracks.path(name)[:, :2], axis=0)
        theta = np.full(len(step) + 1, np.nan)
        moves = np.hypot(step[:, 0], step[:, 1]) > 0
        theta[:-1][moves] = np.arctan2(step[moves, 1], step[moves, 0])
        found[name] = theta
    return found


def bearings_of(tracks: Tracks) -> np.ndarray:
    """Direction from every spot to the nearest other one of its frame, NaN for a lone one, rad."""
    bearing = np.full(len(tracks), np.nan)
    order = np.argsort(tracks.frame, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(tracks.frame[order])) + 1):
        if len(rows) < 2:
            continue
        x = tracks.place[rows, :2]
        apart = np.linalg.norm(x[:, None] - x[None], axis=2)
        np.fill_diagonal(apart, np.inf)
        way = x[apart.argmin(axis=1)] - x
        bearing[rows] = np.arctan2(way[:, 1], way[:, 0])
    return bearing
