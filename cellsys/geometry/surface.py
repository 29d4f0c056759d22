"""Closed surfaces and contours, and the one distance between two of them.

    gap = least distance of the two surfaces                     where nothing lies in both
    gap = - max over points p in both of max(d(p, dA), d(p, dB))     where something does

d(p, dA) is the distance of p to the surface of A. So the gap is 0 where two cells touch, changes
continuously and no faster than they move, and while neither reaches the other's middle it is minus
the least shift that separates two convex bodies: for spheres c - r - s down to -max(r, s), c the
distance of their centres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from cellsys.errors import DataError, DimensionError
from cellsys.geometry.surface_kernels import (
    deepest,
    deepest_inside,
    least_square_of_pairs,
    longest_side,
    mark_crossing,
    pseudonormals,
    signed_distance,
)

DEPTH_TOLERANCE = 1e-3  # of the smaller extent of two surfaces that overlap
SHELLS = 4  # inside a surface, on which depths are tried besides those on the surfaces themselves
_TOUCH = 1e-12  # of the extent: contours that cross are this far apart by rounding


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of a closed surface.

    Parameters
    ----------
    triangles : int array (m, 3)
        Alike oriented; whether outward or inward is found from the volume.

    Raises
    ------
    DataError
        When an edge does not lie between exactly two of them that run along it in opposite ways.
    """

    triangles: np.ndarray

    def __post_init__(self) -> None:
        triangles = np.ascontiguousarray(self.triangles)
        if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
            raise DimensionError(
                f"triangles must be whole numbers (m, 3), got {triangles.dtype} of shape "
                f"{triangles.shape}"
            )
        if triangles.size and triangles.min() < 0:
            raise DataError(f"triangles name node {triangles.min()}; nodes count from 0")
        object.__setattr__(self, "triangles", triangles.astype(np.int64))
        self.across  # noqa: B018  whether the surface is closed is found here

    @cached_property
    def across(self) -> np.ndarray:
        """Triangle (m, 3) over the edge opposite to each corner."""
        t = self.triangles
        edges = np.concatenate([t[:, [1, 2]], t[:, [2, 0]], t[:, [0, 1]]])
        size = int(t.max(initial=0)) + 1
        there, back = edges @ [size, 1], edges[:, ::-1] @ [size, 1]
        order = np.argsort(there)
        place = np.searchsorted(there, back, sorter=order)
        met = order[np.minimum(place, len(order) - 1)] if len(order) else order
        if not len(t) or len(np.unique(there)) < len(there) or np.any(there[met] != back):
            raise DataError(
                "the triangles are no closed surface: every edge must lie between two of them "
                "that run along it in opposite ways"
            )
        return np.ascontiguousarray((met % len(t)).reshape(3, -1).T)

    def at(self, x: np.ndarray) -> Surface:
        """The surface with its nodes at x (n, 3), um."""
        x = _places(x, 3)
        if len(x) <= self.triangles.max():
            raise DimensionError(
                f"triangles name node {self.triangles.max()}, there are {len(x)} nodes"
            )
        face, vertex = np.empty((len(self.triangles), 3)), np.empty((len(x), 3))
        if pseudonormals(x, self.triangles, face, vertex) < 0:
            face, vertex = -face, -vertex
        return Surface(x=x, triangles=self.triangles, across=self.across, face=face, vertex=vertex)


