"""`read_masks`: contours of cells from label images, masks of True and False, or polygons."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from scipy import ndimage

from cellsys.arguments import checked
from cellsys.contours import CellOutlines
from cellsys.errors import DataError, DimensionError, FileFormatError, ParameterError
from cellsys.io.images import as_labels, read_image
from cellsys.io.shapes import read_shapes
from cellsys.io.trace import Followed, Traced, trace
from cellsys.units import real_number

_IDENTITIES = ("overlap", "labels")


@checked
def read_masks(
    source: str | Path | np.ndarray,
    *,
    pixel_size: float | None = None,
    frame_interval: float | None = None,
    identity: str = "overlap",
) -> CellOutlines:
    """Contours of cells per frame from masks.

    Parameters
    ----------
    source : path or array
        Label images (T, Y, X) or (Y, X): whole numbers, 0 outside (8, 16, 32 bit), or True and
        False, whose connected parts are the cells. A TIFF stack (extra ``images``), an ``.npy``
        file, a folder of TIFF images in the order of their names, or polygons: ``.geojson`` with
        properties ``cell`` and ``frame``, or ``.csv`` with columns ``cell``, ``frame``, ``wkt``
        (extra ``images``).
    pixel_size, frame_interval : float, optional
        um per px and s per frame; without them lengths stay in px and times in frames.
    identity : {"overlap", "labels"}
        Whether cells are followed by the overlap of their masks from frame to frame, or keep
        their label through the movie.

    Returns
    -------
    CellOutlines
        x is the column and y the row of a pixel's centre. Contours are outer edges (holes are
        filled), of a label in several parts that of the largest; `source` counts both.

    Raises
    ------
    FileNotFoundError
    FileFormatError, DataError, DimensionError
        What is no mask, or declares more pixels than half of the memory holds.
    """
    if identity not in _IDENTITIES:
        raise ParameterError(f"identity must be one of {_IDENTITIES}, got {identity!r}")
    for name, value in (("pixel_size", pixel_size), ("frame_interval", frame_interval)):
        if value is not None and not real_number(value, name) > 0:
            raise ParameterError(f"{name} must be > 0, got {value!r}")
    if isinstance(source, (str, Path)):
        path = Path(source)
        if path.suffix.lower() in (".geojson", ".json", ".csv", ".wkt"):
            return scaled_outlines(read_shapes(path), pixel_size, frame_interval)
        images, name = _images(path), path.name
    else:
        images, name = np.asarray(source), "array"
    frames = label_frames(images, name)
    found = outlines_of(frames, trace, name, by_label=identity == "labels")
    return scaled_outlines(found, pixel_size, frame_interval)


def _images(path: Path) -> np.ndarray:
    if not path.exists():
        raise FileNotFoundError(f"no file or folder {str(path)!r}")
    if not path.is_dir():
        return read_image(path)
    files = sorted(p for p in path.iterdir() if p.suffix.lower() in (".tif", ".tiff", ".npy"))
    if not files:
        raise FileFormatError(f"{path.name!r} holds no .tif, .tiff or .npy image")
    planes = [read_image(p) for p in files]
    odd = [p.name for p, image in zip(files, planes, strict=True) if image.shape != planes[0].shape]
    if odd:
        raise FileFormatError(f"{odd[0]} has another size than {files[0].name}")
    return np.stack(planes)


def label_frames(images: np.ndarray, name: str) -> Iterator[np.ndarray]:
    """Label images of a movie; True and False become labels of connected parts."""
    stack = images[None] if images.ndim == 2 else images
    if stack.ndim != 3:
        raise DimensionError(
            f"{name}: masks must have shape (frames, rows, columns) or (rows, columns), got "
            f"{images.shape}; give one channel and one plane"
        )
    for plane in stack:
        yield (
            np.asarray(ndimage.label(plane)[0])
            if plane.dtype.kind == "b"
            else as_labels(plane, name)
        )


def outlines_of(
    frames: Iterable[np.ndarray],
    contour: Callable[[np.ndarray, int, tuple[slice, slice]], Traced],
    name: str,
    *,
    by_label: bool = False,
) -> CellOutlines:
    """Contours of all labels of all frames, px and frames; `contour` finds one."""
    followed = Followed()
    cells, at, corners, edges, left, holes = [], [], [], [], 0, 0
    small = count = 0
    for k, image in enumerate(frames):
        count += 1
        most = int(image.max(initial=0))
        if most > 1_000_000:
            raise DataError(f"{name}, frame {k}: label {most}; labels beyond 1e6 are no cells")
        who = {} if by_label else followed.frame(image)
        for label, box in enumerate(ndimage.find_objects(image), 1):
            if box is None:
                continue
            found = contour(image, label, (box[0], box[1]))
            if len(found.corners) < 3:
                small += 1
                continue
            cells.append(str(who.get(label, label)))
            at.append(k)
            corners.append(found.corners)
            edges.append(found.at_edge)
            left += found.left_out
            holes += found.holes
    return CellOutlines(
        cell=tuple(cells), frame=np.array(at, dtype=float), t=np.array(at, dtype=float),
        outline=tuple(corners), length_unit="px", time_unit="frame",
        touches_edge=np.array(edges, dtype=bool),
        source={
            "file": name, "frames": count, "pixels_left_out": left, "holes_filled": holes,
            "too_small": small, "empty_frames": count - len(set(at)),
        },
    )  # fmt: skip


def scaled_outlines(
    found: CellOutlines, pixel_size: float | None, frame_interval: float | None
) -> CellOutlines:
    """The same contours in um and s, as far as the scale is given."""
    if pixel_size is not None and found.length_unit == "um":
        raise ParameterError(f"pixel_size = {pixel_size!r}: these contours are in um already")
    if frame_interval is not None and found.time_unit == "s":
        raise ParameterError(f"frame_interval = {frame_interval!r}: these are in s already")
    step = 1.0 if frame_interval is None else frame_interval
    size = 1.0 if pixel_size is None else pixel_size
    return CellOutlines(
        cell=found.cell, frame=found.frame, t=found.t * step,
        outline=tuple(size * corners for corners in found.outline),
        length_unit=found.length_unit if pixel_size is None else "um",
        time_unit=found.time_unit if frame_interval is None else "s",
        touches_edge=found.touches_edge,
        source={**found.source, "pixel_size_um": pixel_size, "frame_interval_s": frame_interval},
    )  # fmt: skip
