"""The gap between closed surfaces and contours, against closed forms and dense sampling.

No reference here uses triangles' distances: convex bodies are known by their support functions,
meshes by points sprinkled over their triangles and by solid angles.
"""

import numpy as np
import pytest
import scipy.optimize as so
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from cellsys.errors import DataError, DimensionError
from cellsys.geometry.membrane import sphere
from cellsys.geometry.surface import Mesh, contour, convex_triangles, gap
from tests.naive_mechanics import gap_along_centres

ANGLE = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)


def turned(points, angle):
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def ellipse(a, b, angle, centre):
    return turned(np.column_stack([a * np.cos(ANGLE), b * np.sin(ANGLE)]), angle) + centre


def surface(points):
    return Mesh(convex_triangles(points)).at(points)


def convex_gap(support, start):
    """max over unit e of c.e - h_A(e) - h_B(-e): the signed distance of two convex bodies.

    Support functions alone: the distance of the origin from the boundary of the difference of the
    two (Cameron & Culley 1986), negative where they overlap. `support(angles)` is its negative.
    """
    grids = np.meshgrid(*[np.linspace(-np.pi, np.pi, 91)] * len(start), indexing="ij")
    values = support(np.stack([g.ravel() for g in grids]))
    best = np.stack([g.ravel() for g in grids])[:, np.argsort(values)[:2]]
    found = [so.minimize(lambda v: float(support(v[:, None])[0]), b, method="Nelder-Mead",
                         options={"xatol": 1e-9, "fatol": 1e-11}).fun for b in best.T]  # fmt: skip
    return -min(found)


def ellipse_support(a, b, angle):
    return lambda e: np.hypot(a * (np.cos(angle) * e[0] + np.sin(angle) * e[1]),
                              b * (-np.sin(angle) * e[0] + np.cos(angle) * e[1]))  # fmt: skip


def gap_of_ellipses(first, second, centre):
    h, k, c = ellipse_support(*first), ellipse_support(*second), np.asarray(centre, float)

    def support(v):
        e = np.array([np.cos(v[0]), np.sin(v[0])])
        return h(e) + k(e) - c @ e

    return convex_gap(support, [0.0])


def test_the_example_of_slanted_ellipses():
    """Half axes 12 and 2 um at 60 degrees, centres 10 um apart: 4.75 um, not -2.49."""
    shape = (12.0, 2.0, np.pi / 3)
    exact = gap_of_ellipses(shape, shape, [10.0, 0.0])
    assert exact == pytest.approx(4.75, abs=0.005)
    a, b = ellipse(*shape, [0, 0]), ellipse(*shape, [10, 0])
    # where the two face each other, sides of 0.19 um lie up to 1e-4 um below the ellipse
    assert gap(contour(a), contour(b)) == pytest.approx(exact, abs=2e-4)
    flat = [np.column_stack([x, np.zeros(len(x))])[None] for x in (a, b)]
    assert gap_along_centres(*flat)[0] == pytest.approx(-2.49, abs=0.005)
    # the same in space: the closest points of equal ellipsoids lie at half height
    ball = sphere(1.0, (0.0, 0.0, 0.0), 1200).position * [12.0, 2.0, 3.0]
    ball[:, :2] = turned(ball[:, :2], np.pi / 3)
    found = gap(surface(ball), surface(ball + [10.0, 0.0, 0.0]))
    # facets of 0.1 by 1 um lie below the ellipsoid by up to 0.04 um on either side
    assert exact <= found <= exact + 0.1


def test_random_ellipses():
    rng = np.random.default_rng(3)
    apart, over = 0, 0
    while apart < 8 or over < 4:
        first, second = (
            (*np.sort(rng.uniform(2.0, 7.0, 2))[::-1], rng.uniform(0, np.pi)) for _ in "ab"
        )
        centre = rng.uniform(-14, 14, 2)
        exact = gap_of_ellipses(first, second, centre)
        # deeper, and a middle may lie in the other ellipse, where the two depths differ
        if exact < -0.2 * min(p[1] ** 2 / p[0] for p in (first, second)):
            continue
        a, b = ellipse(*first, [0, 0]), ellipse(*second, centre)
        found = gap(contour(a), contour(b))
        # sides lie up to 3e-3 um below the ellipse; depths are read to 1e-3 of the extent
        assert found == pytest.approx(exact, abs=0.018)
        apart, over = apart + (exact > 0), over + (exact < 0)
        assert gap(contour(b[::-1]), contour(a)) == pytest.approx(found, abs=0.015)


