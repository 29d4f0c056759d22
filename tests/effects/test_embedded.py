"""A cell inside a gel: weights, balance of forces, couples and power, passive energy, turning."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cellsys as cs
from cellsys.effects import clutch_kernels as loops
from cellsys.effects.matrix import Drag
from cellsys.effects.protocol import CellBody
from cellsys.geometry.gel import gel
from cellsys.geometry.membrane import Membrane
from cellsys.mechanics.node_arrays import CellSpec
from cellsys.mechanics.spreading import build_spreading

CELLS = ["drag", "membrane_elasticity", "volume", "cortical_tension"]
EFFECTS = {name: {} for name in [*CELLS, "focal_adhesion", "matrix_contact", "matrix_elasticity"]}


def small(effects=EFFECTS, cells=(0.0,), **matrix):
    """A scene of some 300 nodes around cells of 4 um on the x axis."""
    table = {
        "name": "small gel",
        "duration": "20 s",
        "sample": "5 s",
        "matrix": {"kind": "gel", "length": "40 um", "diameter": "20 um", **matrix},
        "cells": [{"position": [f"{x} um", "0 um"], "radius": "4 um"} for x in cells],
        "effects": effects,
    }
    return cs.Scene.parse(table)


def disturbed(system, seed=0):
    """A state off the start, its bonds closed and stretched."""
    rng = np.random.default_rng(seed)
    x = system.x0.copy()
    for block in system.states:
        part = system.states.view(x, block.name)
        if block.name.endswith("strength"):
            part[:] = rng.uniform(0.1, 1.0, part.shape)
        else:
            part += 0.05 * rng.standard_normal(part.shape)
    held = np.isinf(system.drag())
    x[held] = system.x0[held]
    return x


def test_weights_in_space_are_those_of_all_pairs():
    rng = np.random.default_rng(0)
    x, places = rng.uniform(-4, 4, (60, 3)), rng.uniform(-12, 12, (500, 3))
    free = np.sort(rng.permutation(500)[:400])
    for reach in (0.7, 3.0, 6.0):
        count, total = np.zeros(60, np.int64), np.zeros(60)
        rows, shares = loops.space_weights(x, places, free, reach, count, total)
        square = ((places[None] - x[:, None]) ** 2).sum(2)
        q = np.clip(1.0 - square / reach**2, 0.0, None) ** 3
        q[:, np.setdiff1d(np.arange(500), free)] = 0.0
        found = np.zeros_like(q)
        found[np.repeat(np.arange(60), count), rows] = shares
        # The same sums of cubes in another order.
        assert np.allclose(found, q, rtol=1e-12, atol=1e-14)
        assert np.allclose(total, q.sum(1), rtol=1e-12, atol=1e-14)


def test_loads_and_slip_in_space_share_their_weights():
    rng = np.random.default_rng(1)
    n, N = 20, 50
    index = np.array([rng.permutation(N)[:6] for _ in range(n)])
    weight, count = rng.uniform(0, 0.2, (n, 6)), rng.integers(0, 7, n)
    W = np.zeros((n, N))
    for i in range(n):
        W[i, index[i, : count[i]]] = weight[i, : count[i]]
    hold, stretch = W.sum(1), rng.standard_normal((n, 3))
    x, u = rng.standard_normal((n, 3)), rng.standard_normal((N, 3))
    cell, matrix = np.zeros((n, 3)), np.zeros((N, 3))
    loops.clutch_loads(
        x, u, np.ones(n), stretch, index, weight, count, hold, 2.0, 9.0, cell, matrix
    )
    assert np.allclose(cell, 2.0 * hold[:, None] * stretch, atol=1e-13)
    assert np.allclose(matrix, -2.0 * W.T @ stretch, atol=1e-13)
    out, x_end, u_end = np.empty((n, 3)), x + 0.1, u * 1.1
    loops.slip(u, u_end, x, x_end, index, weight, count, hold, 0.5, out)
    assert np.allclose(out, (W @ (u_end - u) - hold[:, None] * 0.1) / 0.5, atol=1e-12)


@pytest.mark.parametrize("seed", [0, 1])
def test_forces_and_couples_of_every_element_sum_to_zero(seed):
    system = cs.build(small(cells=(-5.0, 5.0)))
    x = disturbed(system, seed)
    s = system.configuration(0.0, x)
    places = {name: s.nodes[name] for name in s.nodes}
    places["matrix"] = system.matrix.position + s.nodes["matrix"]
    for element in system.elements:
        out = tuple(np.zeros_like(s.nodes[p.array]) for p in element.ports)
        element.efforts(s, out)
        size = sum(np.abs(f).sum() for f in out)
        force = sum(f.sum(axis=0) for f in out)
        couple = sum(
            np.cross(places[p.array], f).sum(axis=0)
            for p, f in zip(element.ports, out, strict=True)
        )
        # Rounding of sums over some hundred nodes.
        assert np.abs(force).max() <= 1e-11 * size + 1e-12, element.name
        if "focal_adhesion" not in element.name:
            assert np.abs(couple).max() <= 1e-10 * size + 1e-11, element.name


def test_power_at_the_clutch_is_stretch_force_times_slip():
    system = cs.build(small())
    x, rng = disturbed(system), np.random.default_rng(2)
    s = system.configuration(0.0, x)
    item = next(e for e in system.elements if e.name == "cell1.focal_adhesion")
    out = tuple(np.zeros_like(s.nodes[p.array]) for p in item.ports)
    item.efforts(s, out)
    v = [rng.standard_normal(f.shape) for f in out]
    index, weight, _ = item.footing.weights(s)
    under = (weight[:, :, None] * v[1][index]).sum(axis=1)
    slip = under - item.footing.hold(s)[:, None] * v[0]
    power = sum(float((f * w).sum()) for f, w in zip(out, v, strict=True))
    assert power == pytest.approx(-float((item.pulls(s) * slip).sum()), rel=1e-11)


def test_energy_of_passive_effects_never_rises():
    passive = {name: {} for name in [*CELLS, "matrix_contact", "matrix_elasticity"]}
    system = cs.build(small(passive))
    rng = np.random.default_rng(3)
    start = system.x0.copy()
    free = np.isfinite(system.drag()) & (system.drag() > 0)
    start[free] += 0.2 * rng.standard_normal(int(free.sum()))
    t = np.linspace(0.0, 20.0, 21)
    run = cs.simulate(system, cs.RKC(rtol=1e-4, atol=1e-4), t, x0=start)
    stored = np.array([sum(system.energy(0.0, x).values()) for x in run.x])
    assert np.all(np.diff(stored) <= 1e-6 * stored[0])
    assert stored[-1] < 0.5 * stored[0]


def test_a_turned_gel_gives_the_turned_result():
    scene = small()
    straight = cs.build(scene)
    Q = Rotation.from_rotvec([0.7, -1.1, 0.4]).as_matrix()
    turned = dataclasses.replace(
        straight.matrix, position=np.ascontiguousarray(straight.matrix.position @ Q.T)
    )
    (spec,) = straight.cells
    mesh = spec.body.membrane
    membrane = Membrane(np.ascontiguousarray(mesh.position @ Q.T), mesh.triangles, mesh.edges)
    body = CellBody(spec.body.name, membrane, Q @ spec.body.polarity)
    shared = {n: e for n, e in scene.effects.items() if e.acts_on != "cell"}
    drag = scene.effects["drag"]
    assert isinstance(drag, Drag)
    cells = (CellSpec(body, dict(spec.effects), spec.commands),)
    other = build_spreading(cells, turned, shared, drag)
    method, t = cs.ExplicitEuler(step=0.02), np.array([0.0, 1.0])
    a, b = (cs.simulate(system, method, t) for system in (straight, other))
    for name in ("matrix.displacement", "cell1.position", "cell1.bond_stretch"):
        first, second = a.block(name)[-1], b.block(name)[-1]
        # 50 steps of sums in another order, each rounded to 1e-16 of some um.
        assert np.abs(first @ Q.T - second).max() < 1e-9
    assert np.abs(a.block("matrix.displacement")[-1]).max() > 1e-4


def test_cavities_leave_no_node_near_a_cell_and_controls_keep_the_network():
    scene = small(cells=(-5.0, 5.0))
    whole = cs.build(scene).matrix
    for x in (-5.0, 5.0):
        assert np.linalg.norm(whole.position - [x, 0, 0], axis=1).min() > 4.3
    alone = cs.build(cs.alone_scenes(scene)[0]).matrix
    assert np.array_equal(alone.position, whole.position)
    assert np.array_equal(alone.fibres, whole.fibres)


def test_relaxed_modulus_of_the_built_gel():
    """EA such that pulling the ends of the whole gel by 1 % stores E eps^2 V/2."""
    from cellsys.geometry.gel import relaxed_uniaxial_modulus

    built = gel((40.0, 20.0, 20.0), 500.0, n_nodes=400, shape="box")
    E = relaxed_uniaxial_modulus(
        built.position, built.fibres, built.stiffness, built.clamped, 40.0 * 400.0
    )
    assert E == pytest.approx(500.0, rel=1e-6)


def test_a_gel_as_flat_as_a_disc_has_the_modulus_of_the_disc():
    from cellsys.geometry.disc import relaxed_shear_modulus

    size = (60.0, 60.0, 2.0)
    flat = gel(size, 5000.0, n_nodes=2546, shape="box")  # the disc's density
    x = flat.position
    rim = (np.abs(x[:, 0]) > 28.4) | (np.abs(x[:, 1]) > 28.4)
    G = relaxed_shear_modulus(x, flat.fibres, flat.stiffness, rim, 7200.0)
    assert 2.5 * G == pytest.approx(5000.0, rel=0.1)
