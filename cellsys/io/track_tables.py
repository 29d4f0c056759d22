"""Tables of spots: btrack, celltrackR, TrackPy and others by the names of their columns; CMSO."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cellsys.errors import DataError, FileFormatError, ParameterError
from cellsys.io.columns import TextTable, length_unit, read_columns, time_unit
from cellsys.io.spots import linked, spot_tracks
from cellsys.tracks import Tracks, chained, numbered

# What programs call the columns; the first that a table has is taken.
NAMES: Mapping[str, tuple[str, ...]] = {
    "track": (
        "track_id", "track", "trackid", "trajectory", "particle", "label", "tid", "cell_id",
        "cell", "track id", "id",
    ),
    "t": ("t", "time", "frame", "timepoint", "slice", "date"),
    "frame": ("frame", "timepoint", "frame_number"),
    "x": ("x", "position_x", "pos_x", "x_coord", "centroid_x", "centroid-1", "xcor", "pos x"),
    "y": ("y", "position_y", "pos_y", "y_coord", "centroid_y", "centroid-0", "ycor", "pos y"),
    "z": ("z", "position_z", "pos_z", "z_coord", "centroid_z"),
    "parent": ("parent", "parent_id", "parent_track"),
}  # fmt: skip


def read_spot_table(path: Path, table: TextTable, columns: Mapping[str, str]) -> Tracks:
    """Tracks of a table with a column of tracks, of time and of places.

    Without a column of tracks every spot is one of its own, and `source` says ``tracked`` False.

    Parameters
    ----------
    path : Path
    table : TextTable
        What stands in the file.
    columns : mapping
        Names of the columns ``track``, ``t`` (or ``frame``), ``x``, ``y``, ``z``, ``parent``,
        where they are not among `NAMES`.

    Raises
    ------
    FileFormatError, DataError
        With line and column.
    """
    if unknown := sorted(set(columns) - set(NAMES)):
        raise ParameterError(f"columns names {unknown[0]!r}; known are {', '.join(NAMES)}")
    for role, name in columns.items():
        if name not in table.columns:
            raise ParameterError(
                f"columns[{role!r}] = {name!r} is no column of {path.name}; it has "
                f"{', '.join(map(repr, table.columns))}"
            )
    at = {role: columns.get(role) or table.find(*names) for role, names in NAMES.items()}
    for role in ("t", "x", "y"):
        if at[role] is None:
            table.need(role, *NAMES[role])
    if "track" not in columns and table.find("states") and at["track"] == table.find("label"):
        at["track"] = None  # objects of btrack before they are tracked: the label is a class
    if at["track"] is None:
        track = np.arange(len(table))
    else:
        track = table.labels(str(at["track"]))
    place = np.zeros((len(table), 3))
    space = {"px": 0, "um": 0}
    for k, role in enumerate("xyz"):
        column = at[role]
        if column is None:
            continue
        name, scale = length_unit(table.units.get(column, "px"), f"{path.name}, column {column!r}")
        place[:, k] = scale * table.numbers(column)
        space[name] += 1
    if all(space.values()):
        raise FileFormatError(
            f"{path.name} gives some places in um and some without a unit (px); write the same "
            "unit behind x, y and z"
        )
    t, frame, unit = _times(table, at, path, track)
    known = {str(c) for c in at.values() if c}
    features = {}
    for name in table.columns:
        if name not in known:
            try:
                features[name] = table.numbers(name, empty=np.nan)
            except (FileFormatError, DataError):
                continue  # a text, such as the name of an image
    links = None
    if at["parent"] is not None and len(table):
        links = _with_parents(track, frame, table.whole(at["parent"]), path)
    return spot_tracks(
        path.name, "table of spots", frame=frame, t=t, place=place, track=track, links=links,
        units=("um" if space["um"] else "px", unit), features=features,
        source={
            "columns": {role: str(c) for role, c in at.items() if c},
            "tracked": at["track"] is not None,
        },
    )  # fmt: skip


def _times(
    table: TextTable, at: Mapping[str, str | None], path: Path, track: np.ndarray
) -> tuple[np.ndarray, np.ndarray, str]:
    """Times, frames and unit; where the table has no frames they are counted from the times."""
    column = str(at["t"])
    unit, per = time_unit(table.units.get(column, "frame"), f"{path.name}, column {column!r}")
    t = per * table.numbers(column)
    if not len(t):
        return t, t, unit
    if at["frame"] is not None:
        return t, table.whole(str(at["frame"])), unit
    if np.all(t == np.round(t)) and unit == "frame":
        return t, t, unit
    # Frames of times: how many steps have passed, of which most are short and some bridge gaps.
    joined = chained(track, t)
    steps = t[joined[:, 1]] - t[joined[:, 0]]
    if not (steps > 0).any():
        return t, np.unique(t, return_inverse=True)[1], unit
    step = float(np.percentile(steps[steps > 0], 25.0, method="lower"))
    if unit == "frame":
        raise DataError(
            f"{path.name}, column {column!r}: times are no whole numbers of frames and have no "
            "unit; write for example 't [s]'"
        )
    return t, np.round((t - t.min()) / step), unit


def _with_parents(
    track: np.ndarray, frame: np.ndarray, parent: np.ndarray, path: Path
) -> np.ndarray:
    """Links within tracks, and from the last spot of a parent to the first of its daughters.

    A parent of 0, -1 or the track itself is none (btrack, Cell Tracking Challenge).
    """
    inside = chained(track, frame)
    order = np.lexsort((frame, track))
    starts = order[np.flatnonzero(np.diff(track[order], prepend=track[order][0] - 1))]
    ends = order[np.flatnonzero(np.diff(track[order], append=track[order][-1] + 1))]
    last = {int(track[i]): int(i) for i in ends}
    more = []
    for i in starts.tolist():
        mother = int(parent[i])
        if mother in (-1, int(track[i])) or (mother == 0 and 0 not in last):
            continue
        if mother not in last:
            raise FileFormatError(
                f"{path.name}: track {track[i]} has the parent {mother}, which is not there"
            )
        if frame[last[mother]] < frame[i]:
            more.append((last[mother], i))
        elif mother != 0:
            raise FileFormatError(
                f"{path.name}: track {track[i]} begins in frame {frame[i]:g}, before its parent "
                f"{mother} ends"
            )
    return np.concatenate([inside, np.array(more, dtype=np.int64).reshape(-1, 2)])


def read_cmso(folder: Path) -> Tracks:
    """Tracks of a folder of CMSO tables: objects and links (biotracks).

    A link lists objects in order of frames; an object of two links is a split or a merge.
    """
    objects = _cmso_file(folder, "objects.csv")
    links = _cmso_file(folder, "links.csv")
    ids = objects.labels(objects.need("object", "cmso_object_id", "object_id"))
    frame = objects.whole(objects.need("frame", "cmso_frame_id", "frame_id"))
    place = np.zeros((len(objects), 3))
    units = []
    for k, axis in enumerate("xyz"):
        column = objects.find(f"cmso_{axis}_coord", f"{axis}_coord", axis)
        if column is None and axis != "z":
            objects.need(axis, f"cmso_{axis}_coord")
        if column is not None:
            unit, scale = length_unit(objects.units.get(column, "px"), objects.name)
            units.append(unit)
            place[:, k] = scale * objects.numbers(column)
    owner = links.labels(links.need("link", "cmso_link_id", "link_id"))
    members = links.labels(links.need("object", "cmso_object_id", "object_id"))
    where = {int(i): k for k, i in enumerate(ids)}
    lost = [int(m) for m in members if int(m) not in where]
    if lost:
        raise FileFormatError(f"{links.name}: object {lost[0]} is in a link and no object")
    frames = np.array([frame[where[int(m)]] for m in members], dtype=np.int64)
    pairs = members[chained(owner, frames)]
    joined = linked(ids, pairs, frame, links.name)
    return spot_tracks(
        folder.name, "CMSO objects and links", frame=frame, t=frame, place=place,
        track=numbered(joined, len(ids)), links=joined,
        units=("um" if "um" in units else "px", "frame"),
    )  # fmt: skip


def _cmso_file(folder: Path, name: str) -> TextTable:
    found = [p for p in (folder / name, folder / f"cmso_{name}") if p.exists()]
    if not found:
        raise FileFormatError(
            f"{folder.name!r} has no {name}: CMSO tracks are objects.csv and links.csv"
        )
    return read_columns(found[0])
