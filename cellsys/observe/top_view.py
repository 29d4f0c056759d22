"""The contour of a cell of a run, seen from above."""

from __future__ import annotations

import numpy as np

from cellsys.arguments import checked
from cellsys.contours import CellOutlines
from cellsys.errors import DataError
from cellsys.mechanics.contact import Outline
from cellsys.trajectory import Trajectory, cell_names


@checked
def top_view(run: Trajectory) -> CellOutlines:
    """Contours of the cells of a run with membranes, seen from above, um.

    Of a triangulated membrane the farthest crossing of the rays from its middle through every
    node with the projected edges: exact, but for the sides between two such rays, where the shape
    is seen whole from its middle; what a fold hides behind another is filled. Nodes at one height
    are the corners of a contour already.

    Raises
    ------
    DataError
        A run without membranes.
    """
    names = cell_names(run.states)
    if not names:
        raise DataError("the run has no cell with a membrane (CELL.position), hence no contour")
    cells, frames, outlines = [], [], []
    for name in names:
        body = Outline.of(run, name)
        edges = None if body.mesh is None else _edges(body.mesh.triangles)
        for k in range(len(run)):
            x = body.x[k, :, :2]
            cells.append(name)
            frames.append(k)
            outlines.append(np.array(x) if edges is None else silhouette(x, edges))
    frame = np.array(frames)
    return CellOutlines(
        cell=tuple(cells), frame=frame, t=np.asarray(run.t)[frame], outline=tuple(outlines),
        source={"run": run.label, "view": "from above"},
    )  # fmt: skip


def _edges(triangles: np.ndarray) -> np.ndarray:
    """Every edge of the triangles once (m, 2)."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return np.unique(np.sort(pairs, axis=1), axis=0)


def silhouette(x: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Corners (n, 2) of the outline of projected nodes x (n, 2) with edges (m, 2)."""
    # The middle of the box moves and turns with the shape only for nodes; their mean does.
    centre = x.mean(axis=0)
    r = x - centre
    length = np.hypot(r[:, 0], r[:, 1])
    ray = r[length > 1e-12 * length.max(initial=1e-300)]
    ray = ray / np.hypot(ray[:, 0], ray[:, 1])[:, None]
    ray = ray[np.argsort(np.arctan2(ray[:, 1], ray[:, 0]), kind="stable")]
    a = r[edges[:, 0]]
    d = r[edges[:, 1]] - a
    # centre + s ray = a + w d
    determinant = d[None, :, 0] * ray[:, None, 1] - d[None, :, 1] * ray[:, None, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        w = (a[None, :, 1] * ray[:, None, 0] - a[None, :, 0] * ray[:, None, 1]) / determinant
        s = (a[:, 1] * d[:, 0] - a[:, 0] * d[:, 1])[None, :] / determinant
    met = (w >= -1e-9) & (w <= 1.0 + 1e-9) & np.isfinite(s)
    far = np.where(met, s, -np.inf).max(axis=1)
    seen = np.isfinite(far) & (far > 0)
    corners = centre + far[seen, None] * ray[seen]
    if len(corners) < 3:
        raise DataError("the nodes of a membrane lie on a line seen from above")
    apart = np.any(np.abs(corners - np.roll(corners, 1, axis=0)) > 0, axis=1)
    return np.asarray(corners[apart])
