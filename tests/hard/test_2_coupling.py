"""Coupling: I - P singular or nearly, more latents than cell rows, many cells, one place."""

import time

import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.integrate import DOP853
from cellsys.population import (
    Feedback,
    InteractionGraph,
    MappedSuperposition,
    P_phi,
    Superposition,
    couple,
)
from cellsys.spectra import poles, stability
from tests import naive
from tests.hard.stress import SEED, Case, Choice, Int, Power, Real, hold
from tests.population.systems import match, model


def spread(A):
    """What rounding of 1e-15 becomes in a pole of A."""
    return 1e-13 * np.max(poles(A).condition) * sla.norm(A)


def expanded(found):
    """Poles with their multiplicities."""
    return np.repeat(found.values, found.multiplicity)


def nearly_matrix_directions(exponent, m, K, seed):
    """1 - lambda = 10^exponent once: copies of A while determined, both sets below that.

    [notes: theory, rank decision] At 1e-7 the data stop deciding; exact poles are those of A by the
    theorem, or of its compression where the direction counts as purely matrix.
    """
    gap = np.random.default_rng(seed).uniform(0.2, 0.8, m)
    gap[0] = 10.0**exponent
    one = model(m=m, seed=seed, gap=gap)
    found = couple(one, K, Superposition()).pole_set()
    assert sum(found.multiplicity) == K * m
    own, tol = sla.eigvals(one.A), spread(one.A)
    P = P_phi(one)
    _, W = sla.eigh(P)
    keep = W[:, :-1]
    squeezed = np.append(sla.eigvals(keep.T @ one.A @ keep), 0.0)
    both = {
        "copies": np.concatenate([own] * K),
        "zeros": np.concatenate([own, *[squeezed] * (K - 1)]),
    }
    # eigenvectors of P are found to 1e-16 over its gaps
    loose = max(tol, 1e-9)
    if exponent > -6.9:
        assert found.determined
        assert match(expanded(found), both["copies"]) < loose
    elif exponent < -7.1 and K > 1:
        assert not found.determined
        assert match(expanded(found), both["copies"]) < loose
        assert match(expanded(found.alternative), both["zeros"]) < loose


@pytest.mark.parametrize("exponent", [-2, -5, -8, -10, -12, -14, -16])
def test_one_minus_lambda_swept(exponent):
    nearly_matrix_directions(float(exponent), 5, 4, 1)
    gap = np.full(5, 0.5)
    gap[0] = 10.0**exponent
    one = model(m=5, seed=1, gap=gap)
    off = match(naive.dense_coupled_poles(one, 4), np.concatenate([sla.eigvals(one.A)] * 4))
    if -15 <= exponent <= -10:
        # naive: the pseudo-inverse of the whole, its cut-off relative to the largest N
        assert off > 1e-5


def more_latents_than_cell_rows(m, missing, K, seed):
    """m > rank V_alpha by `missing`: that many exact zeros in each of K - 1 difference blocks."""
    missing = min(missing, m - 1)
    gap = np.random.default_rng(seed).uniform(0.2, 0.8, m)
    gap[:missing] = 0.0
    one = model(m=m, seed=seed, gap=gap)
    cells = couple(one, K, Superposition())
    found = cells.pole_set()
    zero = int(np.sum(found.multiplicity[found.values == 0]))
    assert zero == missing * (K - 1)
    assert sum(found.multiplicity) == K * m
    # a verdict is about the blocks: never "stable" where a compression of A is not
    _, W = sla.eigh(P_phi(one))
    keep = W[:, : m - missing]
    worst = sla.eigvals(keep.T @ one.A @ keep).real.max() if K > 1 else -1.0
    if worst > 1e-6:
        assert cells.stability().verdict == "unstable"


def test_exact_zeros_of_more_latents_than_rows():
    more_latents_than_cell_rows(5, 2, 5, 1)
    gap = np.random.default_rng(1).uniform(0.2, 0.8, 5)
    gap[:2] = 0.0
    # naive: one dense matrix of all cells; its zeros are some 1e-17 or 1e-9, and uncounted
    dense = naive.dense_coupled_poles(model(m=5, seed=1, gap=gap), 5)
    assert np.sum(dense == 0) < 2 * 4


