"""From what a file says of spots and links to `Tracks`, within the sizes that are read."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cellsys.errors import DataError, FileFormatError
from cellsys.tracks import Tracks, chained

MOST_SPOTS, MOST_TRACKS = 20_000_000, 500_000


def check_counts(name: str, spots: int, tracks: int = 0) -> None:
    """Refuse a file that has, or says that it has, more than is read.

    Raises
    ------
    FileFormatError
    """
    for what, count, most in (("spots", spots, MOST_SPOTS), ("tracks", tracks, MOST_TRACKS)):
        if count > most:
            raise FileFormatError(
                f"{name} has {count} {what}; at most {most} are read: cut the movie, or filter its "
                "tracks first"
            )


def spot_tracks(
    name: str,
    form: str,
    *,
    frame: np.ndarray,
    t: np.ndarray,
    place: np.ndarray,
    track: np.ndarray,
    units: tuple[str, str],
    links: np.ndarray | None = None,
    features: Mapping[str, np.ndarray] | None = None,
    source: Mapping[str, object] | None = None,
) -> Tracks:
    """Tracks of a file; spots without links are joined to their track in order of frames.

    Raises
    ------
    DataError
        Two spots of one track in one frame where no links tell them apart.
    """
    check_counts(name, len(frame), len(np.unique(track)))
    if links is None:
        links = chained(track, frame)
        twice = frame[links[:, 0]] == frame[links[:, 1]]
        if twice.any():
            i = links[np.flatnonzero(twice)[0], 0]
            raise DataError(
                f"{name}: track {track[i]} has two spots in frame {frame[i]}; leave one of them, "
                "or give the links between spots"
            )
    return Tracks(
        frame=frame, t=t, place=place, track=track, links=links, length_unit=units[0],
        time_unit=units[1], features=dict(features or {}),
        source={"file": name, "format": form, **(source or {})},
    )  # fmt: skip


def linked(ids: np.ndarray, pairs: np.ndarray, frame: np.ndarray, name: str) -> np.ndarray:
    """Links (L, 2) between rows of spots, from pairs of their numbers, the earlier spot first.

    Raises
    ------
    FileFormatError
        A number twice, or of no spot.
    """
    order = np.argsort(ids, kind="stable")
    known = ids[order]
    if known.size and (known[1:] == known[:-1]).any():
        twice = known[1:][known[1:] == known[:-1]][0]
        raise FileFormatError(f"{name}: spot {twice} is listed twice; leave one")
    pairs = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
    if not known.size and pairs.size:
        raise FileFormatError(f"{name} has links and no spot")
    at = np.minimum(np.searchsorted(known, pairs), max(len(known) - 1, 0))
    if pairs.size and (known[at] != pairs).any():
        lost = pairs[known[at] != pairs][0]
        raise FileFormatError(f"{name}: a link names spot {lost}, which is not there")
    rows = order[at] if pairs.size else np.zeros((0, 2), dtype=np.int64)
    late = frame[rows[:, 0]] > frame[rows[:, 1]]
    rows[late] = rows[late][:, ::-1]
    return np.unique(rows, axis=0)
