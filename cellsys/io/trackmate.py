"""Tracks of TrackMate (Fiji): its XML with spots and edges, its tables of spots, track exports."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cellsys.errors import DataError, FileFormatError
from cellsys.io.columns import TextTable, length_unit, read_columns, time_unit
from cellsys.io.spots import check_counts, linked, spot_tracks
from cellsys.io.xml_events import read_elements
from cellsys.kinds import shown
from cellsys.tracks import Tracks, numbered

_PLACES = ("POSITION_X", "POSITION_Y", "POSITION_Z")
_KEPT = ("QUALITY", "RADIUS", "AREA", "PERIMETER", "ELLIPSE_ASPECTRATIO", "ELLIPSE_THETA")


class _Collected:
    """What the elements of a TrackMate file add up to."""

    def __init__(self, name: str) -> None:
        self.name, self.root = name, ""
        self.units = ("pixel", "frame")
        self.interval: float | None = None
        self.spots: list[tuple[int, int, float, float, float, float]] = []
        self.features: dict[str, list[float]] = {}
        self.edges: list[tuple[int, int, int]] = []
        self.track, self.kept = -1, set[int]()
        self.filtered = self.inside = False
        self.image: dict[str, str] = {}

    def start(self, tag: str, a: Mapping[str, str]) -> None:
        """One element; see `read_elements`."""
        self.root = self.root or tag
        try:
            self._start(tag, a)
        except (KeyError, ValueError, OverflowError) as error:
            what = f"lacks {error}" if isinstance(error, KeyError) else f"holds {error}"
            which = a.get("ID") or a.get("SPOT_SOURCE_ID") or a.get("TRACK_ID") or ""
            raise FileFormatError(f"{self.name}: element {tag} {which} {what}") from error

    def _start(self, tag: str, a: Mapping[str, str]) -> None:
        if tag == "Model":
            self.units = (a.get("spatialunits", "pixel"), a.get("timeunits", "frame"))
        elif tag == "AllSpots":
            check_counts(self.name, int(a.get("nspots", "0")))
        elif tag == "Spot":
            frame, x, y = float(a["FRAME"]), float(a["POSITION_X"]), float(a["POSITION_Y"])
            t, z = float(a.get("POSITION_T", frame)), float(a.get("POSITION_Z", 0.0))
            self.spots.append((int(a["ID"]), int(frame), t, x, y, z))
            for key in _KEPT:
                self.features.setdefault(key, []).append(float(a.get(key, "nan")))
        elif tag == "Track":
            self.track = int(a["TRACK_ID"])
        elif tag == "Edge":
            ends = (int(a["SPOT_SOURCE_ID"]), int(a["SPOT_TARGET_ID"]))
            self.edges.append((*ends, self.track))
        elif tag == "FilteredTracks":
            self.filtered = True
        elif tag == "TrackID":
            self.kept.add(int(a["TRACK_ID"]))
        elif tag == "ImageData":
            self.image = dict(a)
        elif tag == "Tracks":  # the short form: "export tracks to XML file"
            self.units = (a.get("spaceUnits", "pixel"), a.get("timeUnits", "frame"))
            self.interval = float(a.get("frameInterval", "1"))
            check_counts(self.name, 0, int(a.get("nTracks", "0")))
        elif tag == "particle":
            self.track, self.inside = self.track + 1, False
        elif tag == "detection":
            k = len(self.spots)
            t, x, y, z = float(a["t"]), float(a["x"]), float(a["y"]), float(a.get("z", 0.0))
            self.spots.append((k, round(t), t, x, y, z))
            if self.inside:
                self.edges.append((k - 1, k, self.track))
            else:
                self.kept.add(self.track)
                self.edges.append((k, k, self.track))
            self.inside = True
        if len(self.spots) % 65536 == 0:
            check_counts(self.name, len(self.spots))


def read_trackmate_xml(path: Path) -> Tracks:
    """Tracks of a TrackMate XML: those that passed its filters, splits, merges and gaps kept.

    Spots of no track are left out and counted in `source`.

    Raises
    ------
    FileFormatError
        Another XML; a spot or edge without what it needs; entities.
    """
    found = _Collected(path.name)
    read_elements(path, found.start)
    if found.root not in ("TrackMate", "Tracks"):
        raise FileFormatError(
            f"{path.name} is XML of {shown(found.root)}, not of TrackMate (TrackMate or Tracks)"
        )
    edges = np.array(found.edges, dtype=np.int64).reshape(-1, 3)
    if found.filtered:
        edges = edges[np.isin(edges[:, 2], list(found.kept))]
    check_counts(path.name, len(found.spots), len(np.unique(edges[:, 2])))
    spots = np.array(found.spots, dtype=float).reshape(-1, 6)
    if not np.isfinite(spots).all():
        k = int(np.argwhere(~np.isfinite(spots))[0, 0])
        raise DataError(f"{path.name}: spot {found.spots[k][0]} has a place or time not finite")
    ids = spots[:, 0].astype(np.int64)
    links = linked(ids, edges[edges[:, 0] != edges[:, 1]][:, :2], spots[:, 1], path.name)
    owner = dict(zip(edges[:, 0].tolist(), edges[:, 2].tolist(), strict=True))
    owner |= dict(zip(edges[:, 1].tolist(), edges[:, 2].tolist(), strict=True))
    track = np.array([owner.get(i, -1) for i in ids.tolist()], dtype=np.int64)
    keep = track >= 0
    new = np.cumsum(keep) - 1
    space, scale = length_unit(found.units[0], path.name)
    time, per = time_unit(found.units[1], path.name)
    times = spots[:, 2] * per
    if found.interval is not None:  # the short form counts frames
        times = spots[:, 1] * found.interval * per
    features = {k: np.array(v)[keep] for k, v in found.features.items() if np.isfinite(v).any()}
    return spot_tracks(
        path.name, "TrackMate XML",
        frame=spots[keep, 1], t=times[keep], place=spots[keep, 3:] * scale, track=track[keep],
        links=new[links], units=(space, time), features=features,
        source={"untracked_spots": int((~keep).sum()), "image": found.image},
    )  # fmt: skip


def is_trackmate_table(table: TextTable) -> bool:
    """Whether a table has the columns of TrackMate's spots."""
    return all(table.find(name) for name in ("POSITION_X", "POSITION_Y", "FRAME", "TRACK_ID"))


