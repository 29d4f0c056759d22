"""Images from TIFF and npy files; the sizes they declare are looked at before they are read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellsys.errors import DataError, FileFormatError
from cellsys.io.extras import extra
from cellsys.store.archive import READ_ERRORS
from cellsys.store.memory import available_memory, size_text
from cellsys.store.regular import open_regular

_SHARE = 0.5  # of the memory there is, for the pixels of one movie


def read_image(path: Path) -> np.ndarray:
    """The pixels of a TIFF (extra ``images``) or npy file.

    Raises
    ------
    FileNotFoundError
    ParameterError
        A TIFF without the package tifffile.
    FileFormatError
        Damaged, of another kind, pickled, or declaring more pixels than fit into memory.
    """
    kind = path.suffix.lower()
    if not path.exists():
        raise FileNotFoundError(f"no file {str(path)!r}")
    if kind == ".npy":
        return _npy(path)
    if kind not in (".tif", ".tiff"):
        raise FileFormatError(f"{path.name}: images are read from .tif, .tiff and .npy")
    tifffile = extra("tifffile", "images", f"{path.name} (TIFF)")
    with open_regular(path):
        pass  # a pipe or device is refused before it is opened as an image
    try:
        with tifffile.TiffFile(path) as tiff:
            series = tiff.series[0]
            _check_size(path, tuple(series.shape), np.dtype(series.dtype).itemsize)
            return np.asarray(series.asarray())
    except (*READ_ERRORS, tifffile.TiffFileError, IndexError, TypeError, AttributeError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"{path.name} is no TIFF that can be read: {error}") from error


def label_image(path: Path) -> np.ndarray:
    """A label image: whole numbers, 0 is background; True and False count as 1 and 0."""
    return as_labels(read_image(path), path.name)


def as_labels(image: np.ndarray, name: str) -> np.ndarray:
    """An array of labels as int64.

    Raises
    ------
    DataError
        Numbers that are not whole, or below 0.
    """
    if image.dtype.kind == "f":
        if not np.all(image == np.round(image)):
            raise DataError(f"{name} holds {image.dtype.name}s that are no labels; give integers")
    elif image.dtype.kind not in "biu":
        raise DataError(f"{name} holds {image.dtype.name}, no labels")
    labels = image.astype(np.int64)
    if labels.size and labels.min() < 0:
        raise DataError(
            f"{name} holds the label {labels.min()}; labels are 1, 2, ... and 0 outside"
        )
    return labels


def _npy(path: Path) -> np.ndarray:
    try:
        with open_regular(path) as file:
            version = np.lib.format.read_magic(file)
            header = np.lib.format.read_array_header_1_0
            if version != (1, 0):
                header = np.lib.format.read_array_header_2_0
            shape, _, dtype = header(file)
            if dtype.hasobject:
                raise FileFormatError(f"{path.name} holds pickled objects, which are never read")
            _check_size(path, shape, dtype.itemsize)
            file.seek(0)
            return np.asarray(np.lib.format.read_array(file, allow_pickle=False))
    except (*READ_ERRORS, TypeError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"{path.name} is no npy file that can be read: {error}") from error


def _check_size(path: Path, shape: tuple[int, ...], itemsize: int) -> None:
    """Refuse what the header declares before anything is allocated."""
    need = float(itemsize)
    for n in shape:
        need *= n
    if need > _SHARE * available_memory():
        raise FileFormatError(
            f"{path.name} declares {' x '.join(map(str, shape))} pixels, {size_text(need)}: more "
            f"than half of the memory there is; cut the movie into parts"
        )
