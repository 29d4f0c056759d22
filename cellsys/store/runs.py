"""Runs on disk: one folder of memory-mapped ``.npy`` arrays and a JSON header.

A run is written into ``NAME.partial`` row by row and renamed to ``NAME`` when it is complete,
so a folder called NAME always holds a whole run. Checkpoints inside the partial folder let an
interrupted run go on. A `Hold` keeps a second writer out; the room on the disk is reserved before
the first row. A complete run has a checksum of every array.
"""

from __future__ import annotations

import errno
import json
import mmap
import os
import shutil
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import (
    DimensionError,
    FileFormatError,
    LostRunError,
    MemoryBudgetError,
)
from cellsys.store.archive import READ_ERRORS, load_archive, save_archive
from cellsys.store.atomic import write_json
from cellsys.store.hold import OWN, Hold
from cellsys.store.memory import size_text

_SCHEMA = 1
_BLOCK = 1 << 22  # bytes of a file read at a time


def _flush(array: np.ndarray) -> None:
    """Write a mapped array to its file, and let go of its pages: they are read from there."""
    if isinstance(array, np.memmap):
        array.flush()
        if hasattr(mmap, "MADV_DONTNEED") and isinstance(array.base, mmap.mmap):
            array.base.madvise(mmap.MADV_DONTNEED)


@checked
def discard_partial(partial: str | Path) -> None:
    """Remove what an interrupted run left behind.

    Raises
    ------
    ParameterError
        When another process is still writing it.
    """
    hold = Hold(Path(partial))
    try:
        shutil.rmtree(partial)
    finally:
        hold.release()


def _checksum(path: Path) -> int:
    """CRC-32 of a file: finds damage, not malice."""
    value = 0
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            value = zlib.crc32(block, value)
    return value


def _reserve(path: Path) -> None:
    """Blocks on the disk for a whole file: a write to a mapped file that finds none kills."""
    if not hasattr(os, "posix_fallocate"):
        return
    with path.open("r+b") as file:
        try:
            os.posix_fallocate(file.fileno(), 0, os.fstat(file.fileno()).st_size)
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS):
                raise


