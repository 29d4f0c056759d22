"""Read-outs of a spreading run: node speeds, contact radius, heights, crawl in the plane."""

from __future__ import annotations

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DataError
from cellsys.trajectory import Trajectory
from cellsys.units import shaped_array

CONTACT_HEIGHT = 1.0  # um: nodes below this count as in contact


@checked
def node_speed(run: Trajectory, block: str) -> np.ndarray:
    """Speed of every node in every sampling interval (T - 1, n), um/s."""
    x = run.block(block)
    if len(x) < 2:
        raise DataError("a speed needs at least two samples")
    return np.linalg.norm(np.diff(x, axis=0), axis=2) / np.diff(run.t)[:, None]


@checked
def contact_radius(position: np.ndarray) -> float:
    """Largest horizontal distance from the centroid of a node in contact, um; 0 without one."""
    position = shaped_array(position, "position", (None, 3))
    low = position[:, 2] < CONTACT_HEIGHT
    if not low.any():
        return 0.0
    return float(np.hypot(*(position[low, :2] - position[:, :2].mean(axis=0)).T).max())


@checked
def crawl_distance(position: np.ndarray) -> float:
    """How far a cell with nodes (T, n, 3) crawled, um.

    The length of the straight path of its centre in the plane, from the first sample to the last;
    the centre is the mean of the nodes. It sinks while a cell spreads, which is no crawling:
    `centre_height` is a read-out of its own.
    """
    ends = shaped_array(position, "position", (None, None, 3))[[0, -1]].mean(axis=1)[:, :2]
    return float(np.hypot(*(ends[1] - ends[0])))


@checked
def centre_height(position: np.ndarray) -> float:
    """Height of the centre of a cell with nodes (n, 3) over the plane z = 0, um."""
    return float(shaped_array(position, "position", (None, 3))[:, 2].mean())


@checked
def summary_of_run(
    run: Trajectory, rest: np.ndarray | None = None, cell: str = "cell1"
) -> dict[str, float]:
    """Magnitudes of one cell of a run, in um and nm/s.

    Parameters
    ----------
    run : Trajectory
        With the block ``CELL.position``.
    rest : (N, 3), optional
        Rest positions of the matrix nodes, for the speeds under the cell and near the rim.

    Returns
    -------
    dict
        Crawl distance in the plane, contact radii, heights of the cell and of its centre at start
        and end, mean membrane speed, and with `rest` the 99th percentile of matrix speed under
        the cell (within its contact radius), the mean near the rim (outer 13 % of the radius), and
        the greatest displacement of any node at any sample.
    """
    x = run.block(f"{cell}.position")
    centre = x.mean(axis=1)
    out = {
        "crawl_um": crawl_distance(x),
        "contact_radius_start_um": contact_radius(x[0]),
        "contact_radius_end_um": contact_radius(x[-1]),
        "height_start_um": float(np.ptp(x[0, :, 2])),
        "height_end_um": float(np.ptp(x[-1, :, 2])),
        "centre_height_start_um": centre_height(x[0]),
        "centre_height_end_um": centre_height(x[-1]),
        "membrane_speed_mean_nm_s": 1e3 * float(node_speed(run, f"{cell}.position").mean()),
    }
    if rest is None or "matrix.displacement" not in run.states:
        return out
    speed = 1e3 * node_speed(run, "matrix.displacement")
    rest = shaped_array(rest, "rest", run.states["matrix.displacement"].shape)
    r = np.hypot(rest[:, 0], rest[:, 1])
    off = np.hypot(rest[None, :, 0] - centre[:-1, None, 0], rest[None, :, 1] - centre[:-1, None, 1])
    under = off < np.array([contact_radius(p) for p in x[:-1]])[:, None]
    u = run.block("matrix.displacement")
    return out | {
        "matrix_speed_p99_under_cell_nm_s": float(np.percentile(speed[under], 99))
        if under.any()
        else 0.0,
        "matrix_speed_mean_rim_nm_s": float(speed[:, r > 0.87 * r.max()].mean()),
        "matrix_displacement_max_um": float(np.linalg.norm(u, axis=2).max()),
    }