@pytest.mark.parametrize(
    ("r", "s", "distance"),
    [(5, 5, 30), (5, 3, 8.2), (5, 5, 10), (5, 3, 7), (5, 5, 6), (5, 5, 0), (8, 2, 0), (8, 2, 5),
     (8, 2, 6), (8, 2, 8), (8, 2, 10)],
)  # fmt: skip
def test_spheres(r, s, distance):
    """Apart, tangent, overlapping, nested, concentric: c - r - s, and -max(r, s) at most."""
    a = sphere(r, (0.0, 0.0, 0.0), 400).mesh.at(sphere(r, (0.0, 0.0, 0.0), 400).position)
    way = distance * np.array([0.6, 0.64, 0.48])
    inner = sphere(s, tuple(way), 400)
    exact = max(distance - r - s, -max(r, s))
    # a facet of a sphere of 400 nodes lies up to 0.01 of its radius below it
    assert exact - 1e-9 <= gap(a, inner.mesh.at(inner.position)) <= exact + 0.01 * (r + s)


def test_boxes_are_exact():
    """Faces, edges and corners that face each other, parallel triangles among them."""
    cube = Mesh(convex_triangles(CUBE + 1e-13 * np.random.default_rng(0).normal(size=(8, 3))))
    a = cube.at(CUBE)
    for shift in ([3, 0.2, -0.4], [0, 0, 1.5], [2, 3, 0], [2, 3, 4], [-2, 0.5, 5], [1, 0, 0]):
        apart = np.maximum(np.abs(shift) - 1.0, 0.0)
        assert gap(a, cube.at(CUBE + shift)) == pytest.approx(np.linalg.norm(apart), abs=1e-12)
    # overlapping along one axis by 0.25; 2 in 10 and at its middle
    assert gap(a, cube.at(CUBE + [0.75, 0.3, 0.1])) == pytest.approx(-0.25, abs=1e-3)
    big = cube.at(10.0 * CUBE)
    assert gap(big, cube.at(CUBE + [2.0, 4.0, 4.0])) == pytest.approx(-3.0, abs=1e-3)
    assert gap(a, a) == pytest.approx(-0.5, abs=1e-3)
    # an edge of a cube on its edge over a face, and over an edge across it
    roof = (CUBE - 0.5) @ Rotation.from_euler("x", 45, degrees=True).as_matrix().T
    half = np.sqrt(0.5)
    assert gap(a, cube.at(roof + [0.5, 0.5, 1.3 + half])) == pytest.approx(0.3, abs=1e-12)
    ridge = (CUBE - 0.5) @ Rotation.from_euler("y", 45, degrees=True).as_matrix().T
    found = gap(cube.at(roof), cube.at(ridge + [0.0, 0.0, 2 * half + 0.2]))
    assert found == pytest.approx(0.2, abs=1e-12)


def bumpy(rng, radius, centre, n=189):
    """A membrane that is not convex: bumps of 30 % over a sphere."""
    shape = sphere(1.0, (0.0, 0.0, 0.0), n)
    u = shape.position
    height = sum(0.12 * np.cos(u @ rng.normal(size=3) * 4.0 + rng.uniform(0, 6)) for _ in "abcd")
    x = radius * (1.0 + height + 0.05 * rng.normal(size=n))[:, None] * u
    return x + centre, shape.mesh


def sprinkled(x, triangles, m=11):
    """Points (k, 3) over the triangles, and how far no point of one is from the next."""
    shares = np.array([(i, j, m - i - j) for i in range(m + 1) for j in range(m + 1 - i)]) / m
    corners = x[triangles]
    side = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
    return np.einsum("sk,tkm->tsm", shares, corners).reshape(-1, 3), 0.6 * side / m


def winding(points, x, triangles):
    """Solid angle of a surface seen from points over 4 pi (Van Oosterom & Strackee 1983)."""
    r = x[triangles][None] - points[:, None, None]
    size = np.linalg.norm(r, axis=3)
    top = np.einsum("pti,pti->pt", r[:, :, 0], np.cross(r[:, :, 1], r[:, :, 2]))
    dots = [np.einsum("pti,pti->pt", r[:, :, i], r[:, :, j]) * size[:, :, 3 - i - j]
            for i, j in ((0, 1), (1, 2), (2, 0))]  # fmt: skip
    return np.arctan2(top, size.prod(axis=2) + sum(dots)).sum(axis=1) / (2.0 * np.pi)


@pytest.mark.parametrize("seed", range(3))
def test_a_point_is_inside_where_its_solid_angle_says_so(seed):
    """Sharp bumps and dents, points near corners and edges among them."""
    rng = np.random.default_rng(seed)
    x, mesh = bumpy(rng, 5.0, np.zeros(3))
    found = mesh.at(x)
    on = sprinkled(x, mesh.triangles, 3)[0]
    points = np.concatenate([on + 0.05 * rng.normal(size=on.shape), rng.uniform(-7, 7, (300, 3))])
    d = found.distance(points)
    inside = winding(points, x, mesh.triangles) > 0.5
    clear = np.abs(d) > 1e-9
    assert np.array_equal(d[clear] < 0, inside[clear])
    dense, spacing = sprinkled(x, mesh.triangles, 40)
    off = cKDTree(dense).query(points)[0]
    assert np.all(np.abs(d) <= off + 1e-12)
    assert np.all(off <= np.hypot(np.abs(d), spacing))
    # which way the triangles run does not matter
    back = Mesh(mesh.triangles[:, ::-1]).at(x)
    np.testing.assert_allclose(back.distance(points), d, atol=1e-12)


