"""Membrane and disc: closed, oriented, evenly spaced, and as stiff as asked for."""

import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.errors import ParameterError
from cellsys.geometry.disc import (
    RIM,
    StiffnessAssembly,
    connect,
    disc,
    disc_nodes,
    relaxed_shear_modulus,
)
from cellsys.geometry.membrane import sphere


@pytest.mark.parametrize("n", [12, 50, 189, 400])
def test_a_sphere_is_closed_and_oriented(n):
    mesh = sphere(8.0, (1.0, 2.0, 8.05), n)
    assert mesh.triangles.shape == (2 * n - 4, 3)
    assert mesh.edges.shape == (3 * n - 6, 2)
    # Every edge belongs to two triangles that run through it in opposite directions.
    directed = np.concatenate([mesh.triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    assert len(np.unique(directed, axis=0)) == 6 * n - 12
    assert {tuple(e) for e in directed} == {tuple(e[::-1]) for e in directed}
    assert np.hypot.reduce(mesh.position - [1.0, 2.0, 8.05], axis=1) == pytest.approx(
        8.0, rel=1e-12
    )
    ball = 4.0 / 3.0 * np.pi * 512.0
    # An inscribed polyhedron of n nodes misses about 5.5/n of the volume.
    assert 0.0 < 1.0 - mesh.volume / ball < 10.0 / n
    assert mesh.triangle_area.sum() == pytest.approx(4 * np.pi * 64.0, rel=10.0 / n)


def test_bad_spheres_are_refused():
    for radius, n in ((0.0, 189), (-1.0, 189), (float("nan"), 189), (8.0, 11)):
        with pytest.raises(ParameterError):
            sphere(radius, (0, 0, 0), n)


def test_the_shipped_disc_is_the_thesis_s():
    built = disc(30.0, 5000.0)
    n = len(built.position)
    assert n == 2000
    assert np.hypot(*built.position[:, :2].T).max() <= 30.0
    assert built.position[:, 2].min() >= -2.0
    assert built.position[:, 2].max() <= 0.0
    assert 8.5 < 2 * len(built.fibres) / n < 10.0
    assert np.bincount(built.fibres.ravel(), minlength=n).min() >= 3
    assert len(np.unique(np.sort(built.fibres, axis=1), axis=0)) == len(built.fibres)
    assert np.array_equal(built.clamped, np.hypot(*built.position[:, :2].T) > RIM * 30.0)
    assert not built.clamped[built.surface].any()
    assert built.length.min() > 0.5  # um: no near-zero fibre, whose tension would explode
    assert built.stiffness * built.length == pytest.approx(built.stiffness[0] * built.length[0])


@pytest.mark.parametrize("modulus", [500.0, 5000.0])
def test_relaxed_modulus_is_the_one_asked_for(modulus):
    built = disc(15.0, modulus, n_nodes=400, seed=2)
    volume = np.pi * 15.0**2 * 2.0
    G = relaxed_shear_modulus(built.position, built.fibres, built.stiffness, built.clamped, volume)
    # Calibrated and measured by the same linear solve, which is linear in the stiffness.
    assert 2.5 * G == pytest.approx(modulus, rel=1e-8)


def test_relaxed_modulus_by_a_dense_solve_below_the_affine_estimate():
    """Written again with dense algebra; the affine (unrelaxed) energy is an upper bound."""
    built = disc(15.0, 5000.0, n_nodes=300, seed=4)
    x, n = built.position, len(built.position)
    stretch = np.zeros((len(built.fibres), n, 3))
    row, (i, j) = np.arange(len(built.fibres)), built.fibres.T
    unit = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i], axis=1)[:, None]
    stretch[row, j], stretch[row, i] = unit, -unit
    stretch = stretch.reshape(len(row), -1)
    K = stretch.T @ (built.stiffness[:, None] * stretch)
    K += 1e-6 * built.stiffness.mean() * np.eye(3 * n)
    u = np.zeros((n, 3))
    u[:, 0], u[:, 1] = 0.5 * x[:, 1], 0.5 * x[:, 0]
    affine, u = u.ravel(), u.ravel().copy()
    held = np.repeat(built.clamped, 3)
    u[~held] = -sla.solve(K[~held][:, ~held], K[~held][:, held] @ u[held], assume_a="pos")
    volume = np.pi * 15.0**2 * 2.0
    assert 2.5 * float(u @ K @ u) / volume == pytest.approx(5000.0, rel=1e-6)
    assert float(affine @ K @ affine) > 1.2 * float(u @ K @ u)


def test_discs_are_reproducible_and_differ_by_seed():
    a, b, c = (disc(15.0, 5000.0, n_nodes=200, seed=s) for s in (1, 1, 2))
    assert np.array_equal(a.position, b.position)
    assert np.array_equal(a.fibres, b.fibres)
    assert not np.array_equal(a.position, c.position)
    rng = [np.random.default_rng(0) for _ in range(2)]
    assert np.array_equal(disc_nodes(10.0, 2.0, 100, rng[0]), disc_nodes(10.0, 2.0, 100, rng[1]))


def test_fibres_join_near_neighbours():
    x = disc_nodes(12.0, 2.0, 250, np.random.default_rng(0))
    fibres = connect(x, 9.0)
    length = np.linalg.norm(x[fibres[:, 0]] - x[fibres[:, 1]], axis=1)
    spacing = (np.pi * 144.0 * 2.0 / 250) ** (1 / 3)
    assert length.max() < 3.0 * spacing


@pytest.mark.parametrize(
    ("radius", "modulus", "n"),
    [
        (0.0, 5e3, 200),
        (30.0, -1.0, 200),
        (30.0, float("nan"), 200),
        (30.0, 5e3, 10),
        (float("inf"), 5e3, 200),
    ],
)
def test_bad_discs_are_refused(radius, modulus, n):
    with pytest.raises(ParameterError):
        disc(radius, modulus, n_nodes=n)


def test_assembled_stiffness_is_the_tangent_of_springs():
    """Along a, across b: symmetric, translations cost nothing, and the axial part is k n n^T."""
    built = disc(12.0, 5000.0, n_nodes=120, seed=1)
    rng = np.random.default_rng(0)
    x = built.position + 0.05 * rng.standard_normal(built.position.shape)
    along, across = rng.uniform(1, 2, (2, len(built.fibres)))
    K = StiffnessAssembly(len(x), built.fibres)(x, along, across).toarray()
    assert np.allclose(K, K.T, rtol=0, atol=1e-13)
    for axis in range(3):
        shift = np.zeros((len(x), 3))
        shift[:, axis] = 1.0
        assert np.abs(K @ shift.ravel()).max() < 1e-12
    v = rng.standard_normal(x.shape)
    d = x[built.fibres[:, 1]] - x[built.fibres[:, 0]]
    n = d / np.linalg.norm(d, axis=1)[:, None]
    w = v[built.fibres[:, 1]] - v[built.fibres[:, 0]]
    axial = (w * n).sum(1)
    energy = (along * axial**2 + across * ((w**2).sum(1) - axial**2)).sum()
    # The assembly softens 1/L by 1e-12 um^2: a relative 1e-12.
    assert v.ravel() @ K @ v.ravel() == pytest.approx(energy, rel=1e-10)
