"""Cells on a field: power balance, symmetry in the cells, one cell, the naive exchange."""

import dataclasses

import numpy as np
import pytest

import cellsys as cs
from cellsys.cell.dynamics import CellDynamics

from .runs import data, model, scene


@pytest.fixture(scope="module")
def field():
    return cs.GalerkinField(
        system=cs.build(scene()), order=40, places=30, per_place=3, tolerance=1e-8
    )


def with_gain(m, gain):
    """The model with a port gain in charges 1 and 2, in units of 1 / (greatest C C^T dt)."""
    blocks = list(m.dynamics.blocks)
    for q in (1, 2):
        size = float(np.linalg.norm(blocks[q].C, 2) ** 2)
        blocks[q] = dataclasses.replace(blocks[q], gamma=gain / size if size else 0.0)
    dynamics = dataclasses.replace(m.dynamics, blocks=tuple(blocks))
    return cs.EquivariantModel(
        dynamics=dynamics,
        representation=m.representation,
        modes=m.modes,
        sites=m.sites,
        states=m.states,
        auxiliaries=m.auxiliaries,
        z_start=m.z_start,
    )


def without_commands(m):
    blocks = tuple(dataclasses.replace(b, B=np.zeros_like(b.B)) for b in m.dynamics.blocks)
    dynamics = CellDynamics(
        blocks=blocks,
        clock=m.dynamics.clock,
        dt=m.dynamics.dt,
        alone=m.dynamics.alone,
        riding=m.dynamics.riding,
    )
    return cs.EquivariantModel(
        dynamics=dynamics,
        representation=m.representation,
        modes=m.modes,
        sites=m.sites,
        states=m.states,
        auxiliaries=m.auxiliaries,
        z_start=m.z_start,
    )


@pytest.mark.parametrize("n", [1, 3])
def test_storage_never_grows_without_commands(field, n):
    """Midpoint exchange; cells overlap. The rest is the exchange's tolerance times the power."""
    m = without_commands(with_gain(model(), 100.0))
    cells = cs.CellsOnField(model=m, field=field, tolerance=1e-9)
    rng = np.random.default_rng(3)
    z = 0.3 * rng.standard_normal((n, m.order))
    state = cells.start(rng.uniform(-3, 3, (n, 2)), z)
    before = cells.storage(state)
    for k in range(6):
        state, _ = cells.step(state, np.ones(n), np.zeros(n), 10.0 * k)
        after = cells.storage(state)
        assert after <= before * (1 + 1e-8)
        before = after


def test_lagged_velocity_gains_energy(field):
    """The naive exchange, with the velocity of the step before, breaks the balance."""
    m = without_commands(with_gain(model(), 20000.0))
    cells = cs.CellsOnField(model=m, field=field)
    rng = np.random.default_rng(3)
    state = cells.start(np.zeros((1, 2)), 0.3 * rng.standard_normal((1, m.order)))
    w = m.dynamics.clock.weights(0.0)
    none = m.dynamics.features(np.ones(1), np.zeros(1))
    worst, storage = 0.0, cells.storage(state)
    rate = state.rate
    for _ in range(8):
        under = cells.footprints(state)
        x = cells._ported(m.dynamics.advance(state.cells, none, w), cells._gather(under, rate), w)
        f = [
            0.5 * (a + b) @ block.C.T
            for a, b, block in zip(state.cells.x, x, m.dynamics.blocks, strict=True)
        ]
        q, _ = field.step(state.q, cells._project(under, f), m.dt)
        rate = (q - state.q) / m.dt
        moved = dataclasses.replace(state.cells, x=tuple(x))
        state = dataclasses.replace(state, cells=moved, q=q, rate=rate)
        worst = max(worst, cells.storage(state) / storage)
        storage = cells.storage(state)
    assert worst > 1.001


def test_exchanging_two_cells_changes_nothing(field):
    m = model()
    cells = cs.CellsOnField(model=m, field=field)
    a, h = np.full((8, 2), 1.0), np.tile([0.3, 2.0], (8, 1))
    a[:, 1] = 0.6
    places = np.array([[-6.0, 1.0], [7.0, -2.0]])
    one = cells.simulate(a, h, places)
    other = cells.simulate(a[:, ::-1], h[:, ::-1], places[::-1])
    np.testing.assert_allclose(one.block("z"), other.block("z")[:, ::-1], atol=1e-9)
    modes = [run.block("field.modes") for run in (one, other)]
    np.testing.assert_allclose(*modes, atol=1e-9)


def test_cells_drive_the_matrix_and_ride_on_it(field):
    m = model()
    run = cs.CellsOnField(model=m, field=field).simulate(
        np.ones((15, 1)), np.zeros((15, 1)), np.zeros(2)
    )
    assert np.abs(field.displacement(run.block("field.modes")[-1])).max() > 1e-3
    assert run.statistics["exchanges"] >= 1
    alone = m.simulate_commands(m.z_start, np.ones(15), np.zeros(15))
    # charges do not see the field where no gain is determined by the data
    if all(b.gamma == 0 for b in m.dynamics.blocks):
        np.testing.assert_allclose(run.block("z")[:, 0, :-2], alone[:, :-2], atol=1e-9)


@pytest.mark.parametrize(
    "call",
    [
        lambda c: c.start(np.array([[np.nan, 0.0]])),
        lambda c: c.start(np.zeros((2, 2)), np.zeros((1, 3))),
        lambda c: c.simulate(np.ones((3, 2)), np.ones((3, 1)), np.zeros((2, 2))),
        lambda c: c.simulate(np.full((3, 1), np.inf), np.ones((3, 1)), np.zeros((1, 2))),
    ],
)
def test_bad_starts_and_commands_are_refused(field, call):
    with pytest.raises((cs.DataError, cs.DimensionError)):
        call(cs.CellsOnField(model=model(), field=field))


def test_the_card_says_what_the_cell_is_worth_on_the_matrix(field):
    """Beside the projection floor and what needs no model; a field of another matrix is refused."""
    train, held = data()
    shown = cs.with_matrix(model(), field, held, train)
    row = shown.card.held_out["matrix"]
    assert row["floor"] < row["model"] < row["nothing moves"] == pytest.approx(1.0)
    assert row["spread over runs"] == 0.0  # one held-out run
    assert "matrix" in str(shown.card)
    other = cs.Scene.parse(
        {"matrix": {"diameter": "40 um", "nodes": 300}, "name": "other",
         "effects": {"drag": {}, "matrix_elasticity": {}},
         "duration": "10 s", "sample": "5 s", "cells": []}
    )  # fmt: skip
    small = cs.GalerkinField(system=cs.build(other), order=10, places=10, per_place=2)
    with pytest.raises(cs.DataError, match="nodes, the runs"):
        cs.with_matrix(model(), small, held, train)
