"""Tables as text columns by name: comma, semicolon or tab between cells; units from the header."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellsys.errors import DataError, FileFormatError
from cellsys.kinds import shown
from cellsys.store.regular import open_regular

MOST_BYTES = 1e9
_UNIT = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]+?)\s*[\])]$")
_LENGTH = {
    "px": ("px", 1.0), "pixel": ("px", 1.0), "pixels": ("px", 1.0), "um": ("um", 1.0),
    "µm": ("um", 1.0), "μm": ("um", 1.0), "micron": ("um", 1.0), "microns": ("um", 1.0),
    "micrometer": ("um", 1.0), "micrometers": ("um", 1.0), "micrometre": ("um", 1.0),
    "nm": ("um", 1e-3), "mm": ("um", 1e3), "m": ("um", 1e6),
}  # fmt: skip
_TIME = {
    "s": ("s", 1.0), "sec": ("s", 1.0), "second": ("s", 1.0), "seconds": ("s", 1.0),
    "min": ("s", 60.0), "minute": ("s", 60.0), "minutes": ("s", 60.0), "h": ("s", 3600.0),
    "hour": ("s", 3600.0), "hours": ("s", 3600.0), "ms": ("s", 1e-3), "frame": ("frame", 1.0),
    "frames": ("frame", 1.0),
}  # fmt: skip


def length_unit(text: str, where: str) -> tuple[str, float]:
    """("um" or "px", factor) of a unit of length as programs write it.

    Raises
    ------
    FileFormatError
    """
    return _unit(text, _LENGTH, where, "length")


def time_unit(text: str, where: str) -> tuple[str, float]:
    """("s" or "frame", factor) of a unit of time as programs write it."""
    return _unit(text, _TIME, where, "time")


def _unit(
    text: str, known: Mapping[str, tuple[str, float]], where: str, what: str
) -> tuple[str, float]:
    found = known.get(text.strip().strip("()[]").lower())
    if found is None:
        raise FileFormatError(
            f"{where}: {shown(text)} is no unit of {what} that is read here; write one of "
            f"{', '.join(known)}"
        )
    return found


@dataclass(frozen=True)
class TextTable:
    """Cells of a table by column; `lines` are the lines of the file that the rows stand in."""

    name: str
    columns: Mapping[str, Sequence[str]]
    units: Mapping[str, str]
    lines: Sequence[int]

    def __len__(self) -> int:
        return len(self.lines)

    def find(self, *names: str) -> str | None:
        """The first of these columns that there is, whatever its case."""
        known = {c.lower(): c for c in self.columns}
        return next((known[n.lower()] for n in names if n.lower() in known), None)

    def need(self, what: str, *names: str) -> str:
        """`find`, or an error that lists the columns."""
        found = self.find(*names)
        if found is None:
            raise FileFormatError(
                f"{self.name} has no column of {what} ({', '.join(names)}) among "
                f"{', '.join(map(repr, list(self.columns)[:20]))}; name it: columns={{{what!r}: "
                "'...'}"
            )
        return found

    def numbers(self, column: str, *, empty: float | None = None) -> np.ndarray:
        """A column as floats; an empty cell is `empty`, or an error.

        Raises
        ------
        FileFormatError, DataError
            With line and column.
        """
        cells = self.columns[column]
        try:
            values = np.array(cells, dtype=float)
        except ValueError:
            values = np.array([self._number(column, k, c, empty) for k, c in enumerate(cells)])
        bad = ~np.isfinite(values)
        if empty is None and bad.any():
            k = int(np.flatnonzero(bad)[0])
            raise DataError(
                f"{self.name}, line {self.lines[k]}, column {column!r}: {shown(cells[k])} is not "
                "finite; repair it, or leave that row out"
            )
        return values

    def whole(self, column: str) -> np.ndarray:
        """A column as whole numbers."""
        values = self.numbers(column)
        bad = values != np.round(values)
        if bad.any():
            k = int(np.flatnonzero(bad)[0])
            raise DataError(
                f"{self.name}, line {self.lines[k]}, column {column!r}: "
                f"{shown(self.columns[column][k])} is no whole number"
            )
        return values.astype(np.int64)

    def labels(self, column: str) -> np.ndarray:
        """A column as numbers of tracks: whole numbers as they are, texts counted from 0."""
        cells = self.columns[column]
        try:
            return np.array(cells, dtype=np.int64)
        except ValueError:
            try:
                return self.whole(column)
            except FileFormatError:
                first: dict[str, int] = {}
                return np.array([first.setdefault(c, len(first)) for c in cells], dtype=np.int64)

    def _number(self, column: str, k: int, cell: str, empty: float | None) -> float:
        if not cell and empty is not None:
            return empty
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
            if cell:
                raise FileFormatError(
                    f"{self.name}, line {self.lines[k]}, column {column!r}: {shown(cell)} is no "
                    "number"
                ) from None
        return value


def read_columns(path: Path, *, skip: int = 0, between: str | None = None) -> TextTable:
    """A table with a header of names; `skip` rows after the header are left out.

    Raises
    ------
    FileNotFoundError
    FileFormatError
        No text, no header, rows of another length, with the line; more than 1 GB.
    """
    with open_regular(path, MOST_BYTES) as file:
        raw = file.read()
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise FileFormatError(f"{path.name} is UTF-16 text; save it as UTF-8")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise FileFormatError(
            f"{path.name}, line {line}: byte 0x{raw[error.start]:02x} is no UTF-8 text"
        ) from error
    first = next((line for line in text.splitlines() if line.strip()), "")
    if between is None:
        between = next((sign for sign in ";\t" if sign in first), "," if "," in first else " ")
    reader = csv.reader(
        io.StringIO(text, newline=""), delimiter=between, skipinitialspace=between == " "
    )
    rows, lines = [], []
    try:
        for row in reader:
            if row and any(cell and not cell.isspace() for cell in row):
                rows.append(row)
                lines.append(reader.line_num)
    except csv.Error as error:
        raise FileFormatError(f"{path.name}, line {reader.line_num}: {error}") from error
    if not rows:
        raise FileFormatError(f"{path.name} is empty")
    names, units = _header([cell.strip() for cell in rows[0]], path)
    body = rows[1 + skip :]
    for row, line in zip(body, lines[1 + skip :], strict=True):
        if len(row) != len(names):
            raise FileFormatError(
                f"{path.name}, line {line}: {len(row)} cells under {len(names)} names"
            )
    cells = [[c.strip() for c in column] for column in zip(*body, strict=True)]
    if not body:
        cells = [[] for _ in names]
    return TextTable(path.name, dict(zip(names, cells, strict=True)), units, lines[1 + skip :])


def _header(cells: list[str], path: Path) -> tuple[list[str], dict[str, str]]:
    names, units = [], {}
    for k, cell in enumerate(cells):
        match = _UNIT.match(cell)
        name = match[1] if match else cell
        name = name or f"column {k + 1}"
        if name in names:
            raise FileFormatError(f"{path.name}: two columns are called {name!r}; rename one")
        names.append(name)
        if match:
            units[name] = match[2]
    return names, units


def text_rows(path: Path, count: int) -> list[list[str]]:
    """The first rows of a table as they stand, to tell which program wrote it."""
    with open_regular(path, MOST_BYTES) as file:
        raw = file.read(65536)
    text = raw.decode("utf-8-sig", errors="replace")
    return [line.split(",") for line in text.splitlines() if line.strip()][:count]
