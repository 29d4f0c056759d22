"""The layout of recorded runs, one text file per sample and kind [thesis A.1].

    Cell_1_<t>_s.sav       row 1 polarity, row 2 direction of greatest stiffness, then a row per
                           membrane node: number, x y z, v, F_L, F_E, F_tract, bonds
    Cortical_1_<t>_s.sav   a row per membrane node: number, v of the cortex, F_T
    ECM_fiber_<t>_s.sav    row 1 number of nodes, then a row per node: number unmapped, number
                           mapped, x y z, v, F_E, F_tract, F_D

SI units (m, N, m/s), blanks or tabs between columns; ``<t>`` is the time in s with six digits.
The forces belong to

    (C_c + C_cort) v = F_tract + F_E + F_L - F_T + C_cort v_cort,    C_e v = F_tract + F_E  (matrix)

What a run of cellsys holds beside that goes into ``Blocks_<t>_s.sav`` (a number a row), and
``cellsys.json`` says which block is where, so that the whole run can be read back.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cellsys.errors import DataError, FileFormatError
from cellsys.kinds import shown
from cellsys.store.regular import open_regular

SIDECAR = "cellsys.json"
KIND, SCHEMA = "recorded run", 1
C_CELL, C_CORTEX, C_MATRIX = 1e3, 1e3, 1e3  # pN s/um: 1e-3 N s/m [thesis A.1]
UM, PN = 1e6, 1e12  # of one m, N
_NAME = re.compile(r"(Cell|Cortical)_(\d+)_(\d+(?:\.\d+)?)_s\.(?:sav|txt)")
_MATRIX = re.compile(r"(ECM_fiber)_(\d+(?:\.\d+)?)_s\.(?:sav|txt)")
_MOST_BYTES = 1e9  # of one file: a sample of a million nodes


class FileForm(NamedTuple):
    """Rows of one kind of file: words of every row of the head, words of a row of a node, the
    columns that are read, and which of those hold places (a last sample has no forces)."""

    kind: str
    head: tuple[int, ...]
    width: int
    columns: tuple[int, ...]
    places: tuple[int, ...]


CELL = FileForm("cell", (3, 3), 17, (1, 2, 3, *range(7, 17)), (0, 1, 2))
CORTEX = FileForm("cortex", (), 7, tuple(range(1, 7)), ())
MATRIX = FileForm("matrix", (1,), 17, (2, 3, 4, *range(8, 14)), (0, 1, 2))
BLOCKS = FileForm("blocks", (), 1, (0,), ())
# First column of each quantity among the columns that are read; v and F_D can be told from them.
CELL_COLUMNS = {"x": 0, "F_L": 3, "F_E": 6, "F_tract": 9, "n_b": 12}
CORTEX_COLUMNS = {"v_cort": 0, "F_T": 3}
MATRIX_COLUMNS = {"x": 0, "F_E": 3, "F_tract": 6}


class Place(NamedTuple):
    """Where a block stands: kind of file, first column (or row, in Blocks), and its sign."""

    file: str  # "cell1", "cortex1", "matrix" or "blocks"
    column: int
    sign: float


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One sample as its files hold it, SI units."""

    polarity: np.ndarray  # (cells, 3)
    direction: np.ndarray  # (cells, 3)
    cells: tuple[np.ndarray, ...]  # (n, 13) each: see CELL_COLUMNS
    cortices: tuple[np.ndarray, ...]  # (n, 6) each
    matrix: np.ndarray  # (N, 9)
    blocks: np.ndarray  # (what is left,), internal units