def contour(points: np.ndarray) -> Surface:
    """A closed contour in the plane, as a surface of its own.

    Parameters
    ----------
    points : (n, 2)
        Corners in order, um; the last may repeat the first.

    Raises
    ------
    DimensionError, DataError
        Other shapes, NaN, fewer than three corners, or sides that cross: corners out of order.
    """
    x = _places(points, 2)
    if len(x) > 1 and np.array_equal(x[0], x[-1]):
        x = x[:-1]
    if len(x) < 3:
        raise DataError(f"a contour needs at least three corners, got {len(x)}")
    n = len(x)
    k = np.arange(n)
    side = np.roll(x, -1, axis=0) - x
    length = np.linalg.norm(side, axis=1, keepdims=True)
    crossing = _sides_that_cross(x, side, float(length.max()))
    if crossing is not None:
        raise DataError(
            f"sides {crossing[0]} and {crossing[1]} of the contour cross; give its corners in "
            "order, once around"
        )
    out = np.column_stack([side[:, 1], -side[:, 0]]) / np.where(length > 0, length, 1.0)
    about = x - x.mean(axis=0)
    ahead = np.roll(about, -1, axis=0)
    if np.sum(about[:, 0] * ahead[:, 1] - about[:, 1] * ahead[:, 0]) < 0:
        out = -out
    flat = np.zeros((n, 1))
    face = np.ascontiguousarray(np.hstack([out, flat]))
    return Surface(
        x=np.ascontiguousarray(np.hstack([x, flat])),
        triangles=np.column_stack([k, (k + 1) % n, (k + 1) % n]),
        across=np.repeat(k[:, None], 3, axis=1),
        face=face,
        vertex=face + np.roll(face, 1, axis=0),
    )


def _sides_that_cross(x: np.ndarray, side: np.ndarray, longest: float) -> tuple[int, int] | None:
    """The first two sides of a contour that go through each other, if any do."""
    near = cKDTree(x + 0.5 * side).query_pairs(longest, output_type="ndarray")
    (i, j), (a, b) = near.T, x[near.T]
    u, v, w = side[i], side[j], b - a

    def cross(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]

    # The ends of each on both sides of the other, not on it: neighbours share a corner.
    apart = cross(u, w) * cross(u, w + v) < 0
    apart &= cross(v, -w) * cross(v, u - w) < 0
    found = np.flatnonzero(apart & (np.abs(i - j) > 1) & (np.abs(i - j) < len(x) - 1))
    return (int(i[found[0]]), int(j[found[0]])) if found.size else None


def _places(x: np.ndarray, width: int) -> np.ndarray:
    x = np.ascontiguousarray(x, dtype=float)
    if x.ndim != 2 or x.shape[1] != width:
        raise DimensionError(f"places must be (n, {width}), um, got shape {x.shape}")
    if not np.all(np.isfinite(x)):
        raise DataError("places hold NaN or inf")
    return x


