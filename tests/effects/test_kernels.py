"""Every compiled loop against a plain numpy version written here, at random states."""

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from scipy.spatial.transform import Rotation

from cellsys.effects import clutch_kernels as clutch_loops
from cellsys.effects.fibre_kernels import fibre_energy, fibre_forces, fibre_slopes
from cellsys.effects.footing import SurfaceBins, rim_factor
from cellsys.effects.membrane import area_forces, line_forces
from cellsys.effects.switching import bind_nearest, cluster_loads
from cellsys.errors import DataError
from cellsys.geometry.membrane import enclosed_volume, sphere, volume_gradient
from cellsys.laws.fibre import axial, axial_energy
from cellsys.mechanics.cholesky import SparseCholesky
from tests.mechanics.scenes import clutch, switching

# Both sides do the same few dozen operations in another order.
CLOSE = {"rtol": 1e-12, "atol": 1e-10}


def scattered(a, n, index, value):
    out = np.zeros((n, value.shape[1]))
    np.add.at(out, index, value)
    return a + out


@pytest.fixture(params=[0, 1, 2])
def mesh(request):
    """A membrane and disturbed positions."""
    rng = np.random.default_rng(request.param)
    membrane = sphere(8.0, (1.0, -2.0, 8.0))
    x = membrane.position * rng.uniform(0.6, 1.4, 3) + 0.2 * rng.standard_normal((189, 3))
    return membrane, x


def test_line_forces(mesh):
    membrane, x = mesh
    k, cubic, rest = 100.0, 2.0, membrane.edge_length
    i, j = membrane.edges.T
    d = x[j] - x[i]
    length = np.sqrt((d**2).sum(1) + 1e-6)
    s = length - rest
    c = cubic / rest**2
    f = (k * s * (1 + c * s**2) / length)[:, None] * d
    expected = scattered(scattered(0.0, 189, i, f), 189, j, -f)
    force = np.zeros((189, 3))
    energy = line_forces(x, membrane.edges, rest, k, cubic, force)
    assert np.allclose(force, expected, **CLOSE)
    assert energy == pytest.approx((0.5 * k * s**2 + 0.25 * k * c * s**4).sum(), rel=1e-12)


@pytest.mark.parametrize(("stiffness", "tension"), [(50.0, 0.0), (0.0, 150.0), (50.0, 150.0)])
def test_area_forces(mesh, stiffness, tension):
    membrane, x = mesh
    rest = membrane.triangle_area
    a, b, c = (x[membrane.triangles[:, q]] for q in range(3))
    normal = np.cross(b - a, c - a)
    double = np.sqrt((normal**2).sum(1) + 1e-6)
    J = 0.5 * double / rest
    h = np.where(J >= 1, 0.5 * (J - 1) ** 2, 0.5 * (1 / J - 1) ** 2)
    slope = np.where(J >= 1, J - 1, (1 / J - 1) * (-1 / J**2))
    pull = (stiffness * slope + tension)[:, None]
    unit = normal / double[:, None]
    expected = np.zeros((189, 3))
    for corner, edge in ((0, c - b), (1, a - c), (2, b - a)):
        gradient = 0.5 * np.cross(unit, edge)
        np.add.at(expected, membrane.triangles[:, corner], -pull * gradient)
    force = np.zeros((189, 3))
    energy = area_forces(x, membrane.triangles, rest, stiffness, tension, force)
    assert np.allclose(force, expected, **CLOSE)
    assert energy == pytest.approx((rest * (stiffness * h + tension * J)).sum(), rel=1e-12)


