"""Tracks and contours written in forms that this program and others read again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from cellsys.arguments import checked
from cellsys.contours import CellOutlines
from cellsys.store.atomic import write_text
from cellsys.tracks import Tracks


@checked
def write_tracks(tracks: Tracks, path: str | Path) -> Path:
    """A table of spots: cell, frame, time, place (units in the header), parent.

    A cell that a split began has the cell before as its parent, so that `cs.read_tracks` gives
    splits back; of a merge the first of the cells before it.
    """
    number = {name: k for k, name in enumerate(tracks.cells, 1)}
    owner = np.zeros(len(tracks), dtype=int)
    for name, rows in tracks.cells.items():
        owner[rows] = number[name]
    parent = np.zeros(len(tracks), dtype=int)
    mothers: dict[int, int] = {}
    for i, j in tracks.links.tolist():
        if owner[i] != owner[j]:
            mothers.setdefault(int(owner[j]), int(owner[i]))
    for cell, mother in mothers.items():
        parent[owner == cell] = mother
    L, s = tracks.length_unit, tracks.time_unit
    lines = [f"track,frame,t [{s}],x [{L}],y [{L}],z [{L}],parent"]
    for k in range(len(tracks)):
        x, y, z = tracks.place[k].tolist()
        lines.append(
            f"{owner[k]},{tracks.frame[k]},{float(tracks.t[k])!r},{x!r},{y!r},{z!r},{parent[k]}"
        )
    write_text(path, "\n".join(lines) + "\n")
    return Path(path)


@checked
def write_outlines(outlines: CellOutlines, path: str | Path) -> Path:
    """Contours as GeoJSON polygons with the properties cell, frame and t, and the units."""
    features = [
        {
            "type": "Feature",
            "properties": {
                "cell": outlines.cell[k], "frame": int(outlines.frame[k]),
                "t": float(outlines.t[k]),
            },
            "geometry": {
                "type": "Polygon",
                "coordinates": [np.vstack([corners, corners[:1]]).tolist()],
            },
        }
        for k, corners in enumerate(outlines.outline)
    ]  # fmt: skip
    told = {
        "type": "FeatureCollection", "length_unit": outlines.length_unit,
        "time_unit": outlines.time_unit, "features": features,
    }  # fmt: skip
    write_text(path, json.dumps(told) + "\n")
    return Path(path)