@checked
class RunWriter:
    """Arrays of a run, filled row by row.

    Parameters
    ----------
    folder : path
        Final folder of the run.
    shapes : mapping of str to tuple
        Shape of every float64 array, samples first.
    header : mapping
        JSON metadata stored with the run; a partial run with another header is discarded.
    patience : float, optional
        Seconds to wait for another writer of this run to finish, die or be cut off.

    Raises
    ------
    MemoryBudgetError
        When the disk has no room for the run.
    ParameterError
        When another process is writing this run.
    """

    def __init__(
        self,
        folder: str | Path,
        shapes: Mapping[str, tuple[int, ...]],
        header: Mapping[str, object],
        *,
        patience: float | None = None,
    ) -> None:
        self.folder = Path(folder)
        self.partial = self.folder.with_name(self.folder.name + ".partial")
        self.header = json.loads(json.dumps(dict(header), allow_nan=False))
        self.shapes = {k: tuple(int(i) for i in v) for k, v in shapes.items()}
        if not self.partial.exists():
            self._check_room()
        self._hold = Hold(self.partial, patience)
        self.resumed = self._open_existing()
        if not self.resumed:
            self._create()

    def _describe(self) -> dict[str, object]:
        return {
            "schema": _SCHEMA,
            "header": self.header,
            "shapes": {k: list(v) for k, v in self.shapes.items()},
        }

    def _open_existing(self) -> bool:
        try:
            description = json.loads((self.partial / "header.json").read_text("utf-8"))
            if description != self._describe():
                return False
            self.arrays = {
                name: np.load(self.partial / f"{name}.npy", mmap_mode="r+", allow_pickle=False)
                for name in self.shapes
            }
        except READ_ERRORS:
            return False
        return all(self.arrays[k].shape == s for k, s in self.shapes.items())

    def _check_room(self) -> None:
        need = 8 * sum(int(np.prod(s, dtype=object)) for s in self.shapes.values())
        place = next(p for p in self.partial.parents if p.exists())
        free = shutil.disk_usage(place).free
        if need > free:
            raise MemoryBudgetError(
                f"this run needs {size_text(need)} on disk and {size_text(free)} are free; "
                "sample less often or shorten the run"
            )

    def _create(self) -> None:
        for left in self.partial.iterdir():
            if left.name not in OWN:
                left.unlink()
        self._check_room()
        try:
            self.arrays = {
                name: np.lib.format.open_memmap(
                    self.partial / f"{name}.npy", mode="w+", dtype=np.float64, shape=shape
                )
                for name, shape in self.shapes.items()
            }
            for name in self.shapes:
                _reserve(self.partial / f"{name}.npy")
            write_json(self.partial / "header.json", self._describe())
        except OSError as error:
            shutil.rmtree(self.partial)
            if error.errno != errno.ENOSPC:
                raise
            raise MemoryBudgetError(
                f"no room on the disk of {str(self.partial.parent)!r} for this run; free some, or "
                "sample less often"
            ) from error

    def check(self) -> None:
        """Refuse to go on where the folder was removed, or taken over, since the last row.

        Raises
        ------
        LostRunError
        """
        self._hold.check()

    def checkpoint(self, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, object]) -> None:
        """Make all rows written so far durable and remember how to go on from here."""
        self.check()
        for array in self.arrays.values():
            _flush(array)
        save_archive(self.partial / "checkpoint.npz", "checkpoint", 1, arrays, metadata)

    def last_checkpoint(self) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
        """What `checkpoint` stored last, or None; a broken checkpoint counts as none."""
        try:
            return load_archive(self.partial / "checkpoint.npz", "checkpoint", 1)
        except (FileNotFoundError, FileFormatError):
            return None

    def finish(self, metadata: Mapping[str, object]) -> Path:
        """Close the arrays and give the folder its final name.

        Raises
        ------
        LostRunError
            When the folder was removed, or taken over by another process.
        """
        self.check()
        for array in self.arrays.values():
            _flush(array)
        self.arrays = {}
        try:
            sums = {name: _checksum(self.partial / f"{name}.npy") for name in self.shapes}
            write_json(
                self.partial / "run.json",
                {**self._describe(), "metadata": dict(metadata), "checksums": sums},
            )
        except FileNotFoundError as error:
            self.check()
            raise LostRunError(
                f"a file of the run {self.partial.name!r} was removed while it was written "
                f"({error.filename!r}); run the scene again"
            ) from error
        self._hold.rename(self.folder)
        # Only now: until it has its name, an interrupted run goes on from its last checkpoint.
        wanted = {"header.json", "run.json", *(f"{name}.npy" for name in self.shapes)}
        for path in self.folder.iterdir():
            if path.name not in wanted:
                path.unlink(missing_ok=True)
        return self.folder

    def discard(self) -> None:
        """Remove what was written, and let go of the folder."""
        self.arrays = {}
        shutil.rmtree(self.partial, ignore_errors=True)
        self._hold.release()


