"""Shape, load port and charges: symmetry, round trips, power."""

import numpy as np
import pytest

import cellsys as cs
from cellsys.cell.charges import TOP, pack, turn, unpack
from cellsys.cell.port import PortSites
from cellsys.cell.shape import ShapeBasis, harmonics
from cellsys.geometry.membrane import sphere

RNG = np.random.default_rng(5)


def basis(degree=10):
    nodes = sphere(8.0, (0.0, 0.0, 8.0)).position
    return ShapeBasis.of(nodes, degree), nodes


def smooth(material, alpha=0.0):
    """A smooth change of shape, turned by alpha: x'(xi) = R x(R^-1 xi)."""
    c, s = np.cos(alpha), np.sin(alpha)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    x, y, z = (material @ R).T
    change = np.stack(
        [0.6 * x * z + 0.3 * x * x, 0.4 * y * z - 0.2 * x * y, 0.5 * x + 0.1 * z * z - 0.4 * x * y],
        axis=-1,
    )
    return change @ R.T


def charges_of(change, shape, nodes):
    _, W, Z = shape.coefficients(nodes + change)
    return {q: pack(W, Z, q) for q in range(TOP + 1)}


@pytest.mark.parametrize("alpha", [0.3, 2.0, -1.1])
def test_charges_turn_by_their_order(alpha):
    """Quadratic fields are inside degree 10, so the law holds to rounding of the fit."""
    shape, nodes = basis()
    before = charges_of(smooth(shape.material), shape, nodes)
    after = charges_of(smooth(shape.material, alpha), shape, nodes)
    for q in range(1, TOP + 1):
        np.testing.assert_allclose(after[q], turn(before[q], q, alpha), atol=1e-12)
    np.testing.assert_allclose(after[0], before[0], atol=1e-12)


def test_mirror_images_are_conjugate():
    shape, nodes = basis()
    mirrored = shape.material * [1, -1, 1]
    change = smooth(mirrored) * [1, -1, 1]
    plain = charges_of(smooth(shape.material), shape, nodes)
    other = charges_of(change, shape, nodes)
    for q in range(TOP + 1):
        np.testing.assert_allclose(other[q], np.conj(plain[q]), atol=1e-12)


def test_fields_of_charges_up_to_five_come_back():
    shape, nodes = basis()
    change = smooth(shape.material)
    centre, W, Z = shape.coefficients(nodes + change)
    packed = {q: pack(W, Z, q) for q in range(TOP + 1)}
    W2, Z2 = unpack(packed, *shape.sizes())
    # swirl (mirror-odd charge 0) is not carried; this field has none
    np.testing.assert_allclose(shape.nodes(centre, W2, Z2), nodes + change, atol=1e-11)


def test_swirl_is_what_is_lost():
    shape, nodes = basis()
    swirl = 0.2 * np.cross([0.0, 0.0, 1.0], shape.material)
    centre, W, Z = shape.coefficients(nodes + swirl)
    W2, Z2 = unpack({q: pack(W, Z, q) for q in range(TOP + 1)}, *shape.sizes())
    np.testing.assert_allclose(shape.nodes(centre, W2, Z2), nodes, atol=1e-11)


def test_harmonics_are_orthonormal():
    """Against Gauss-Legendre times trapezoid, exact for these polynomials."""
    x, w = np.polynomial.legendre.leggauss(12)
    phi = 2 * np.pi * np.arange(24) / 24
    grid = np.array(
        [
            [np.sqrt(1 - c * c) * np.cos(p), np.sqrt(1 - c * c) * np.sin(p), c]
            for c in x
            for p in phi
        ]
    )
    weight = np.repeat(w, 24) * 2 * np.pi / 24
    Y = np.hstack([harmonics(grid, 5, m) for m in range(-5, 6)])
    gram = (np.conj(Y).T * weight) @ Y
    np.testing.assert_allclose(gram, np.eye(36), atol=1e-12)


def port_at(place=(1.0, -2.0)):
    rest = np.column_stack([RNG.uniform(-30, 30, (1500, 2)), np.zeros(1500)])
    rest = rest[np.hypot(*rest[:, :2].T) < 30]
    sites = PortSites.of(rest, np.arange(len(rest)))
    return sites, sites.under(np.array([*place, 0.0]), cs.PolarPort()), rest


def some_load():
    port = cs.PolarPort()
    W, Z = port.sizes()
    rng = np.random.default_rng(1)
    W = {m: rng.standard_normal(n) + 1j * rng.standard_normal(n) for m, n in W.items()}
    Z = {m: rng.standard_normal(n) + 1j * rng.standard_normal(n) for m, n in Z.items()}
    Z[0] = Z[0].real + 0j
    return {q: pack(W, Z, q) for q in port.charges()}


def test_scatter_and_gather_exchange_the_same_power():
    _, under, _ = port_at()
    load = some_load()
    v = RNG.standard_normal((len(under.nodes), 3))
    power = float(np.sum(under.scatter(load) * v))
    y = under.gather(v)
    other = sum(float(np.real(np.vdot(load[q], y[q]))) for q in load)
    assert power == pytest.approx(other, rel=1e-12)


def test_total_force_is_kept_where_plain_areas_lose_it():
    """A radial pull on irregular nodes leaves a net force; the footprint takes it off."""
    _, under, _ = port_at()
    load = some_load()
    wanted = under.port.total(load)
    naive = (under.area[:, None] * under.port.density(under.at, load)).sum(axis=0)
    np.testing.assert_allclose(under.scatter(load).sum(axis=0), wanted, rtol=1e-11, atol=1e-9)
    assert np.linalg.norm(naive - wanted) > 1e-3 * np.linalg.norm(wanted)


def test_areas_fill_the_disc():
    sites, _, rest = port_at()
    radius = np.hypot(*rest[:, :2].T).max()
    assert sites.area.sum() == pytest.approx(np.pi * radius**2, rel=1e-12)


def test_loads_turn_like_charges():
    """The same forces on nodes turned about the port: every charge gains e^{iq alpha}."""
    port, alpha = cs.PolarPort(), 0.7
    offset = RNG.uniform(-10, 10, (60, 2))
    force = RNG.standard_normal((60, 3))
    c, s = np.cos(alpha), np.sin(alpha)
    R = np.array([[c, -s], [s, c]])
    turned = np.column_stack([force[:, :2] @ R.T, force[:, 2]])
    before = port.analyse(port.at(offset), force)
    after = port.analyse(port.at(offset @ R.T), turned)
    for q in range(1, TOP + 1):
        np.testing.assert_allclose(after[q], turn(before[q], q, alpha), atol=1e-11)


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: cs.PolarPort(spacing=0.0), "spacing"),
        (lambda: cs.PolarPort(orders=0), "orders"),
        (lambda: basis(14), "degree"),
        (lambda: cs.Clock(tau=-1.0), "tau"),
        (lambda: cs.Clock(vertices=0), "vertices"),
    ],
)
def test_bad_parameters_are_refused(make, word):
    with pytest.raises(cs.ParameterError, match=word):
        make()


def test_clock_weights_are_convex():
    w = cs.Clock().weights(np.linspace(0.0, 1e5, 1000))
    assert w.min() >= 0
    np.testing.assert_allclose(w.sum(axis=1), 1.0, atol=1e-13)
