"""A run as a movie: contours of the cells from above, their polarity, and the moving matrix."""

from __future__ import annotations

from pathlib import Path

import matplotlib.animation as animation
import numpy as np
from matplotlib.figure import Figure

from cellsys.arguments import checked
from cellsys.errors import ParameterError
from cellsys.kinds import Count
from cellsys.observe.top_view import top_view
from cellsys.store.atomic import atomic_path
from cellsys.trajectory import Trajectory, cell_names

_FRAMES = 200  # drawn at most, unless `every` says otherwise


@checked
def write_movie(
    run: Trajectory,
    path: str | Path,
    *,
    every: Count | None = None,
    frames_per_second: Count = 15,
    width: Count = 640,
) -> Path:
    """Draw a run seen from above, frame by frame.

    Parameters
    ----------
    run : Trajectory
        With membranes; a matrix is drawn as its surface nodes at their places.
    path : path
        ``.gif``, or ``.mp4`` where the program ffmpeg is installed.
    every : int, optional
        Draw every so many samples; default: so many that at most 200 frames are drawn.
    frames_per_second : int
    width : int
        px.

    Raises
    ------
    ParameterError
        Another ending, no ffmpeg, a number out of its bound.
    DataError
        A run without membranes.
    """
    target = Path(path)
    kind = target.suffix.lower()
    if kind not in (".gif", ".mp4"):
        raise ParameterError(f"path must end with .gif or .mp4, got {target.name!r}")
    if kind == ".mp4" and not animation.FFMpegWriter.isAvailable():
        raise ParameterError("an .mp4 needs the program ffmpeg; install it, or write a .gif")
    step = max(1, -(-len(run) // _FRAMES)) if every is None else every
    if step < 1 or frames_per_second < 1 or not 64 <= width <= 4096:
        raise ParameterError(
            f"every must be >= 1, frames_per_second >= 1 and width 64 to 4096 px, got {step}, "
            f"{frames_per_second} and {width}"
        )
    seen = top_view(run)
    low = np.min([c.min(axis=0) for c in seen.outline], axis=0) - 8.0
    high = np.max([c.max(axis=0) for c in seen.outline], axis=0) + 8.0
    size = high - low
    figure = Figure(figsize=(width / 100, width / 100 * size[1] / size[0] + 0.4), dpi=100)
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0 - 0.3 / figure.get_figheight()))
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xticks=[], yticks=[])
    names = cell_names(run.states)
    rows = {name: seen.rows(name) for name in names}
    lines = {name: ax.plot([], [], lw=2)[0] for name in names}
    headings = {name: ax.plot([], [], color="black", lw=1.5)[0] for name in names}
    rest = run.geometry.get("matrix.rest")
    with_matrix = rest is not None and "matrix.displacement" in run.states
    nodes = ax.plot([], [], ".", color="0.7", ms=2, zorder=0)[0]
    surface = np.asarray(run.geometry.get("matrix.surface", slice(None)))
    title = ax.set_title("")
    writer = (animation.PillowWriter if kind == ".gif" else animation.FFMpegWriter)(
        fps=frames_per_second
    )
    with atomic_path(target) as temporary, writer.saving(figure, str(temporary), dpi=100):
        for k in range(0, len(run), step):
            for i, name in enumerate(names):
                corners = seen.outline[rows[name][k]]
                lines[name].set_data(*np.vstack([corners, corners[:1]]).T)
                if run.p is not None and i < np.shape(run.p)[1]:
                    centre, p = corners.mean(axis=0), np.asarray(run.p[k, i, :2])
                    headings[name].set_data(*np.array([centre, centre + 5.0 * p]).T)
            if with_matrix and rest is not None:
                place = (rest + run.block("matrix.displacement")[k])[surface]
                nodes.set_data(place[:, 0], place[:, 1])
            title.set_text(f"t = {run.t[k]:g} s")
            writer.grab_frame()
    return target