@checked
class RunReader:
    """A complete run on disk; arrays are memory-mapped and read-only."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        try:
            description = json.loads((self.folder / "run.json").read_text("utf-8"))
            if description["schema"] != _SCHEMA:
                raise FileFormatError(
                    f"run {self.folder.name!r} has schema {description['schema']!r}, "
                    f"this cellsys reads {_SCHEMA}; run the scene again"
                )
            self.header: dict[str, Any] = description["header"]
            self.metadata: dict[str, Any] = description["metadata"]
            sums = description.get("checksums", {})  # runs of older versions have none
            self.checksums = {str(name): int(value) for name, value in sums.items()}
            if not isinstance(self.header, dict):
                raise FileFormatError(f"run {self.folder.name!r} has a header that is no table")
            shapes = {k: tuple(v) for k, v in description["shapes"].items()}
            if any(Path(name).name != name for name in shapes):
                raise FileFormatError(
                    f"run {self.folder.name!r} names an array outside its folder: {sorted(shapes)}"
                )
            with np.errstate(over="ignore"):  # of a forged shape; then it does not fit its file
                self.arrays = {
                    name: np.load(self.folder / f"{name}.npy", mmap_mode="r", allow_pickle=False)
                    for name in shapes
                }
        except FileFormatError:
            raise
        except (*READ_ERRORS, TypeError, AttributeError, OverflowError) as error:
            if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
                raise MemoryBudgetError(
                    f"no memory to map the run {self.folder.name!r} of "
                    f"{str(self.folder.parent)!r}; raise `ulimit -v`, or read fewer runs at a time"
                ) from error
            raise FileFormatError(
                f"{str(self.folder)!r} is not a complete cellsys run: {error}"
            ) from error
        for name, shape in shapes.items():
            if self.arrays[name].shape != shape:
                raise FileFormatError(f"array {name!r} of run {self.folder.name!r} is damaged")

    def verify(self) -> None:
        """Read every array once and compare its checksum; about 2 GB a second.

        Raises
        ------
        FileFormatError
            Naming the array that is not as it was written.
        """
        for name in self.arrays:
            if name not in self.checksums:
                continue
            try:
                found = _checksum(self.folder / f"{name}.npy")
            except OSError as error:
                raise FileFormatError(
                    f"array {name!r} of run {self.folder.name!r} cannot be read: {error}"
                ) from error
            if found != self.checksums[name]:
                raise FileFormatError(
                    f"array {name!r} of run {self.folder.name!r} is damaged: it is not what was "
                    "written"
                )


class _Mapped(NamedTuple):
    """A read-only memory map: its array, its pages, and the file behind them."""

    rows: np.memmap
    pages: mmap.mmap
    file: str


def _mapped(array: object) -> _Mapped | None:
    """The read-only memory map that an array is a view of, or None."""
    while array is not None:
        if isinstance(array, np.memmap) and isinstance(array.base, mmap.mmap):
            known = array.mode == "r" and array.filename is not None
            return _Mapped(array, array.base, str(array.filename)) if known else None
        array = getattr(array, "base", None)
    return None


@checked
def read_rows(array: np.ndarray, start: int, stop: int) -> np.ndarray:
    """Rows start..stop of a 2-D array; of a memory map they are read from the file.

    Reading leaves nothing behind in resident memory, and is faster than faulting pages in.
    `array` may be a view of some consecutive rows and columns of the map.
    """
    if not np.ndim(array):
        raise DimensionError("array must have rows, got a single number")
    found = _mapped(array)
    owner = None if found is None else found.rows
    if (
        found is None
        or owner is None
        or owner.ndim != 2
        or np.ndim(array) != 2
        or array.strides != owner.strides
    ):
        return array[start:stop]
    width, size = owner.shape[1], owner.dtype.itemsize
    skipped, column = divmod((array.ctypes.data - owner.ctypes.data) // size, width)
    rows = min(stop, len(array)) - start
    try:
        with open(found.file, "rb") as file:
            offset = owner.offset + (skipped + start) * width * size
            block = np.fromfile(file, owner.dtype, rows * width, offset=offset)
    except FileNotFoundError as error:
        raise LostRunError(
            f"the file {found.file!r} of a run was removed while the run was in use; run "
            "its scene again"
        ) from error
    return block.reshape(rows, width)[:, column : column + array.shape[1]]


@checked
def release(array: np.ndarray | None) -> None:
    """Let go of the pages of a memory-mapped array that have been read; they stay on disk.

    Resident memory then follows what is in use, not all that was ever touched. Arrays in memory
    are left alone.
    """
    owner = _mapped(array)
    if owner is not None and hasattr(mmap, "MADV_DONTNEED"):
        owner.pages.madvise(mmap.MADV_DONTNEED)