def test_volume_and_its_gradient(mesh):
    membrane, x = mesh
    gradient = np.empty((189, 3))
    volume = volume_gradient(x, membrane.triangles, gradient)
    assert volume == pytest.approx(enclosed_volume(x, membrane.triangles), rel=1e-12)
    expected, h = np.zeros((189, 3)), 1e-3
    for node in range(0, 189, 20):
        for axis in range(3):
            moved = [x.copy(), x.copy()]
            moved[0][node, axis] += h
            moved[1][node, axis] -= h
            # The volume is cubic in positions, linear in each coordinate: exact but for rounding.
            up, down = (enclosed_volume(m, membrane.triangles) for m in moved)
            expected[node, axis] = (up - down) / (2 * h)
            assert gradient[node, axis] == pytest.approx(expected[node, axis], abs=1e-8)
    turn = Rotation.from_euler("xyz", [0.3, 1.0, -2.0]).as_matrix()
    assert enclosed_volume(x @ turn.T + 5.0, membrane.triangles) == pytest.approx(volume, rel=1e-12)


@pytest.mark.parametrize("name", ["linear", "buckling", "stiffening"])
def test_fibre_loops(name):
    law = {
        "linear": (1.0, 0.002, 1e30, 0.0),
        "buckling": (0.3, 0.002, 1e30, 9.0),
        "stiffening": (0.3, 0.002, 0.05, 9.0),
    }[name]
    disc = clutch().matrix
    rng = np.random.default_rng(0)
    u = 0.2 * rng.standard_normal(disc.position.shape)
    i, j = disc.fibres.T
    d = disc.position[j] + u[j] - disc.position[i] - u[i]
    length = np.sqrt((d**2).sum(1) + 1e-12)
    g, s = axial((length - disc.length) / disc.length, *law)
    tension = disc.stiffness * disc.length * g
    f = (tension / length)[:, None] * d
    n = len(u)
    expected = scattered(scattered(0.0, n, i, f), n, j, -f)
    force, slope, pull = np.zeros((n, 3)), np.empty(len(i)), np.empty(len(i))
    arguments = (disc.position, u, disc.fibres, disc.length, disc.stiffness, *law)
    fibre_forces(*arguments, force)
    fibre_slopes(*arguments, slope, pull)
    assert np.allclose(force, expected, rtol=1e-12, atol=1e-8)
    assert np.allclose(slope, s, **CLOSE)
    assert np.allclose(pull, tension, rtol=1e-12, atol=1e-8)
    strain = length / disc.length - 1.0
    stored = (disc.stiffness * disc.length**2) @ axial_energy(strain, *law)
    assert fibre_energy(*arguments) == pytest.approx(stored, rel=1e-12)


@pytest.fixture(params=[0, 1])
def bonds(request):
    """Random clutch states above the small disc, part of the cell beyond its edge."""
    disc = clutch().matrix
    rng = np.random.default_rng(request.param)
    x = np.column_stack([rng.uniform(-19, 19, (189, 2)), rng.uniform(-0.5, 4.0, 189)])
    u = 0.1 * rng.standard_normal(disc.position.shape)
    n, stretch = rng.uniform(0, 1, 189), 0.1 * rng.standard_normal((189, 2))
    return disc, x, u, n, stretch


def dense_weights(disc, x, reach):
    """(189, nodes) weights by all pairs."""
    offset = disc.position[disc.surface][None, :, :2] - x[:, None, :2]
    q = np.clip(1.0 - (offset**2).sum(2) / reach**2, 0.0, None) ** 3
    total = q.sum(1, keepdims=True)
    full = np.zeros((len(x), len(disc.position)))
    full[:, disc.surface] = np.divide(q, total, out=np.zeros_like(q), where=total > 0)
    return full


@pytest.mark.parametrize("reach", [1.0, 3.0, 7.0])
def test_weights_by_bins_are_the_weights_of_all_pairs(bonds, reach):
    disc, x, *_ = bonds
    index, weight, count = SurfaceBins(disc, reach).weights(x)
    found = np.zeros((len(x), len(disc.position)))
    for i in range(len(x)):
        found[i, index[i, : count[i]]] = weight[i, : count[i]]
    assert np.allclose(found, dense_weights(disc, x, reach), rtol=1e-12, atol=1e-15)
    assert (count == 0).any() == (dense_weights(disc, x, reach).sum(1) == 0).any()