def any_number_of_cells(K, m, form, seed, size):
    """Time and memory do not grow with K; poles of two cells are those of the Kronecker matrix."""
    one = model(m=m, seed=seed)
    R = np.eye(m) + size * np.random.default_rng(seed).standard_normal((m, m))
    coupling = {
        "superposition": Superposition(),
        "mapped": MappedSuperposition(P_map=R - np.eye(m)),
        "feedback": Feedback(R=R),
    }[form]
    began = time.process_time()
    cells = couple(one, K, coupling)
    found = cells.pole_set()
    assert time.process_time() - began < 2.0
    assert sum(found.multiplicity) == K * m
    assert np.all(np.isfinite(found.values))
    verdict = cells.stability().verdict
    worst = found.values.real.max()
    if verdict == "stable":
        assert worst < 0
    if form == "superposition":
        assert match(found.values, sla.eigvals(one.A)) < spread(one.A)
    elif K <= 2:  # of more cells the dense matrix has repeated poles, which it knows badly
        M = naive.kronecker_coupling(coupling.name, one.A, P_phi(one), K, R)
        dense = sla.eigvals(M)
        # two routes to one matrix, each with rounding times the condition of its poles
        assert match(expanded(found), dense) < 100 * spread(M)
        if dense.real.max() > 1e-6:
            assert verdict == "unstable"  # P_map that destabilises is said to


def test_a_million_cells():
    any_number_of_cells(10**6, 20, "feedback", 0, 0.1)
    with pytest.raises(ValueError, match="K <= 20"):
        naive.kronecker_coupling("Feedback", np.eye(2), np.eye(2), 10**6)


def cells_at_one_place(K, distance, length, seed):
    """Positions that coincide or nearly: finite weights, finite poles, a run that stays finite."""
    one = model(m=3, seed=seed)
    rng = np.random.default_rng(seed)
    positions = distance * rng.standard_normal((K, 2))
    positions[1] = positions[0]
    graph = InteractionGraph.attenuated(positions, length)
    cells = couple(one, K, Superposition(), graph=graph, positions=positions)
    found = cells.pole_set()
    assert np.all(np.isfinite(found.values))
    assert sum(found.multiplicity) == 3 * K
    w = np.asarray(graph.weights)
    assert np.all(np.isfinite(w))
    assert np.all(np.diag(w) == 0)
    if found.values.real.max() < 1.0:
        run = cells.simulate(np.array([0.0, 1.0, 5.0]), DOP853(rtol=1e-8, atol=1e-10))
        assert np.all(np.isfinite(run.x))


def test_naive_weights_of_cells_at_one_place():
    positions = np.array([[0.0, 0.0], [0.0, 0.0], [10.0, 0.0]])
    assert not np.isfinite(naive.inverse_distance_weights(positions)).all()
    assert np.isfinite(InteractionGraph.attenuated(positions, 20.0).weights).all()


def test_a_map_that_destabilises_is_not_hidden_by_stable_cells():
    one = model(m=4, seed=3)
    assert stability(one.A).verdict == "stable"
    P_map = 30.0 * np.random.default_rng(0).standard_normal((4, 4))
    cells = couple(one, 6, MappedSuperposition(P_map=P_map))
    assert cells.pole_set().values.real.max() > 0
    assert cells.stability().verdict == "unstable"
    # naive: eq. 36 is a similarity, so "coupled poles are those of one cell"
    assert naive.poles_say_stable(one.A)


CASES = (
    Case(
        "1 - lambda",
        nearly_matrix_directions,
        {"exponent": Real(-24, -1), "m": Int(2, 7), "K": Int(1, 6), "seed": SEED},
    ),
    Case(
        "more latents than rows",
        more_latents_than_cell_rows,
        {"m": Int(2, 8), "missing": Int(1, 4), "K": Choice(1, 2, 5, 1000), "seed": SEED},
    ),
    Case(
        "any number of cells",
        any_number_of_cells,
        {
            "K": Choice(1, 2, 5, 100, 10**4, 10**6),
            "m": Int(2, 12),
            "form": Choice("superposition", "mapped", "feedback"),
            "size": Power(-3, 1),
            "seed": SEED,
        },
    ),
    Case(
        "cells at one place",
        cells_at_one_place,
        {"K": Int(2, 6), "distance": Power(-12, 3), "length": Power(-3, 4), "seed": SEED},
    ),
)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_random_instances(case):
    hold(case, 4)
