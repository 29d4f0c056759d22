"""`read_tracks`: tracks of other programs, whichever of the known formats they are in."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from cellsys.arguments import checked
from cellsys.errors import FileFormatError, ParameterError
from cellsys.io.challenge import is_challenge, read_challenge
from cellsys.io.columns import read_columns
from cellsys.io.geff_file import is_geff, read_geff
from cellsys.io.linking import link_spots
from cellsys.io.track_tables import read_cmso, read_spot_table
from cellsys.io.trackmate import (
    is_trackmate_table,
    read_edge_table,
    read_trackmate_table,
    read_trackmate_xml,
)
from cellsys.tracks import Tracks

_PICKLED = (".pkl", ".pickle", ".p", ".joblib", ".dill")


@checked
def read_tracks(
    path: str | Path,
    *,
    edges: str | Path | None = None,
    columns: Mapping[str, str] | None = None,
    pixel_size: float | None = None,
    frame_interval: float | None = None,
    link_within: float | None = None,
) -> Tracks:
    """Tracks of cells from a file or folder of another program.

    * TrackMate: XML (all spots, or exported tracks), CSV of spots (with `edges`, its CSV of
      edges), and tables of edges that hold the places of their ends (laptrack);
    * CSV with a header: btrack, celltrackR (id, t, x, y), TrackPy and others, by the names of
      their columns or those in `columns`; a column of parents keeps divisions;
    * a folder with CMSO tables (objects.csv, links.csv; biotracks);
    * a folder of the Cell Tracking Challenge (res_track.txt or man_track.txt, and its masks);
    * a folder in the GEFF format (extra ``tracks``).

    Parameters
    ----------
    path : path
    edges : path, optional
        Table of edges that goes with a TrackMate table of spots; without it the spots of a track
        are joined in order of frames, which splits cannot be.
    columns : mapping, optional
        For a table: which column is ``track``, ``t``, ``frame``, ``x``, ``y``, ``z``,
        ``parent``.
    pixel_size, frame_interval : float, optional
        um per px and s per frame, where the file counts pixels and frames; refused where it has
        units of its own.
    link_within : float, optional
        For spots without tracks (objects of btrack): how far a cell may get from one frame to the
        next, in the units that are given back (`cellsys.io.link_spots`).

    Returns
    -------
    Tracks
        In um and s where the file or the arguments say how; px and frames otherwise.

    Raises
    ------
    FileNotFoundError
    FileFormatError, DataError
        Naming the file and the line; files with entities, pickled files, and files of more spots
        or tracks than are read, are refused before they are read whole.
    ParameterError
        An argument that the format does not take.
    """
    place = Path(path)
    if not place.exists():
        raise FileNotFoundError(f"no file or folder {str(place)!r}")
    other = None if edges is None else Path(edges)
    tracks = _read(place, other, columns)
    if pixel_size is not None or frame_interval is not None:
        tracks = tracks.scaled(pixel_size=pixel_size, frame_interval=frame_interval)
    return tracks if link_within is None else link_spots(tracks, link_within)


def _read(place: Path, edges: Path | None, columns: Mapping[str, str] | None) -> Tracks:
    kind = place.suffix.lower()
    if kind in _PICKLED:
        raise FileFormatError(
            f"{place.name} is a pickle, which can run any code when it is opened: never read; "
            "export the tracks as CSV or XML"
        )
    if is_geff(place):
        _only(place, edges, columns)
        return read_geff(place)
    if is_challenge(place):
        _only(place, edges, columns)
        return read_challenge(place)
    if place.is_dir():
        _only(place, edges, columns)
        return read_cmso(place)
    if kind == ".xml":
        _only(place, edges, columns)
        return read_trackmate_xml(place)
    if kind not in (".csv", ".tsv", ".txt"):
        raise FileFormatError(
            f"{place.name}: tracks are read from .xml, .csv, .tsv, .txt and folders, not from "
            f"{kind or 'a file without an ending'}"
        )
    if columns is not None:
        if edges is not None:
            raise ParameterError("edges go with a TrackMate table of spots; leave columns out")
        return read_spot_table(place, read_columns(place), columns)
    table = read_columns(place)
    if is_trackmate_table(table):
        return read_trackmate_table(place, edges)
    if edges is not None:
        raise ParameterError(f"edges: {place.name} is no TrackMate table of spots; leave them out")
    if table.find("SPOT_SOURCE_ID") and table.find("source_position_x"):
        return read_edge_table(place)
    return read_spot_table(place, table, {})


def _only(place: Path, edges: Path | None, columns: Mapping[str, str] | None) -> None:
    for name, given in (("edges", edges), ("columns", columns)):
        if given is not None:
            raise ParameterError(f"{name}: {place.name} is no table of spots; leave it out")