def sampled_gap(x, y, triangles):
    """The gap of two meshes and how far sampling may be off, by points alone."""
    (p, h), (q, k) = (sprinkled(v, triangles, 10) for v in (x, y))
    trees = cKDTree(p), cKDTree(q)
    depths = [0.0]
    for points, other, tree in ((p, y, trees[1]), (q, x, trees[0])):
        low, high = other.min(axis=0), other.max(axis=0)
        points = points[np.all((points > low) & (points < high), axis=1)][::2]
        inside = points[winding(points, other, triangles) > 0.5] if len(points) else points
        if len(inside):
            depths.append(tree.query(inside)[0].max())
    if max(depths) > 0:
        return -max(depths), 3 * max(h, k)
    return trees[1].query(p)[0].min(), h + k


@pytest.mark.parametrize("seed", range(4))
def test_membranes_that_are_not_convex(seed):
    rng = np.random.default_rng(seed)
    (x, mesh), (y, _) = bumpy(rng, 5.0, np.zeros(3)), bumpy(rng, 4.0, rng.normal(size=3))
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)
    for far in (12.0, 9.5, 8.0):
        z = y + far * way
        found = gap(mesh.at(x), mesh.at(z))
        wanted, off = sampled_gap(x, z, mesh.triangles)
        assert found == pytest.approx(wanted, abs=off)
        assert found * wanted > 0 or abs(wanted) < off
    # the same wherever and however the two lie
    turn, shift = Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3)
    moved = [mesh.at(v @ turn.T + shift) for v in (x, z)]
    assert gap(*moved) == pytest.approx(found, abs=1e-9 if found > 0 else 0.012)
    assert gap(*moved[::-1]) == pytest.approx(found, abs=1e-9 if found > 0 else 0.012)


def test_the_gap_moves_no_faster_than_the_cell():
    """Through contact and into the other: continuous, and falling while the cells close in."""
    rng = np.random.default_rng(8)
    (x, mesh), (y, _) = bumpy(rng, 5.0, np.zeros(3)), bumpy(rng, 4.0, np.zeros(3))
    steps = np.arange(11.0, 6.0, -0.25)
    found = np.array([gap(mesh.at(x), mesh.at(y + [d, 0.0, 0.0])) for d in steps])
    assert found[0] > 0 > found[-1]
    # depths are read to 1e-3 of the extent, and between shells to half their spacing
    assert np.abs(np.diff(found)).max() <= 0.25 + 0.02
    assert np.all(np.diff(found)[found[1:] > -1.0] < 0.01)


def test_what_is_no_closed_surface_is_refused():
    shape = sphere(1.0, (0.0, 0.0, 0.0), 30)
    for wrong, words in (
        (shape.triangles[1:], "no closed surface"),
        (np.concatenate([shape.triangles, shape.triangles[:1]]), "no closed surface"),
        (np.concatenate([shape.triangles[1:], shape.triangles[:1, ::-1]]), "no closed surface"),
        (np.zeros((0, 3), int), "no closed surface"),
        (shape.triangles - 1, "count from 0"),
    ):
        with pytest.raises(DataError, match=words):
            Mesh(wrong)
    with pytest.raises(DimensionError, match=r"whole numbers \(m, 3\)"):
        Mesh(shape.triangles[:, :2])
    with pytest.raises(DimensionError, match="name node 29, there are 29 nodes"):
        shape.mesh.at(shape.position[:-1])
    with pytest.raises(DataError, match="NaN"):
        shape.mesh.at(np.full((30, 3), np.nan))
    with pytest.raises(DataError, match="three corners"):
        contour([[0, 0], [1, 0], [0, 0]])
    with pytest.raises(DimensionError, match=r"\(n, 2\)"):
        contour(np.zeros((4, 3)))
    with pytest.raises(DataError, match="sides 0 and 2 of the contour cross"):
        contour([[0, 0], [2, 2], [2, 0], [0, 2]])
    rng = np.random.default_rng(0)
    with pytest.raises(DataError, match="cross; give its corners in order"):
        contour(rng.permutation(ellipse(5.0, 2.0, 0.3, [0, 0])))
    star = ellipse(5.0, 5.0, 0.0, [0, 0]) * (1 + 0.5 * np.sin(9 * ANGLE))[:, None]
    assert gap(contour(star), contour(star[::-1] + [20.0, 0.0])) > 3
    with pytest.raises(DataError, match="1 of 31 nodes lie inside"):
        convex_triangles(np.concatenate([shape.position, np.zeros((1, 3))]))
    with pytest.raises(DataError, match="one plane"):
        convex_triangles(np.column_stack([shape.position[:, :2], np.zeros(30)]))