class RecordedFiles:
    """The files of a folder by sample.

    Raises
    ------
    FileFormatError
        No such files, a sample of which a file is missing.
    """

    def __init__(self, folder: Path, sidecar: bool) -> None:
        self.folder, self.sidecar = folder, sidecar
        cells: dict[str, dict[int, str]] = {}
        cortices: dict[str, dict[int, str]] = {}
        matrix: dict[str, str] = {}
        for name in sorted(p.name for p in folder.iterdir()):
            if found := _NAME.fullmatch(name):
                table = cells if found[1] == "Cell" else cortices
                table.setdefault(found[3], {})[int(found[2])] = name
            elif found := _MATRIX.fullmatch(name):
                matrix[found[2]] = name
        if not cells or not matrix:
            raise FileFormatError(
                f"{folder.name!r} holds no recorded run: it needs files such as "
                "Cell_1_1.000000_s.sav, Cortical_1_1.000000_s.sav and ECM_fiber_1.000000_s.sav"
            )
        self.stamps = sorted(cells, key=float)
        self.numbers = tuple(sorted(cells[self.stamps[0]]))
        for stamp in self.stamps:
            there = (set(cells[stamp]), set(cortices.get(stamp, ())), stamp in matrix)
            if there != (set(self.numbers), set(self.numbers), True):
                raise FileFormatError(
                    f"{folder.name!r}: at t = {stamp} s there are cells {sorted(there[0])}, "
                    f"cortices {sorted(there[1])} and {'a' if there[2] else 'no'} matrix, but "
                    f"cells {list(self.numbers)} at t = {self.stamps[0]} s; add the files, or "
                    "leave those of that sample out"
                )
        if extra := sorted(set(matrix) - set(cells), key=float):
            raise FileFormatError(
                f"{folder.name!r}: {matrix[extra[0]]} stands without the files of its cells"
            )
        self._cells, self._cortices, self._matrix = cells, cortices, matrix
        self._sizes: dict[str, int] = {}

    @property
    def t(self) -> np.ndarray:
        """Times of the samples (T,), s."""
        return np.array([float(s) for s in self.stamps])

    def sample(self, k: int) -> Sample:
        """The numbers of sample k.

        Raises
        ------
        FileFormatError, DataError
            With the file, the row and the column.
        """
        stamp = self.stamps[k]
        cells, headings, cortices = [], [], []
        last = k == len(self.stamps) - 1  # no interval follows: its forces may be missing
        for number in self.numbers:
            name, beside = self._cells[stamp][number], self._cortices[stamp][number]
            head, table = self._table(name, CELL, last)
            headings.append(head.reshape(2, 3))
            cells.append(table)
            cortices.append(self._table(beside, CORTEX, last)[1])
            if len(cortices[-1]) != len(table):
                raise FileFormatError(
                    f"{beside} has {len(cortices[-1])} nodes and {name} {len(table)}; both list "
                    "the nodes of one membrane"
                )
        name = self._matrix[stamp]
        count, matrix = self._table(name, MATRIX, last)
        # More nodes than are listed are those of the whole network [thesis A.1: N_ECM, N_CL].
        if len(matrix) > count[0]:
            raise FileFormatError(
                f"{name}, row 1: {count[0]:g} nodes are announced, {len(matrix)} are listed"
            )
        blocks = np.zeros(0)
        if self.sidecar:
            blocks = self._table(f"Blocks_{stamp}_s.sav", BLOCKS, last)[1][:, 0]
        both = np.array(headings)
        return Sample(
            polarity=both[:, 0],
            direction=both[:, 1],
            cells=tuple(cells),
            cortices=tuple(cortices),
            matrix=matrix,
            blocks=blocks,
        )

    def _table(self, name: str, form: FileForm, last: bool) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the head, and the columns that are read, one row per node."""
        try:
            with open_regular(self.folder / name, _MOST_BYTES) as file:
                raw = file.read().removeprefix(b"\xef\xbb\xbf")
        except FileNotFoundError as error:
            raise FileFormatError(f"{self.folder.name!r} lacks the file {name}") from error
        try:
            lines = [line for line in raw.decode("ascii").splitlines() if not line.isspace()]
        except UnicodeDecodeError as error:
            raise FileFormatError(f"{name} is no text of numbers: byte {error.start}") from error
        top, body = lines[: len(form.head)], [line for line in lines[len(form.head) :] if line]
        if not body:
            raise FileFormatError(f"{name} lists no node")
        words = _words(raw)
        if words != sum(form.head) + form.width * len(body):
            raise FileFormatError(f"{name}, {_odd_row(lines, form)}")
        try:
            head = np.array([float(w) for line in top for w in line.split()])
            table = np.loadtxt(body, usecols=form.columns, ndmin=2, comments=None)
        except ValueError as error:
            raise FileFormatError(f"{name}, {_odd_word(lines)}") from error
        whole = np.array(form.places if last else range(table.shape[1]), dtype=int)
        if not np.all(np.abs(table[:, whole]) < 1e100):
            row, column = np.argwhere(~(np.abs(table[:, whole]) < 1e100))[0]
            raise DataError(
                f"{name}, row {row + 1 + len(top)}, column {form.columns[whole[column]] + 1} is "
                "not finite; repair it, or leave out the samples from there on"
            )
        if not np.all(np.abs(head) < 1e100):
            raise DataError(f"{name}: a number of its first rows is not finite; repair it")
        which = name.rpartition("_")[0].rpartition("_")[0]  # without the time
        if self._sizes.setdefault(which, len(table)) != len(table):
            raise FileFormatError(
                f"{name} lists {len(table)} nodes, the files before it {self._sizes[which]}; one "
                "run has the same nodes throughout"
            )
        return head, table


def _words(raw: bytes) -> int:
    """How many words stand in a text; counting bytes is faster than to split it."""
    blank = np.frombuffer(raw, np.uint8) <= 32
    return int(np.count_nonzero(blank[:-1] & ~blank[1:])) + int(blank.size > 0 and not blank[0])


def _odd_row(lines: list[str], form: FileForm) -> str:
    """The first row with another number of columns than its place asks for."""
    wanted = [*form.head, *([form.width] * (len(lines) - len(form.head)))]
    for row, (line, count) in enumerate(zip(lines, wanted, strict=False), 1):
        if len(line.split()) != count:
            return f"row {row}: {len(line.split())} columns, {count} belong there"
    return f"{len(lines)} rows; {len(form.head)} rows of head and one per node belong there"


def _odd_word(lines: list[str]) -> str:
    """Row, column and text of the first word that is no number."""
    for row, line in enumerate(lines, 1):
        for column, word in enumerate(line.split(), 1):
            try:
                float(word)
            except ValueError:
                return f"row {row}, column {column}: {shown(word)} is no number"
    return "what stands there is no number"