def test_clutch_loads_and_gather(bonds):
    disc, x, u, n, stretch = bonds
    W = dense_weights(disc, x, 3.0)
    held = W.sum(1) > 0
    gap = x[:, 2] - W @ u[:, 2]
    on_cell = np.column_stack([2000.0 * stretch, -500.0 * n * gap]) * held[:, None]
    index, weight, count = SurfaceBins(disc, 3.0).weights(x)
    cell, matrix = np.zeros_like(x), np.zeros_like(u)
    hold = np.ones(len(x))
    clutch_loops.clutch_loads(
        x, u, n, stretch, index, weight, count, hold, 2000.0, 500.0, cell, matrix
    )
    assert np.allclose(cell, on_cell, **CLOSE)
    assert np.allclose(matrix, -W.T @ on_cell, **CLOSE)
    out = np.empty((len(x), 2))
    clutch_loops.gather(u, index, weight, count, out)
    assert np.allclose(out, (W @ u)[:, :2], **CLOSE)
    u_end, x_end = u + 0.1 * u[::-1], x + 0.1 * x[::-1]
    clutch_loops.slip(u, u_end, x, x_end, index, weight, count, hold, 0.5, out)
    assert np.allclose(out, ((W @ (u_end - u) - (x_end - x)) / 0.5)[:, :2], **CLOSE)


NUMBERS = 600.0, 0.004  # F_b, v_m


def numbers(stretch):
    """Arguments of the clutch's loops from the load on: by its own loop, beside the oracle's."""
    load = np.empty(len(stretch))
    clutch_loops.own_loads(stretch, 2000.0, load)
    assert np.allclose(load, 2000.0 * np.linalg.norm(stretch, axis=1), **CLOSE)
    return load, np.full(len(stretch), 0.025), *NUMBERS


def on_rates(x, rim):
    """By its own loop, beside the oracle's."""
    on = np.empty(len(x))
    clutch_loops.binding_rates(x, rim, 0.1, 0.9, 0.2, on)
    assert np.allclose(on, rim * 0.1 / (1 + np.exp((x[:, 2] - 0.9) / 0.2)), **CLOSE)
    return on


def clutch_oracle(x, n, stretch, slip):
    axes = stretch.shape[1]
    load = 2000.0 * np.linalg.norm(stretch, axis=1)
    off = 0.025 * (1 + (load / ((n + 0.02) * 600.0)) ** 2)
    away = x[:, :axes] - x[:, :axes].mean(0)
    away /= np.sqrt((away**2).sum(1) + 1e-12)[:, None]
    drive = n[:, None] * (slip + 0.004 * away)
    return off, drive


@pytest.mark.parametrize("axes", [2, 3])
def test_clutch_rates(bonds, axes):
    disc, x, _, n, stretch = bonds
    stretch = np.hstack([stretch, stretch[:, :1]])[:, :axes].copy()
    on = on_rates(x, rim_factor(x, disc.radius))
    slip = 0.01 * np.random.default_rng(3).standard_normal((189, axes))
    off, drive = clutch_oracle(x, n, stretch, slip)
    n_rate, s_rate = np.empty(189), np.empty((189, axes))
    clutch_loops.clutch_rates(x, n, stretch, on, slip, *numbers(stretch), n_rate, s_rate)
    assert np.allclose(n_rate, on * (1 - n) - off * n, **CLOSE)
    assert np.allclose(s_rate, drive - off[:, None] * stretch, **CLOSE)


