"""`render_movie`: contours as a microscope would show them, with the truth beside them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from cellsys.arguments import checked
from cellsys.contours import CellOutlines
from cellsys.errors import DataError, MemoryBudgetError, ParameterError
from cellsys.io.extras import extra
from cellsys.kinds import Seed
from cellsys.observe.top_view import top_view
from cellsys.shown import Shown
from cellsys.store.atomic import atomic_path
from cellsys.store.memory import available_memory
from cellsys.trajectory import Trajectory
from cellsys.units import real_number

_SUB = 8  # rows of a pixel over which its share inside a contour is averaged


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class RenderedMovie(Shown):
    """A movie with one channel per cell, and what it shows.

    Parameters
    ----------
    images : uint16 array (T, C, Y, X)
    truth : CellOutlines
        The contours that were drawn, in px and frames of the movie.
    pixel_size : float
        um per px.
    frame_interval : float
        s per frame.
    """

    images: np.ndarray
    truth: CellOutlines
    pixel_size: float
    frame_interval: float

    def __str__(self) -> str:
        T, C, Y, X = self.images.shape
        return (
            f"RenderedMovie: {T} frames of {X} x {Y} px, {C} channels, {self.pixel_size:g} um per "
            f"px, {self.frame_interval:g} s per frame"
        )

    def save(self, path: str | Path) -> Path:
        """Write a TIFF stack (extra ``images``) with its axes and scale."""
        tifffile = extra("tifffile", "images", "a rendered movie as TIFF")
        target = Path(path)
        with atomic_path(target) as temporary:
            tifffile.imwrite(
                temporary, self.images, imagej=True,
                resolution=(1.0 / self.pixel_size, 1.0 / self.pixel_size),
                metadata={"axes": "TCYX", "unit": "um", "finterval": self.frame_interval},
            )  # fmt: skip
        return target


@checked
def render_movie(
    what: Trajectory | CellOutlines,
    path: str | Path | None = None,
    *,
    pixel_size: float = 0.25,
    blur: float = 1.5,
    signal_to_noise: float = 5.0,
    margin: float = 5.0,
    seed: Seed = 0,
) -> RenderedMovie:
    """A movie of cells seen from above, one channel each, blurred and noisy.

    Every pixel is its share inside the contour, blurred by a Gaussian, with white Gaussian noise
    of the signal over `signal_to_noise`, in 16 bit.

    Parameters
    ----------
    what : Trajectory or CellOutlines
        Contours in um and s, at equal intervals.
    path : path, optional
        Where to write it as a TIFF stack as well (extra ``images``).
    pixel_size : float
        um per px.
    blur : float
        Standard deviation of the blur, px; 0 for none.
    signal_to_noise : float
        Brightness of a cell over the standard deviation of the noise.
    margin : float
        Around all contours, um.
    seed : int

    Raises
    ------
    ParameterError, DataError
        A parameter out of its bound; contours that are not in um and s.
    MemoryBudgetError
        A movie of more pixels than half of the memory holds.
    """
    for name, value, least in (
        ("pixel_size", pixel_size, 0.0), ("signal_to_noise", signal_to_noise, 0.0),
        ("blur", blur, -1e-300), ("margin", margin, -1e-300),
    ):  # fmt: skip
        if not real_number(value, name) > least:
            raise ParameterError(f"{name} must be {'>' if least == 0 else '>='} 0, got {value!r}")
    seen = top_view(what) if isinstance(what, Trajectory) else what
    if (seen.length_unit, seen.time_unit) != ("um", "s"):
        raise DataError("contours to be rendered must be in um and s; give their scale first")
    times = np.unique(seen.t)
    interval = float(times[1] - times[0]) if len(times) > 1 else 1.0
    low = np.min([c.min(axis=0) for c in seen.outline], axis=0) - margin
    high = np.max([c.max(axis=0) for c in seen.outline], axis=0) + margin
    X, Y = (int(np.ceil(n)) + 1 for n in (high - low) / pixel_size)
    T, C = len(times), len(seen.names)
    if 4.0 * T * C * X * Y > 0.5 * available_memory():
        raise MemoryBudgetError(
            f"a movie of {T} frames, {C} channels and {X} x {Y} px does not fit into memory; "
            "raise pixel_size, or render fewer frames"
        )
    rng = np.random.default_rng(seed)
    images = np.zeros((T, C, Y, X), dtype=np.uint16)
    placed = tuple((corners - low) / pixel_size for corners in seen.outline)
    frame = np.searchsorted(times, seen.t)
    for c, name in enumerate(seen.names):
        drawn = {int(frame[k]): placed[k] for k in seen.rows(name)}
        for k in range(T):
            plane = coverage(drawn[k], (Y, X)) if k in drawn else np.zeros((Y, X))
            plane = ndimage.gaussian_filter(plane, blur) if blur > 0 else plane
            plane = plane + rng.standard_normal((Y, X)) / signal_to_noise
            images[k, c] = np.clip(np.round(20000.0 + 6000.0 * plane), 0, 65535).astype(np.uint16)
    movie = RenderedMovie(
        images=images,
        truth=CellOutlines(
            cell=seen.cell, frame=frame, t=frame, outline=placed, length_unit="px",
            time_unit="frame", source={**seen.source, "rendered": True},
        ),
        pixel_size=pixel_size,
        frame_interval=interval,
    )  # fmt: skip
    if path is not None:
        movie.save(path)
    return movie


def coverage(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Share of every pixel (rows, columns) inside a polygon; pixel (i, j) lies at x = j, y = i.

    Exact along x, and averaged over eight lines of each row.
    """
    image = np.zeros(shape)
    a, b = corners, np.roll(corners, -1, axis=0)
    first = max(0, int(np.floor(corners[:, 1].min() + 0.5)))
    last = min(shape[0] - 1, int(np.ceil(corners[:, 1].max() + 0.5)))
    left = np.arange(shape[1]) - 0.5
    for row in range(first, last + 1):
        for sub in range(_SUB):
            y = row - 0.5 + (sub + 0.5) / _SUB
            met = (a[:, 1] <= y) != (b[:, 1] <= y)
            p, q = a[met], b[met]
            x = np.sort(p[:, 0] + (y - p[:, 1]) * (q[:, 0] - p[:, 0]) / (q[:, 1] - p[:, 1]))
            for start, stop in zip(x[::2], x[1::2], strict=True):
                image[row] += np.clip(np.minimum(stop, left + 1.0) - np.maximum(start, left), 0, 1)
    return image / _SUB
