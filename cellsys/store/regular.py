"""Regular files alone are read: a pipe may never end, and a device never does."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO

from cellsys.errors import FileFormatError

# Opening a pipe without the first of them waits until somebody writes.
_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def open_regular(path: Path, most: float = float("inf")) -> BinaryIO:
    """A file opened to read bytes.

    Raises
    ------
    OSError
        When there is none, or it may not be read.
    FileFormatError
        When it is a folder, a pipe or a device, or holds more than `most` bytes.
    """
    handle = os.open(path, _FLAGS)
    try:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode):
            raise FileFormatError(
                f"{path.name or str(path)!r} cannot be read: no regular file but a folder, pipe or "
                "device"
            )
        if found.st_size > most:
            raise FileFormatError(
                f"{path.name!r} has {found.st_size / 1e6:.3g} MB; at most {most / 1e6:g} MB are "
                "read of such a file"
            )
        return os.fdopen(handle, "rb")
    except FileFormatError:
        os.close(handle)
        raise