@pytest.mark.parametrize("axes", [2, 3])
def test_clutch_advance_is_the_exact_solution_at_frozen_rates(bonds, axes):
    disc, x, _, n, stretch = bonds
    stretch = np.hstack([stretch, stretch[:, :1]])[:, :axes].copy()
    on = on_rates(x, rim_factor(x, disc.radius))
    slip = 0.01 * np.random.default_rng(3).standard_normal((189, axes))
    off, drive = clutch_oracle(x, n, stretch, slip)
    for dt in (1e-6, 0.5, 100.0):
        n_new, s_new = np.empty(189), np.empty((189, axes))
        arguments = (x, n, stretch, on, slip, dt, n, *numbers(stretch), n_new, s_new)
        clutch_loops.clutch_advance(*arguments)
        rest = on / (on + off)
        assert np.allclose(n_new, rest + (n - rest) * np.exp(-(on + off) * dt), **CLOSE)
        # Drive is linear in n; the step uses the mean of n at its two ends.
        share = 0.5 * (n + n_new) / n
        still = (drive / off[:, None]) * share[:, None]
        expected = still + (stretch - still) * np.exp(-off * dt)[:, None]
        # (1 - exp(-a))/a loses digits for small a: 1e-16/(off dt) of the gain, times dt.
        assert np.allclose(s_new, expected, rtol=1e-9, atol=1e-12)
        assert np.all((n_new >= 0) & (n_new <= 1))


def test_rim_factor_falls_from_one_to_zero():
    r = np.linspace(0, 20, 401)
    x = np.column_stack([r, 0 * r, 0 * r])
    f = rim_factor(x, 17.0)
    assert np.all(f[r < 0.86 * 17.0 - 1e-9] == 1)
    assert np.all(f[r >= 0.9 * 17.0] == 0)
    assert np.all(np.diff(f) <= 0)


def test_cluster_loads(bonds):
    disc, x, u, *_ = bonds
    rng = np.random.default_rng(5)
    partner = np.full(189, -1.0)
    chosen = rng.choice(189, 60, replace=False)
    partner[chosen] = rng.choice(disc.surface, 60, replace=False)
    number, length = 50 * rng.uniform(-0.1, 1, 189), rng.uniform(0, 30, 189)
    cell, matrix = np.zeros_like(x), np.zeros_like(u)
    energy = cluster_loads(x, disc.position, u, number, length, partner, 40.0, cell, matrix)
    j = partner[chosen].astype(int)
    d = disc.position[j] + u[j] - x[chosen]
    L = np.linalg.norm(d, axis=1)
    stretch = np.maximum(L - length[chosen], 0)
    n = np.maximum(number[chosen], 0)
    f = (40.0 * n * stretch / L)[:, None] * d
    expected = np.zeros_like(cell)
    expected[chosen] = f
    assert np.allclose(cell, expected, **CLOSE)
    expected = np.zeros_like(matrix)
    np.add.at(expected, j, -f)
    assert np.allclose(matrix, expected, **CLOSE)
    assert energy == pytest.approx((20.0 * n * stretch**2).sum(), rel=1e-11)


def test_binding_takes_the_nearest_free_node_once():
    disc, rng = switching().matrix, np.random.default_rng(6)
    x = np.column_stack([rng.uniform(-12, 12, (189, 2)), rng.uniform(0, 1.0, 189)])
    u = 0.1 * rng.standard_normal(disc.position.shape)
    partner = np.full(189, -1.0)
    partner[:20] = disc.surface[:20]
    taken = np.zeros(len(u), bool)
    taken[disc.surface[:20]] = True
    drawn, chance, reach, rim = rng.random(189), 0.6, 1.5, 10.0
    expected, left = np.full(189, -1.0), ~taken
    now = disc.position + u
    for i in range(189):
        if partner[i] >= 0 or drawn[i] >= chance or np.hypot(*x[i, :2]) > rim:
            continue
        free = disc.surface[left[disc.surface]]
        d = np.linalg.norm(now[free] - x[i], axis=1)
        if d.min() <= reach:
            expected[i] = free[d.argmin()]
            left[free[d.argmin()]] = False
    found = np.empty((189, 2))
    surface = disc.surface.astype(np.int64)
    bind_nearest(x, disc.position, u, surface, partner, taken, drawn, chance, reach, rim, found)
    assert np.array_equal(found[:, 0], expected)
    new = expected >= 0
    assert new.sum() >= 10
    assert len(np.unique(expected[new])) == new.sum()
    L = np.linalg.norm(now[expected[new].astype(int)] - x[new], axis=1)
    assert found[new, 1] == pytest.approx(L, abs=1e-9)


