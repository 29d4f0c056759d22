"""Arrays that files fill row by row, on disk where they are large."""

from __future__ import annotations

import contextlib
import mmap
import shutil
import tempfile
import weakref
from collections.abc import Iterator
from pathlib import Path

import numpy as np

IN_MEMORY = 64e6  # bytes of a run above which its arrays go to a temporary folder


class RowFile:
    """An array filled row by row, in memory or in a file that is mapped when it is whole."""

    def __init__(self, folder: Path | None, name: str, shape: tuple[int, int]) -> None:
        self._next = 0
        if folder is None:
            self._array: np.ndarray = np.empty(shape)
        else:
            self._path = folder / f"{name}.npy"
            self._array = np.lib.format.open_memmap(
                self._path, mode="w+", dtype=np.float64, shape=shape
            )

    def add(self, row: np.ndarray) -> None:
        """Fill the next row."""
        self._array[self._next] = row
        self._next += 1
        if isinstance(self._array, np.memmap) and self._next % 64 == 0:
            self._array.flush()
            pages = self._array.base
            if isinstance(pages, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
                pages.madvise(mmap.MADV_DONTNEED)  # they are on disk

    def whole(self) -> np.ndarray:
        """The filled array; a read-only map where it is on disk."""
        if not isinstance(self._array, np.memmap):
            return self._array
        self._array.flush()
        array: np.ndarray = np.load(self._path, mmap_mode="r", allow_pickle=False)
        # The file goes with its last reader, whichever view of it that is.
        weakref.finalize(array.base, _discard, self._path)
        self._array = array
        return array


def _discard(path: Path) -> None:
    """Remove a file, and its folder with the last one."""
    path.unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        path.parent.rmdir()


@contextlib.contextmanager
def array_folder(name: str, size: float) -> Iterator[Path | None]:
    """A temporary folder for a large run; removed here only when reading fails."""
    if size <= IN_MEMORY:
        yield None
        return
    place = Path(tempfile.mkdtemp(prefix=f"cellsys-{name[:30]}-"))
    whole = False
    try:
        yield place
        whole = True
    finally:
        if not whole:
            shutil.rmtree(place, ignore_errors=True)
