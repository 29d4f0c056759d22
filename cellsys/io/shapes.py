"""Contours from polygons that programs of geometry write: GeoJSON, and WKT in a table."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from cellsys.contours import CellOutlines
from cellsys.errors import FileFormatError
from cellsys.io.columns import length_unit, read_columns, time_unit
from cellsys.io.extras import extra
from cellsys.store.regular import open_regular

_MOST = 1e9  # bytes


def read_shapes(path: Path) -> CellOutlines:
    """Outer contours of polygons, px and frames; of several parts the largest.

    Raises
    ------
    ParameterError
        Without the package shapely.
    FileFormatError
        Naming the feature or the line: no polygon, sides that cross, no cell or frame.
    """
    if not path.exists():
        raise FileNotFoundError(f"no file {str(path)!r}")
    units = ("px", "frame")
    if path.suffix.lower() in (".csv", ".wkt"):
        rows = _table(path)
    else:
        rows, units = _features(path)
    cells, frames, corners = [], [], []
    for where, cell, frame, shape, _ in rows:
        cells.append(cell)
        frames.append(frame)
        corners.append(_outer(shape, f"{path.name}, {where}"))
    at = np.array(frames, dtype=float)
    return CellOutlines(
        cell=tuple(cells), frame=at, t=np.array([row[4] for row in rows]),
        outline=tuple(corners), length_unit=units[0], time_unit=units[1],
        source={"file": path.name},
    )  # fmt: skip


_Row = tuple[str, str, int, object, float]


def _features(path: Path) -> tuple[list[_Row], tuple[str, str]]:
    shapely = extra("shapely.geometry", "images", f"{path.name} (GeoJSON)")
    try:
        with open_regular(path, _MOST) as file:
            told = json.loads(file.read())
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path.name} is no JSON: {error}") from error
    features = told.get("features") if isinstance(told, dict) else None
    if not isinstance(features, list):
        raise FileFormatError(f"{path.name} is no GeoJSON FeatureCollection")
    rows = []
    for k, feature in enumerate(features):
        try:
            known = feature.get("properties") or {}
            cell = known["cell"] if "cell" in known else feature.get("id", k)
            shape = shapely.shape(feature["geometry"])
            frame = int(known.get("frame", 0))
            time = float(known.get("t", frame))
            rows.append((f"feature {k}", str(cell), frame, shape, time))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise FileFormatError(
                f"{path.name}, feature {k}: no polygon of a cell and frame: {error!r}"
            ) from error
    space, scale = length_unit(str(told.get("length_unit", "px")), path.name)
    time_name, per = time_unit(str(told.get("time_unit", "frame")), path.name)
    if (scale, per) != (1.0, 1.0):
        raise FileFormatError(f"{path.name}: units are um or px, and s or frame")
    return rows, (space, time_name)


def _table(path: Path) -> list[_Row]:
    shapely = extra("shapely", "images", f"{path.name} (WKT)")
    table = read_columns(path)
    shapes = table.columns[table.need("polygon", "wkt", "geometry", "polygon")]
    cells = table.columns[table.need("cell", "cell", "cell_id", "label", "id")]
    frames = table.whole(table.need("frame", "frame", "t"))
    rows = []
    for k, (text, cell) in enumerate(zip(shapes, cells, strict=True)):
        try:
            shape = shapely.from_wkt(text)
        except (shapely.errors.ShapelyError, ValueError, TypeError) as error:
            raise FileFormatError(f"{path.name}, line {table.lines[k]}: no WKT: {error}") from error
        at = int(frames[k])
        rows.append((f"line {table.lines[k]}", cell, at, shape, float(at)))
    return rows


def _outer(shape: object, where: str) -> np.ndarray:
    shapely = extra("shapely.geometry", "images", where)
    if isinstance(shape, shapely.MultiPolygon) and len(shape.geoms):
        shape = max(shape.geoms, key=lambda part: part.area)
    if not isinstance(shape, shapely.Polygon) or shape.is_empty:
        raise FileFormatError(f"{where}: a polygon belongs there")
    if not shape.is_valid:
        raise FileFormatError(f"{where}: the sides of the polygon cross; repair it (make_valid)")
    return np.asarray(shape.exterior.coords, dtype=float)[:-1, :2]
