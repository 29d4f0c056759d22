"""Runs on disk: one folder of memory-mapped ``.npy`` arrays and a JSON header.

A run is written into ``NAME.partial`` row by row and renamed to ``NAME`` when it is complete,
so a folder called NAME always holds a whole run. Checkpoints inside the partial folder let an
interrupted run go on. A lock inside it, which the system drops when its process dies, keeps a
second process out; the room on the disk is reserved before the first row.
"""

from __future__ import annotations

import errno
import json
import mmap
import os
import shutil
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cellsys.errors import BudgetError, FileFormatError, ParameterError
from cellsys.store.archive import READ_ERRORS, load_archive, save_archive
from cellsys.store.atomic import write_json

try:
    import fcntl
except ImportError:  # a system without POSIX locks: two writers are not told apart
    fcntl = None  # type: ignore[assignment]

_SCHEMA = 1
_LOCK = "lock"


def _flush(array: np.ndarray) -> None:
    if isinstance(array, np.memmap):
        array.flush()


def _hold(partial: Path) -> int:
    """Descriptor of the locked lock file of a partial run.

    Raises
    ------
    ParameterError
        When another process holds it.
    """
    while True:
        partial.mkdir(parents=True, exist_ok=True)
        descriptor = -1
        try:
            descriptor = os.open(partial / _LOCK, os.O_RDWR | os.O_CREAT, 0o666)
            if fcntl is not None:
                fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Another process may have finished, and renamed the folder, in between.
            if os.path.samestat(os.fstat(descriptor), os.stat(partial / _LOCK)):
                return descriptor
            os.close(descriptor)
        except OSError as error:
            if descriptor >= 0:
                os.close(descriptor)
            if isinstance(error, FileNotFoundError):
                continue
            if error.errno not in (errno.EACCES, errno.EAGAIN):
                raise
            raise ParameterError(
                f"run {partial.stem!r} is being written by another process into "
                f"{str(partial.parent)!r}; wait for it, or give another output folder"
            ) from error


def discard_partial(partial: str | Path) -> None:
    """Remove what an interrupted run left behind.

    Raises
    ------
    ParameterError
        When another process is still writing it.
    """
    descriptor = _hold(Path(partial))
    try:
        shutil.rmtree(partial)
    finally:
        os.close(descriptor)


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

    Raises
    ------
    BudgetError
        When the disk has no room for the run.
    ParameterError
        When another process is writing this run.
    """

    def __init__(
        self, folder: str | Path, shapes: Mapping[str, tuple[int, ...]], header: Mapping[str, Any]
    ) -> None:
        self.folder = Path(folder)
        self.partial = self.folder.with_name(self.folder.name + ".partial")
        self.header = json.loads(json.dumps(dict(header), allow_nan=False))
        self.shapes = {k: tuple(int(i) for i in v) for k, v in shapes.items()}
        if not self.partial.exists():
            self._check_room()
        # Let go of when the writer is done, dropped, or its process ends.
        self._unlock = weakref.finalize(self, os.close, _hold(self.partial))
        self.resumed = self._open_existing()
        if not self.resumed:
            self._create()

    def _describe(self) -> dict[str, Any]:
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
            raise BudgetError(
                f"this run needs {need / 1e9:.1f} GB on disk and {free / 1e9:.1f} GB are free; "
                "sample less often or shorten the run"
            )

    def _create(self) -> None:
        for left in self.partial.iterdir():
            if left.name != _LOCK:
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
            raise BudgetError(
                f"no room on the disk of {str(self.partial.parent)!r} for this run; free some, or "
                "sample less often"
            ) from error

    def checkpoint(self, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, Any]) -> None:
        """Make all rows written so far durable and remember how to go on from here."""
        for array in self.arrays.values():
            _flush(array)
        save_archive(self.partial / "checkpoint.npz", "checkpoint", 1, arrays, metadata)

    def last_checkpoint(self) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
        """What `checkpoint` stored last, or None; a broken checkpoint counts as none."""
        try:
            return load_archive(self.partial / "checkpoint.npz", "checkpoint", 1)
        except (FileNotFoundError, FileFormatError):
            return None

    def finish(self, metadata: Mapping[str, Any]) -> Path:
        """Close the arrays and give the folder its final name."""
        for array in self.arrays.values():
            _flush(array)
        self.arrays = {}
        (self.partial / "checkpoint.npz").unlink(missing_ok=True)
        (self.partial / _LOCK).unlink()
        write_json(self.partial / "run.json", {**self._describe(), "metadata": dict(metadata)})
        if self.folder.exists():
            shutil.rmtree(self.folder)
        os.replace(self.partial, self.folder)
        self._unlock()
        return self.folder


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
        except (*READ_ERRORS, TypeError, AttributeError) as error:
            raise FileFormatError(
                f"{str(self.folder)!r} is not a complete cellsys run: {error}"
            ) from error
        for name, shape in shapes.items():
            if self.arrays[name].shape != shape:
                raise FileFormatError(f"array {name!r} of run {self.folder.name!r} is damaged")


def _mapped(array: Any) -> np.memmap | None:
    """The read-only memory map that an array is a view of, or None."""
    while array is not None:
        if isinstance(array, np.memmap) and isinstance(array.base, mmap.mmap):
            return array if array.mode == "r" else None
        array = getattr(array, "base", None)
    return None


def read_rows(array: Any, start: int, stop: int) -> np.ndarray:
    """Rows start..stop of a 2-D array; of a memory map they are read from the file.

    Reading leaves nothing behind in resident memory, and is faster than faulting pages in.
    `array` may be a view of some consecutive rows and columns of the map.
    """
    owner = _mapped(array)
    if owner is None or owner.ndim != 2 or np.ndim(array) != 2 or array.strides != owner.strides:
        return array[start:stop]
    width, size = owner.shape[1], owner.dtype.itemsize
    skipped, column = divmod((array.ctypes.data - owner.ctypes.data) // size, width)
    rows = min(stop, len(array)) - start
    with open(owner.filename, "rb") as file:
        offset = owner.offset + (skipped + start) * width * size
        block = np.fromfile(file, owner.dtype, rows * width, offset=offset)
    return block.reshape(rows, width)[:, column : column + array.shape[1]]


def release(array: Any) -> None:
    """Let go of the pages of a memory-mapped array that have been read; they stay on disk.

    Resident memory then follows what is in use, not all that was ever touched. Arrays in memory
    are left alone.
    """
    owner = _mapped(array)
    if owner is not None and hasattr(mmap, "MADV_DONTNEED"):
        owner.base.madvise(mmap.MADV_DONTNEED)