def convex_triangles(x: np.ndarray) -> np.ndarray:
    """Outward triangles (m, 3) of the convex surface through the nodes x (n, 3).

    Raises
    ------
    DataError
        When a node lies inside the others' hull, or all lie in one plane.
    """
    x = _places(x, 3)
    try:
        triangles = ConvexHull(x).simplices.astype(np.int64)
    except (QhullError, ValueError) as error:
        raise DataError(
            f"{len(x)} nodes span no surface: fewer than four, or all in one plane"
        ) from error
    if len(np.unique(triangles)) < len(x):
        raise DataError(
            f"{len(x) - len(np.unique(triangles))} of {len(x)} nodes lie inside the hull of the "
            "others: which triangles they make cannot be told from their places"
        )
    a, b, c = (x[triangles[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c - 3.0 * x.mean(axis=0)) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return triangles[np.lexsort(triangles.T)]


@dataclass(frozen=True, eq=False, kw_only=True)
class Surface:
    """A closed surface, or a contour in a plane, made by `Mesh.at` or `contour`.

    Parameters
    ----------
    x : (n, 3)
        Nodes, um.
    triangles, across : int arrays (m, 3)
        Corners, and the triangles over the edges opposite to them.
    face, vertex : (m, 3), (n, 3)
        Outward normals of the triangles, and their sums by angle at the nodes.
    """

    x: np.ndarray
    triangles: np.ndarray
    across: np.ndarray
    face: np.ndarray
    vertex: np.ndarray

    @cached_property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest coordinates (3,) of the nodes."""
        return self.x.min(axis=0), self.x.max(axis=0)

    @cached_property
    def longest(self) -> float:
        """No point of a triangle is farther than this from its first corner, um."""
        return float(longest_side(self.x, self.triangles))

    @cached_property
    def _pieces(self) -> tuple[np.ndarray, np.ndarray]:
        """Middles of the triangles, and how far their corners are from them."""
        corners = self.x[self.triangles]
        middle = corners.mean(axis=1)
        return middle, np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)

    @cached_property
    def arrays(self) -> tuple[np.ndarray | float, ...]:
        """What the compiled functions take: places, triangles, normals, longest side."""
        return self.x, self.triangles, self.across, self.face, self.vertex, self.longest

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distance (k,) of points (k, 3) to the surface, um, negative inside."""
        share, found = np.empty((2, 3)), np.empty(len(points))
        for i, p in enumerate(_places(points, 3)):
            found[i], _ = signed_distance(p, *self.arrays, share[0], share[1])
        return found

    def inner_points(self) -> np.ndarray:
        """Points (k, 3) on shells between the mean of the nodes and the surface."""
        middle = self.x.mean(axis=0)
        shares = np.arange(SHELLS)[:, None, None] / SHELLS
        return np.ascontiguousarray((middle + shares * (self.x - middle)).reshape(-1, 3))


def box_distance(a: Surface, b: Surface) -> float:
    """Distance of the boxes of two surfaces, um: no more than their gap where it is positive."""
    (low_a, high_a), (low_b, high_b) = a.box, b.box
    return float(np.linalg.norm(np.maximum(np.maximum(low_a - high_b, low_b - high_a), 0.0)))


def gap(a: Surface, b: Surface) -> float:
    """Least distance of two closed surfaces, um, and where they overlap minus the depth.

    The equation is the module's. The least distance is that of the triangles to rounding; a
    KD-tree finds those that can be closest. A depth on the surfaces is found to `DEPTH_TOLERANCE`;
    one that is greater inside, where neither surface passes, is read on `SHELLS` shells of nodes
    and so up to half their spacing too small.
    """
    extent = min(float(np.ptp(s.x, axis=0).max()) for s in (a, b))
    touch = (_TOUCH * extent) ** 2
    rows, columns, lower, best = _near(a, b)
    square = least_square_of_pairs(a.x, a.triangles, b.x, b.triangles, rows, columns, lower, best)
    if square > touch and not _one_in_the_other(a, b):
        return float(np.sqrt(square))
    crossing = np.zeros(len(a.triangles), bool), np.zeros(len(b.triangles), bool)
    mark_crossing(a.x, a.triangles, b.x, b.triangles, rows, columns, touch, *crossing)
    depths = [
        deepest(p.x, p.triangles, through, *q.arrays, DEPTH_TOLERANCE * extent)
        for p, q, through in ((a, b, crossing[0]), (b, a, crossing[1]))
    ]
    inner = np.concatenate([a.inner_points(), b.inner_points()])
    low, high = (f(a.box[k], b.box[k]) for k, f in enumerate((np.maximum, np.minimum)))
    inner = inner[np.all((inner >= low) & (inner <= high), axis=1)]
    return 0.0 - max(*depths, deepest_inside(inner, *a.arrays, *b.arrays))


def _near(a: Surface, b: Surface) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Pairs of triangles that may be closest: of a, of b, least distances in order.

    And the squared distance of the two closest nodes, which is no less.
    """
    best = float(np.min(cKDTree(b.x).query(a.x)[0]))
    (middle_a, size_a), (middle_b, size_b) = a._pieces, b._pieces
    reach = best + float(size_a.max() + size_b.max())
    near = cKDTree(middle_a).sparse_distance_matrix(
        cKDTree(middle_b), reach * (1.0 + 1e-12), output_type="ndarray"
    )
    lower = near["v"] - size_a[near["i"]] - size_b[near["j"]]
    kept = np.flatnonzero(lower <= best)
    order = kept[np.argsort(lower[kept])]
    return near["i"][order], near["j"][order], lower[order], best**2


def _one_in_the_other(a: Surface, b: Surface) -> bool:
    """Whether one of two surfaces that do not cross lies inside the other."""
    if box_distance(a, b) > 0:
        return False
    return bool(b.distance(a.x[:1])[0] < 0 or a.distance(b.x[:1])[0] < 0)