# Sparse Cholesky


def spd(n, seed, density=None):
    """A random sparse symmetric positive definite matrix, often of several separate parts."""
    rng = np.random.default_rng(seed)
    b = sp.random_array((n, n), density=min(1.0, density or 1.5 / n), rng=rng)
    return sp.csc_array(b @ b.T + 0.1 * sp.eye_array(n))


@pytest.mark.parametrize("n", [1, 2, 7, 40, 150])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_sparse_cholesky_solves(n, seed):
    matrix = spd(n, seed)
    rhs = np.random.default_rng(seed).standard_normal((n, 2))
    solve = SparseCholesky()(matrix)
    expected = np.linalg.solve(matrix.toarray(), rhs)
    # Backward stable: rounding times the condition number, which is below 1e4 here.
    assert np.allclose(solve(rhs), expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
    assert np.array_equal(solve(rhs)[:, 1], solve(np.ascontiguousarray(rhs[:, 1])))


def test_sparse_cholesky_of_the_disc_agrees_with_superlu_and_stores_half():
    system = clutch()
    x = system.x0
    (block,) = (b for b in system.majorant(0.0, x, 0.5) if b.name == "matrix.xyz coupled")
    moving = np.isfinite(system.drag()[block.entries[:, 0]])
    matrix = sp.csc_array((block.matrix() + 2000.0 * sp.eye_array(len(moving)))[moving][:, moving])
    rhs = np.random.default_rng(0).standard_normal(matrix.shape[0])
    solve = block.factor(matrix)
    lu = spla.splu(
        sp.csc_matrix(matrix),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    # Condition number about 100.
    assert np.allclose(solve(rhs), lu.solve(rhs), rtol=0, atol=1e-12 * np.abs(rhs).max())
    a = solve.analysis
    assert a.panel_at[-1] + a.corner_at[-1] < 0.7 * (lu.L.nnz + lu.U.nnz)


def test_sparse_cholesky_solves_entries_of_a_longer_vector_and_in_single_precision():
    matrix, rng = spd(60, 3), np.random.default_rng(3)
    solve, index = SparseCholesky()(matrix), rng.permutation(200)[:120].reshape(60, 2)
    rhs, out = rng.standard_normal(200), np.full(200, np.nan)
    solve.placed(index)(rhs, out)
    expected = solve(rhs[index])
    assert np.array_equal(out[index], expected)
    assert np.isnan(np.delete(out, index.ravel())).all()  # nothing else is touched
    rough = solve.rounded()(rhs[index])
    # Single precision, 6e-8, times the condition number of the matrix, below 1e3 here.
    assert 0.0 < np.abs(rough - expected).max() < 6e-5 * np.abs(expected).max()


def test_sparse_cholesky_follows_the_pattern():
    """The analysis is kept for one pattern and made anew for another one."""
    factor = SparseCholesky()
    first, other = spd(60, 0), spd(60, 1)
    rhs = np.arange(60.0)
    once = factor(first)
    again = factor(2.0 * first)
    assert again.analysis is once.analysis
    assert np.allclose(again(rhs), 0.5 * once(rhs), rtol=1e-12)
    assert np.allclose(other @ factor(other)(rhs), rhs, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("bad", [-1.0, np.nan])
def test_sparse_cholesky_refuses_what_is_not_positive_definite(bad):
    matrix = spd(20, 3).tolil()
    matrix[4, 4] = bad
    with pytest.raises(DataError, match="not positive definite"):
        SparseCholesky()(sp.csc_array(matrix))
