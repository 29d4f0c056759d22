"""Snapshots of PhysiCell (MultiCellDS: XML with a .mat of cells) as tracks."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import scipy.io

from cellsys.arguments import checked
from cellsys.errors import FileFormatError
from cellsys.io.columns import length_unit, time_unit
from cellsys.io.spots import check_counts, spot_tracks
from cellsys.io.xml_events import read_elements
from cellsys.store.archive import READ_ERRORS
from cellsys.tracks import Tracks

_SNAPSHOT = re.compile(r"output(\d{8})\.xml")
_MOST_BYTES = 1e9


class _Snapshot:
    """What one XML says: time, its unit, the file of cells and the rows of its table."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.time, self.units = float("nan"), ("min", "micron")
        self.rows: dict[str, int] = {}
        self.file = ""
        self._tag: list[str] = []
        self._at: dict[str, str] = {}
        read_elements(path, self._start, self._end)
        if not self.file or not np.isfinite(self.time):
            raise FileFormatError(f"{path.name} is no PhysiCell snapshot: no time, or no cells")

    def _start(self, tag: str, a: object) -> None:
        attributes = dict(a) if isinstance(a, dict) else {}
        self._tag.append(tag)
        self._at = attributes
        if tag == "current_time":
            self.units = (str(attributes.get("units", "min")), self.units[1])
        elif tag == "mesh" and "units" in attributes:
            self.units = (self.units[0], str(attributes["units"]))

    def _end(self, tag: str, text: str) -> None:
        self._tag.pop()
        inside = "simplified_data" in self._tag
        try:
            if tag == "current_time":
                self.time = float(text)
            elif tag == "label" and inside:
                self.rows[text.strip()] = int(self._at["index"])
            elif tag == "filename" and inside:
                self.file = text.strip()
        except (KeyError, ValueError) as error:
            raise FileFormatError(f"{self.path.name}: element {tag}: {error}") from error


@checked
def read_physicell(folder: str | Path) -> Tracks:
    """Cells of PhysiCell that live through some snapshots, as tracks in um and s.

    Parameters
    ----------
    folder : path
        With ``output00000000.xml``, ... and the ``.mat`` files that they name.

    Raises
    ------
    FileNotFoundError
    FileFormatError
        No snapshot, an XML with entities or without what it needs, a ``.mat`` that cannot be read
        or lies outside the folder.
    """
    place = Path(folder)
    if not place.is_dir():
        raise FileNotFoundError(f"no folder {str(place)!r}")
    files = {int(m[1]): p for p in place.iterdir() if (m := _SNAPSHOT.fullmatch(p.name))}
    if not files:
        raise FileFormatError(f"{place.name!r} holds no output00000000.xml, ...")
    ids, frames, times, places, units = [], [], [], [], ("um", "s")
    for frame, number in enumerate(sorted(files)):
        told = _Snapshot(files[number])
        table = _cells(place, told)
        if not {"ID", "position"} <= set(told.rows):
            raise FileFormatError(f"{told.path.name} labels neither ID nor position")
        at = told.rows["position"]
        space, scale = length_unit(told.units[1], told.path.name)
        time, per = time_unit(told.units[0], told.path.name)
        units = (space, time)
        n = table.shape[1]
        ids.append(table[told.rows["ID"]])
        places.append(scale * table[at : at + 3].T)
        frames.append(np.full(n, frame))
        times.append(np.full(n, per * told.time))
        check_counts(place.name, sum(len(i) for i in ids))
    return spot_tracks(
        place.name, "PhysiCell", frame=np.concatenate(frames), t=np.concatenate(times),
        place=np.concatenate(places), track=np.concatenate(ids), units=units,
    )  # fmt: skip


def _cells(folder: Path, told: _Snapshot) -> np.ndarray:
    if Path(told.file).name != told.file:
        raise FileFormatError(f"{told.path.name} names {told.file!r}, outside its folder")
    path = folder / told.file
    if not path.exists():
        raise FileFormatError(f"{told.path.name} names {told.file}, which is not there")
    if path.stat().st_size > _MOST_BYTES:
        raise FileFormatError(f"{told.file} has more than {_MOST_BYTES / 1e9:g} GB")
    try:
        found = scipy.io.loadmat(path, variable_names=["cells"])
        table = np.asarray(found["cells"], dtype=float)
    except (*READ_ERRORS, TypeError, NotImplementedError) as error:
        raise FileFormatError(f"{told.file} holds no table 'cells': {error}") from error
    if table.ndim != 2 or len(table) <= max(told.rows.values(), default=0):
        raise FileFormatError(f"{told.file} has {table.shape}, fewer rows than its XML labels")
    return table
