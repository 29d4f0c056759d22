"""The gap of two cells: slender, slanted, tangent, nested, meshes with dents, contours.

The reference of convex bodies is their support functions, of others points sprinkled over their
triangles; neither knows the distance of triangles.
"""

import numpy as np
import pytest
import scipy.optimize as so
from scipy.spatial.transform import Rotation

from cellsys.geometry.membrane import sphere
from cellsys.geometry.surface import Mesh, contour, gap
from tests.geometry.test_surface import bumpy, gap_of_ellipses, sampled_gap
from tests.hard.stress import SEED, Case, Choice, Real, hold
from tests.naive_mechanics import gap_along_centres

BALL = sphere(1.0, (0.0, 0.0, 0.0), 300)
# How far the facets of the unit sphere lie below it; of an ellipsoid times its longest half axis.
CORNERS = BALL.position[BALL.triangles]
NORMALS = np.cross(CORNERS[:, 1] - CORNERS[:, 0], CORNERS[:, 2] - CORNERS[:, 0])
HEIGHTS = np.einsum("ij,ij->i", NORMALS, CORNERS[:, 0]) / np.linalg.norm(NORMALS, axis=1)
SAG = float(1.0 - HEIGHTS.min())


def signed_distance_of_ellipsoids(A, B, c):
    """max over unit e of c.e - |A'e| - |B'e|: of the origin to the difference of the two bodies."""

    def support(v):
        e = np.array([np.cos(v[0]) * np.cos(v[1]), np.sin(v[0]) * np.cos(v[1]), np.sin(v[1])])
        return np.linalg.norm(A.T @ e, axis=0) + np.linalg.norm(B.T @ e, axis=0) - c @ e

    grid = np.stack(np.meshgrid(np.linspace(-np.pi, np.pi, 61), np.linspace(-1.57, 1.57, 31)))
    grid = grid.reshape(2, -1)
    best = grid[:, np.argsort(support(grid))[:4]].T
    options = {"xatol": 1e-7, "fatol": 1e-9}
    return -min(
        so.minimize(lambda v: float(support(v[:, None])[0]), b, method="Nelder-Mead",
                    options=options).fun
        for b in best
    )  # fmt: skip


def ellipsoids(seed, slender, distance, twins):
    """Two ellipsoids as matrices that make them of the unit ball, and where the second lies."""
    rng = np.random.default_rng(seed)
    bodies = []
    for _ in range(2):
        axes = np.array([12.0 * rng.uniform(0.5, 1.0), slender, slender * rng.uniform(1.0, 2.0)])
        bodies.append(Rotation.random(random_state=int(rng.integers(2**31))).as_matrix() * axes)
    way = rng.normal(size=3)
    return bodies[0], bodies[0] if twins else bodies[1], distance * way / np.linalg.norm(way)


def the_gap_is_that_of_the_bodies(seed, slender, distance, twins):
    """Apart: the distance; over one another: no deeper than the least shift that parts them."""
    A, B, c = ellipsoids(seed, slender, distance, twins)
    exact = signed_distance_of_ellipsoids(A, B, c)
    a, b = BALL.mesh.at(BALL.position @ A.T), BALL.mesh.at(BALL.position @ B.T + c)
    found = gap(a, b)
    # facets below both bodies, and depths that are read to 1e-3 of the extent
    off = SAG * (np.linalg.norm(A, 2) + np.linalg.norm(B, 2)) + 0.03
    if exact > 0:
        assert exact - 1e-6 <= found <= exact + off
    else:
        assert exact - 0.03 <= found
        assert found <= max(0.0, exact + off) or exact < -off
        assert found < 0 or exact > -off
    assert gap(b, a) == pytest.approx(found, abs=0.03)


