"""`segment_cells`: contours of cells from fluorescence movies, by scikit-image."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy import ndimage

from cellsys.arguments import checked
from cellsys.contours import CellOutlines
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.io.extras import extra
from cellsys.io.images import read_image
from cellsys.io.masks import outlines_of, scaled_outlines
from cellsys.io.trace import Traced, trace
from cellsys.units import real_array, real_number

_THRESHOLDS = ("otsu", "li")


@checked
def segment_cells(
    source: str | Path | np.ndarray,
    *,
    pixel_size: float | None = None,
    frame_interval: float | None = None,
    smoothing: float = 2.0,
    threshold: str = "otsu",
    least_area: float = 50.0,
    apart: float = 10.0,
) -> CellOutlines:
    """Contours of bright cells on a dark background.

    Each channel is smoothed by a Gaussian, parted by the threshold of Otsu or Li, and cells that
    touch are parted by a watershed from the middles of their distance maps. The contour is where
    the smoothed image passes the middle between the means inside and outside (a fraction of a
    pixel; a blur leaves a straight edge there).

    Parameters
    ----------
    source : path or array
        Movie (T, Y, X), or (T, C, Y, X) with one kind of cell in each channel.
    pixel_size, frame_interval : float, optional
        um per px and s per frame.
    smoothing : float
        Standard deviation of the Gaussian, px.
    threshold : {"otsu", "li"}
    least_area : float
        Smaller parts are noise, px^2.
    apart : float
        Least distance of the middles of two cells, px.

    Raises
    ------
    ParameterError
        Without scikit-image, or a parameter out of its bound.
    DataError, DimensionError
        NaN, or another shape.
    """
    if threshold not in _THRESHOLDS:
        raise ParameterError(f"threshold must be one of {_THRESHOLDS}, got {threshold!r}")
    for name, value in (("smoothing", smoothing), ("least_area", least_area), ("apart", apart)):
        if not real_number(value, name) > 0:
            raise ParameterError(f"{name} must be > 0, got {value!r}")
    name = Path(source).name if isinstance(source, (str, Path)) else "array"
    images = read_image(Path(source)) if isinstance(source, (str, Path)) else np.asarray(source)
    if images.ndim not in (3, 4):
        raise DimensionError(
            f"{name}: a movie must have shape (frames, rows, columns) or (frames, channels, rows, "
            f"columns), got {images.shape}"
        )
    if images.ndim == 3:
        images = images[:, None]
    found = []
    for channel in range(images.shape[1]):
        movie = _Channel(images[:, channel], name, smoothing, threshold, least_area, apart)
        found.append(outlines_of(movie.labels(), movie.contour, name))
    merged = found[0] if len(found) == 1 else _merged(found)
    return scaled_outlines(merged, pixel_size, frame_interval)


class _Channel:
    """Labels of one channel, frame after frame, and their contours to a fraction of a pixel."""

    def __init__(
        self,
        images: np.ndarray,
        name: str,
        smoothing: float,
        threshold: str,
        least_area: float,
        apart: float,
    ) -> None:
        filters = extra("skimage.filters", "images", "segment_cells")
        self._by = filters.threshold_otsu if threshold == "otsu" else filters.threshold_li
        self._images, self._name, self._smoothing = images, name, smoothing
        self._least, self._apart = least_area, apart
        self._smooth, self._level = np.zeros((0, 0)), 0.0

    def labels(self) -> Iterator[np.ndarray]:
        """Label image of every frame; `contour` is of the frame that came last."""
        for k in range(len(self._images)):
            plane = real_array(self._images[k], self._name)
            if not np.isfinite(plane).all():
                raise DataError(f"{self._name}, frame {k}: not finite; repair that frame")
            self._smooth = ndimage.gaussian_filter(plane.astype(np.float32), self._smoothing)
            yield self._parted()

    def _parted(self) -> np.ndarray:
        smooth = self._smooth
        if not np.ptp(smooth) > 0:
            return np.zeros(smooth.shape, dtype=np.int32)
        sparse = smooth[::2, ::2] if smooth.size > 1e5 else smooth
        self._level = self._middle(float(self._by(sparse)))
        parts, _ = ndimage.label(smooth > self._level)
        sizes = np.bincount(parts.ravel())
        sizes[0] = 0
        large = np.flatnonzero(sizes >= self._least)
        numbers = np.zeros(len(sizes), dtype=np.int32)
        numbers[large] = np.arange(1, len(large) + 1)
        labels, count = numbers[parts], len(large)
        for number, box in enumerate(ndimage.find_objects(labels), 1):
            inside = labels[box] == number
            pieces = self._watershed(inside)
            if pieces is not None:
                piece = labels[box]
                piece[pieces > 1] = count + pieces[pieces > 1] - 1
                count += int(pieces.max()) - 1
        return np.asarray(labels)

    def _middle(self, threshold: float) -> float:
        """Halfway between the medians outside and well inside the parts above a threshold."""
        smooth = self._smooth
        above = smooth > threshold
        parts = ndimage.label(above)[0]
        sizes = np.bincount(parts.ravel())[1:]
        boxes = ndimage.find_objects(parts)
        cores = [
            smooth[boxes[n]][ndimage.binary_erosion(parts[boxes[n]] == n + 1, iterations=3)]
            for n in np.flatnonzero(sizes >= self._least).tolist()
        ]
        core = np.concatenate([c.ravel() for c in cores]) if cores else np.zeros(0)
        inside = core if core.size else smooth[above]
        return 0.5 * (float(np.median(inside)) + float(np.median(smooth[~above][::5])))

    def _watershed(self, inside: np.ndarray) -> np.ndarray | None:
        """Parts of one piece that holds several cells; None where it holds one."""
        feature = extra("skimage.feature", "images", "segment_cells")
        depth = ndimage.distance_transform_edt(np.pad(inside, 1))[1:-1, 1:-1]
        depth = ndimage.gaussian_filter(depth, 2.0)
        peaks = feature.peak_local_max(
            depth, min_distance=max(1, round(self._apart)), labels=inside.astype(int),
            exclude_border=False,
        )  # fmt: skip
        kept: list[np.ndarray] = []
        for peak in peaks:  # those of one height, side by side, are one middle
            if all(np.hypot(*(peak - other)) >= self._apart for other in kept):
                kept.append(peak)
        if len(kept) < 2:
            return None
        seeds = np.zeros(inside.shape, dtype=np.int32)
        for number, (i, j) in enumerate(kept, 1):
            seeds[i, j] = number
        segmentation = extra("skimage.segmentation", "images", "segment_cells")
        return np.asarray(segmentation.watershed(-depth, seeds, mask=inside))

    def contour(self, image: np.ndarray, label: int, box: tuple[slice, slice]) -> Traced:
        """`trace`, with finer corners."""
        coarse = trace(image, label, box)
        if coarse.at_edge:
            return coarse
        grown = tuple(slice(s.start - 1, s.stop + 1) for s in box)
        labels, plane = image[grown], self._smooth[grown]
        other = (labels != label) & (labels != 0)
        plane = np.where(other, np.minimum(plane, 2.0 * self._level - plane), plane)
        measure = extra("skimage.measure", "images", "segment_cells")
        loops = measure.find_contours(plane, self._level)
        loops = [c for c in loops if len(c) > 3 and np.array_equal(c[0], c[-1])]
        if not loops:
            return coarse
        longest = max(loops, key=len)[:-1]
        corners = longest[:, ::-1] + np.array([grown[1].start, grown[0].start])
        keep = np.any(corners != np.roll(corners, 1, axis=0), axis=1)
        return coarse._replace(corners=corners[keep])


def _merged(found: list[CellOutlines]) -> CellOutlines:
    """Cells of several channels: ``1.1`` is cell 1 of channel 1."""
    return CellOutlines(
        cell=tuple(f"{c}.{name}" for c, part in enumerate(found, 1) for name in part.cell),
        frame=np.concatenate([part.frame for part in found]),
        t=np.concatenate([part.t for part in found]),
        outline=tuple(corners for part in found for corners in part.outline),
        length_unit="px", time_unit="frame",
        touches_edge=np.concatenate([part.touches_edge for part in found
                                     if part.touches_edge is not None]),
        source={**found[0].source, "channels": len(found)},
    )  # fmt: skip