def read_trackmate_table(path: Path, edges: Path | None) -> Tracks:
    """Tracks of a TrackMate table of spots (CSV), with its table of edges where there is one.

    Rows of names and units under the header are known by the cell that is no number.
    """
    table = read_columns(path)
    skip, units = 0, dict(table.units)
    frames = table.columns[table.need("frame", "FRAME")]
    while skip < min(3, len(frames)) and not _is_number(frames[skip]):
        skip += 1
    if skip:
        last = {name: cells[skip - 1] for name, cells in table.columns.items()}
        units |= {name: cell.strip("()") for name, cell in last.items() if cell.startswith("(")}
        table = read_columns(path, skip=skip)
    tracks = table.columns[table.need("track", "TRACK_ID")]
    keep = np.array([bool(cell) and cell != "None" for cell in tracks], dtype=bool)
    rows = np.flatnonzero(keep)
    place = np.zeros((len(rows), 3))
    for k, name in enumerate(_PLACES):
        if (column := table.find(name)) is not None:
            place[:, k] = table.numbers(column)[rows]
    frame = table.whole(table.need("frame", "FRAME"))[rows]
    track = np.array([int(float(tracks[i])) for i in rows.tolist()], dtype=np.int64)
    column = table.find("POSITION_T")
    space, scale = length_unit(units.get(table.need("x", "POSITION_X"), "px"), path.name)
    time, per = ("frame", 1.0)
    t = frame.astype(float)
    if column is not None and column in units:
        time, per = time_unit(units[column], path.name)
        t = table.numbers(column)[rows] * per
    ids = table.whole(table.need("spot", "ID"))[rows]
    links = None
    if edges is not None:
        ends = edge_pairs(read_edges(edges))
        links = linked(ids, ends[np.isin(ends, ids).all(axis=1)], frame, edges.name)
    return spot_tracks(
        path.name, "TrackMate spots", frame=frame, t=t, place=place * scale, track=track,
        links=links, units=(space, time),
        source={"untracked_spots": int((~keep).sum())},
    )  # fmt: skip


def read_edges(path: Path) -> TextTable:
    """A table of edges without the rows of names and units that TrackMate writes."""
    table = read_columns(path)
    cells = table.columns[table.need("edge", "SPOT_SOURCE_ID")]
    skip = 0
    while skip < min(3, len(cells)) and not _is_number(cells[skip]):
        skip += 1
    return read_columns(path, skip=skip) if skip else table


def edge_pairs(table: TextTable) -> np.ndarray:
    """Pairs (L, 2) of spots of a table of edges."""
    return np.column_stack(
        [table.whole(table.need("edge", f"SPOT_{end}_ID")) for end in ("SOURCE", "TARGET")]
    )


def read_edge_table(path: Path) -> Tracks:
    """Tracks of a table of edges that holds frame and place of both ends (laptrack)."""
    table = read_edges(path)
    pairs = edge_pairs(table)
    ends = []
    for end in ("source", "target"):
        columns = [table.need(n, f"{end}_{n}") for n in ("frame", "position_x", "position_y")]
        ends.append(np.column_stack([table.numbers(c) for c in columns]))
    ids, first = np.unique(pairs.T.ravel(), return_index=True)
    rows = np.concatenate(ends)[first]
    owner = table.find("TRACK_ID")
    tracks = table.whole(owner) if owner else np.zeros(len(pairs), dtype=np.int64)
    links = linked(ids, pairs, rows[:, 0], path.name)
    if owner is None:
        track = numbered(links, len(ids))
    else:
        track = np.concatenate([tracks, tracks])[first]
    return spot_tracks(
        path.name, "table of edges", frame=rows[:, 0], t=rows[:, 0],
        place=np.column_stack([rows[:, 1:], np.zeros(len(rows))]), track=track, links=links,
        units=("px", "frame"),
    )  # fmt: skip


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