def slanted_contours_keep_their_distance(seed, slender, distance):
    rng = np.random.default_rng(seed)
    angles, centre = rng.uniform(0, np.pi, 2), rng.uniform(-1, 1, 2)
    centre *= distance / np.linalg.norm(centre)
    shapes = [(10.0, slender, angles[0]), (8.0, 1.5 * slender, angles[1])]
    exact = gap_of_ellipses(*shapes, centre)
    turn = np.linspace(0, 2 * np.pi, 600, endpoint=False)
    corners = []
    for (a, b, angle), at in zip(shapes, ([0.0, 0.0], centre), strict=True):
        local = np.column_stack([a * np.cos(turn), b * np.sin(turn)])
        cos, sin = np.cos(angle), np.sin(angle)
        corners.append(local @ np.array([[cos, sin], [-sin, cos]]) + at)
    found = gap(contour(corners[0]), contour(corners[1]))
    if exact > 0:
        assert found == pytest.approx(exact, abs=1e-3)  # sides of 0.1 um below the ellipse
    else:
        assert exact - 0.03 <= found < 1e-3


def dented_membranes(seed, distance):
    """Meshes that are not convex, by points alone; and as smooth as the motion."""
    rng = np.random.default_rng(seed)
    (x, mesh), (y, _) = bumpy(rng, 5.0, np.zeros(3), 120), bumpy(rng, 3.5, np.zeros(3), 120)
    way = rng.normal(size=3)
    y = y + distance * way / np.linalg.norm(way)
    found = gap(mesh.at(x), mesh.at(y))
    wanted, off = sampled_gap(x, y, mesh.triangles)
    if wanted > -2.0:  # deeper, it may be deepest where no sprinkled point is: inside
        assert found == pytest.approx(wanted, abs=off + 0.02)
    else:
        assert found < wanted + off
    step = 0.1 * rng.normal(size=3)
    moved = gap(mesh.at(x), mesh.at(y + step))
    inside = 1.0 if min(found, moved) < -1.5 else 0.0  # between shells
    assert abs(moved - found) <= np.linalg.norm(step) + 0.03 + inside


def flat_and_sharp(seed, kind, amount):
    """Boxes thinner than a hair and needles: finite, symmetric, and right along their axes."""
    rng = np.random.default_rng(seed)
    box = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    square = [(0, 1, 3), (0, 3, 2), (4, 7, 5), (4, 6, 7), (0, 5, 1), (0, 4, 5), (2, 3, 7),
              (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]  # fmt: skip
    mesh = Mesh(np.array(square))
    size = {"box": [1, 1, 1], "sheet": [10, 10, amount], "needle": [10, amount, amount]}[kind]
    a = box * size
    shift = np.where(rng.uniform(size=3) < 0.5, -1, 1) * (rng.uniform(0.1, 5, 3) + size)
    keep = rng.uniform(size=3) < 0.6
    shift = np.where(keep, shift, rng.uniform(-0.9, 0.9, 3) * size)
    apart = np.maximum(np.abs(shift) - size, 0.0)
    found = gap(mesh.at(a), mesh.at(a + shift))
    if apart.any():
        assert found == pytest.approx(np.linalg.norm(apart), abs=1e-9)
    else:
        assert -np.min(np.abs(np.array(size) - np.abs(shift))) - 0.02 <= found < 0.02


def test_along_the_line_of_the_centres_slender_cells_overlap():
    """Naive: distance of the centres less the two reaches. Ours is held to the bodies' above."""
    off = []
    for seed in range(6):
        A, B, c = ellipsoids(seed, 1.0, 14.0, False)
        a, b = BALL.position @ A.T, BALL.position @ B.T + c
        naive = gap_along_centres(a[None], b[None])[0]
        off.append(signed_distance_of_ellipsoids(A, B, c) - naive)
    assert np.median(off) > 1.0


CASES = (
    Case(
        "gap of cells",
        the_gap_is_that_of_the_bodies,
        {"seed": SEED, "slender": Real(0.5, 8), "distance": Real(0, 30),
         "twins": Choice(False, True)},
    ),
    Case(
        "gap of contours",
        slanted_contours_keep_their_distance,
        {"seed": SEED, "slender": Real(0.5, 6), "distance": Real(0, 25)},
    ),
    Case("gap of dented cells", dented_membranes, {"seed": SEED, "distance": Real(4, 14)}),
    Case(
        "gap of flat cells",
        flat_and_sharp,
        {"seed": SEED, "kind": Choice("box", "sheet", "needle"), "amount": Real(1e-3, 1)},
    ),
)  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_random_instances(case):
    hold(case, 2)
