"""A user's table of samples as CSV: what its header says is time, and numbers below it.

Cells stand between commas, semicolons or tabs (the first line decides); between semicolons or tabs
a decimal comma is read. The first line is a header when one of its cells is no number, and a
sample otherwise. Time is the column called ``t`` or ``time``, in s or in the unit that stands with
it, such as ``t [ms]``, ``time (min)`` or ``time_s``; every other column is a state.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cellsys.errors import DataError, FileFormatError, UnitError
from cellsys.kinds import shown
from cellsys.samples.measured import even, resampled
from cellsys.store.regular import open_regular
from cellsys.units import quantity, same_mu

# T is a temperature: the letter alone counts in lower case only.
_TIME = re.compile(
    r"(?:t|[Tt][Ii][Mm][Ee])(?:\s*[\[(/]\s*(?P<unit>[^\])]*?)\s*[\])]?|[\s_]+(?P<loose>.*))?"
)
_QUOTED = re.compile(r'"[^"]*"')
EQUAL = 1e-6  # of the interval: how far a step between samples may be from the others


class Table(NamedTuple):
    """States (T, n), their names and the sampling interval in s, where the file says them."""

    x: np.ndarray
    names: tuple[str, ...] | None
    step: float | None
    resampling_error: float | None = None


def read_csv(path: Path, *, resample: float | None = None, gaps: bool = False) -> Table:
    """The samples in a CSV file; see the module.

    With `gaps` an empty or not finite cell of a state is NaN; with `resample` the samples are put
    on even times so many s apart.

    Raises
    ------
    FileNotFoundError
    FileFormatError, DataError
        With the line and the column of what cannot be read, is not finite, or is not equally
        spaced.
    """
    lines = _lines(path)
    first = next(lines, None)
    if first is None:
        raise FileFormatError(f"{path.name} is empty")
    header = None if all(_number(cell) is not None for cell in first.cells) else first
    rows = list(lines) if header is not None else [first, *lines]
    names = None if header is None else _names(header, path)
    width = len(first.cells)
    values = np.empty((len(rows), width))
    times = {} if names is None else _time_columns(names, path)
    for k, row in enumerate(rows):
        if len(row.cells) != width:
            raise FileFormatError(
                f"{path.name}, line {row.line}: {len(row.cells)} cells, but {width} in line "
                f"{first.line}"
            )
        numbers = [_number(cell) for cell in row.cells]
        for column, number in enumerate(numbers):
            if number is not None and math.isfinite(number):
                continue
            if gaps and column not in times and (number is not None or not row.cells[column]):
                numbers[column] = math.nan
                continue
            _refuse(path, row, column, names)
        values[k] = numbers
    if len(rows) < 3:
        raise FileFormatError(
            f"{path.name} has {len(rows)} rows of numbers; three are the least that can be learned "
            "from"
        )
    if names is not None and len(times) > 1:
        raise FileFormatError(
            f"{path.name} has several columns of time: {', '.join(names[k] for k in times)}; "
            "leave one"
        )
    if not times or names is None:
        if resample is not None:
            raise DataError(f"{path.name} has no column of time to resample by; add 't [s]'")
        return Table(values, names, None)
    ((column, scale),) = times.items()
    if width < 2:
        raise FileFormatError(f"{path.name} has a column of time and no other; states are missing")
    where = [f"line {row.line}" for row in rows]
    t, x = values[:, column] * scale, np.delete(values, column, axis=1)
    left = (*names[:column], *names[column + 1 :])
    if resample is not None:
        if not np.isfinite(x).all():
            raise DataError(f"{path.name}: leave out rows with missing cells before resampling")
        x, error = resampled(t, x, resample, path.name)
        return Table(x, left, resample, error)
    return Table(x, left, interval(t, path.name, where))


def interval(t: np.ndarray, name: str, where: list[str] | None = None) -> float:
    """The interval of equally spaced times (T,), s; `where` names the samples.

    Raises
    ------
    DataError
        With the step that differs most from the others, and by how much.
    """
    steps = np.diff(t)
    usual = float(np.median(steps))
    if (step := even(t)) is not None:
        return step
    k = int(np.argmax(np.abs(steps - usual)))
    off = float(abs(steps[k] - usual))
    if usual > 0 and off <= EQUAL * usual:
        return float(t[-1] - t[0]) / len(steps)
    places = where or [f"sample {i}" for i in range(len(t))]
    cure = (
        "give resample= in s to put the samples on even times (the error this adds is told), or "
        "leave the times out and give dt= where they are only rounded"
    )
    if not usual > 0:
        k = int(np.argmin(steps))
        raise DataError(
            f"{name}: times must rise, but from {places[k]} to {places[k + 1]} they go from "
            f"{t[k]:.9g} s to {t[k + 1]:.9g} s; sort them, and leave one of equal ones"
        )
    raise DataError(
        f"{name}: times must be equally spaced, but from {places[k]} (t = {t[k]:.9g} s) to "
        f"{places[k + 1]} (t = {t[k + 1]:.9g} s) the step is {steps[k]:.9g} s and usually it is "
        f"{usual:.9g} s: {off:.3g} s off; {cure}"
    )


class _Line(NamedTuple):
    line: int
    cells: list[str]


def _lines(path: Path) -> Iterator[_Line]:
    """Lines that hold something, cells without blanks around them and with decimal points."""
    with open_regular(path) as file:
        raw = file.read()
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise FileFormatError(f"{path.name} is UTF-16 text; save it as UTF-8")
    try:
        text = raw.decode("utf-8-sig")  # spreadsheets write a byte order mark
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise FileFormatError(
            f"{path.name}, line {line}: byte 0x{raw[error.start]:02x} is no UTF-8 text; save the "
            "file as CSV in UTF-8"
        ) from error
    head = _QUOTED.sub("", next((line for line in text.splitlines() if line.strip()), ""))
    between = next((sign for sign in ";\t" if sign in head), ",")
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=between)
    point = comma = False
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if not any(cells):
                continue
            if between != ",":
                written = [c for c in cells if _NUMERIC.fullmatch(c)]
                point = point or any("." in c for c in written)
                comma = comma or any("," in c for c in written)
                if point and comma:
                    raise FileFormatError(
                        f"{path.name}, line {reader.line_num}: decimal points and decimal commas "
                        "in one file; write one of them throughout"
                    )
                cells = [
                    c.replace(",", ".") if "," in c and _NUMERIC.fullmatch(c) else c for c in cells
                ]
            yield _Line(reader.line_num, cells)
    except csv.Error as error:
        raise FileFormatError(f"{path.name}, line {reader.line_num}: {error}") from error


_NUMERIC = re.compile(r"[+-]?[0-9]*[.,]?[0-9]*(?:[eE][+-]?[0-9]+)?")


def _number(cell: str) -> float | None:
    """The number in a cell, NaN and inf included; None where it is none."""
    if "_" in cell:  # Python reads 1_000, spreadsheets do not write it
        return None
    try:
        return float(cell)
    except ValueError:
        return None


def _names(header: _Line, path: Path) -> tuple[str, ...]:
    cells = [header.cells[0].removeprefix("#").strip(), *header.cells[1:]]  # numpy.savetxt's mark
    names = tuple(same_mu(cell) for cell in cells)
    for column, name in enumerate(names):
        if not name:
            raise FileFormatError(
                f"{path.name}, line {header.line}: column {column + 1} has no name; name it, or "
                "leave out a column that only counts"
            )
    return names


def _refuse(path: Path, row: _Line, column: int, names: tuple[str, ...] | None) -> None:
    called = f" ({shown(names[column])})" if names is not None else ""
    place = f"{path.name}, line {row.line}, column {column + 1}{called}"
    cell = row.cells[column]
    if not cell:
        raise DataError(f"{place}: the cell is empty; fill it, or leave out that run")
    if _number(cell) is None:
        raise FileFormatError(f"{place}: {shown(cell)} is not a number")
    raise DataError(f"{place} holds NaN or inf: {shown(cell)}; repair it, or leave out that run")


def _time_columns(names: tuple[str, ...], path: Path) -> dict[int, float]:
    """Columns of time, and how many s their unit has."""
    found = {}
    for column, name in enumerate(names):
        match = _TIME.fullmatch(name)
        if match is None:
            continue
        unit = match["unit"] or match["loose"] or "s"
        try:
            found[column] = quantity(f"1 {unit}", "s", name=f"column {name!r}")
        except UnitError as error:
            if match["loose"]:
                continue  # a name of more words that begins so: "time point", "t_x"
            raise FileFormatError(
                f"{path.name}: the unit of time in {shown(name)} is not known: {error}; write for "
                "example 't [ms]'"
            ) from error
    return found
