"""Tracks in the GEFF format (graph exchange file format, a Zarr folder), by its own package."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellsys.errors import FileFormatError
from cellsys.io.columns import length_unit, time_unit
from cellsys.io.extras import extra
from cellsys.io.spots import linked, spot_tracks
from cellsys.tracks import Tracks, numbered


def is_geff(path: Path) -> bool:
    """Whether a path is a Zarr group with nodes and edges."""
    return path.is_dir() and (path / "nodes").is_dir() and (path / "edges").is_dir()


def read_geff(path: Path) -> Tracks:
    """Tracks of a GEFF folder: nodes are spots, edges links, axes tell time and space.

    Raises
    ------
    ParameterError
        Without the package geff (extra ``tracks``).
    FileFormatError
        No axes of time and space, or a folder that geff refuses.
    """
    geff = extra("geff.core_io", "tracks", f"{path.name} (GEFF)")
    try:
        found = geff.read_to_memory(path)
    except (ValueError, KeyError, TypeError, OSError, AttributeError) as error:
        raise FileFormatError(f"{path.name} is no GEFF folder that can be read: {error}") from error
    axes = list(found["metadata"].axes or [])
    times = [a for a in axes if a.type == "time"]
    spaces = {a.name: a for a in axes if a.type == "space"}
    if len(times) != 1 or not {"x", "y"} <= set(spaces):
        raise FileFormatError(
            f"{path.name} names the axes {[a.name for a in axes]}; one of time and x, y of space "
            "are needed"
        )
    values = {name: np.asarray(p["values"]) for name, p in found["node_props"].items()}
    ids = np.asarray(found["node_ids"]).astype(np.int64)
    frame = np.asarray(values[times[0].name], dtype=float)
    if not np.all(frame == np.round(frame)):
        raise FileFormatError(f"{path.name}: axis {times[0].name!r} holds no whole frames")
    place, units = np.zeros((len(ids), 3)), []
    for k, name in enumerate("xyz"):
        if name in spaces:
            unit, scale = length_unit(spaces[name].unit or "px", path.name)
            units.append(unit)
            place[:, k] = scale * np.asarray(values[name], dtype=float)
    edges = np.asarray(found["edge_ids"]).astype(np.int64).reshape(-1, 2)
    joined = linked(ids, edges, frame, path.name)
    time, per = time_unit(times[0].unit or "frame", path.name)
    return spot_tracks(
        path.name, "GEFF", frame=frame, t=per * frame, place=place,
        track=numbered(joined, len(ids)), links=joined,
        units=("um" if "um" in units else "px", time),
    )  # fmt: skip
