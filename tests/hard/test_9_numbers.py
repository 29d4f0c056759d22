"""Process, numbers: arrays, times, gains, counts and quantities that are none, at every door."""

import tomllib

import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import CellsysError, DataError, MemoryBudgetError
from cellsys.integrate import DOP853
from tests import naive
from tests.loop.systems import make
from tests.study.scenes import TINY

A = np.array([[-1.0, 0.2], [0.0, -0.5]])
EDGE = (np.ones((2, 1)), np.ones((1, 2)), [[0.0]])
BAD = {
    "NaN": np.full((2, 2), np.nan),
    "inf": np.full((2, 2), np.inf),
    "wide": np.ones((2, 3)),
    "cube": np.ones((2, 2, 2)),
    "complex": A + 1j,
    "objects": np.array([[-1.0, None], [0, -1]], dtype=object),
    "texts": np.array([["a", "b"], ["c", "d"]]),
    "ragged": [[1, 2], [3]],
    "word": "abc",
    "table": {},
    "dates": np.zeros((2, 2), "M8[s]"),
    "1e308": np.full((2, 2), 1e308),
}
GOOD = {
    "whole": np.array([[-1, 0], [0, -2]]),
    "columns first": np.asfortranarray(A),
    "every second": np.kron(A, np.ones((2, 2)))[::2, ::2],
    "backwards": A[::-1, ::-1],
    "half": A.astype(np.float16),
    "long": A.astype(np.longdouble),
    "list": [[-1, 0], [0, -1]],
    "denormal": -5e-324 * np.eye(2),
    "objects that are numbers": A.astype(object),
}


def doors(M):
    """Everything that takes a matrix."""
    return (
        lambda: cs.poles(M),
        lambda: cs.damping(M),
        lambda: cs.stability(M),
        lambda: cs.zeros((M, *EDGE)),
        lambda: cs.margins((M, *EDGE)),
        lambda: cs.frequency_response((M, *EDGE), [1.0]),
        lambda: cs.LatentModel(A=M),
    )


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_matrix_is_refused_everywhere(name):
    M = BAD[name]
    for door in doors(M)[: -1 if name == "1e308" else None]:  # a model may have any rate
        with pytest.raises(CellsysError):
            door()
    for take in (
        lambda: cs.LatentModel(A=A, B=M),
        lambda: cs.LatentModel(A=A, V=M),
        lambda: cs.LatentModel(A=A, offset=M),
        lambda: cs.frequency_response((A, M, EDGE[1], [[0.0, 0.0]]), [1.0]),
    ):
        if name in ("wide", "cube", "1e308"):
            continue  # three inputs are as good as two; the rest is refused above
        with pytest.raises(CellsysError):
            take()


def test_naive_systems_take_nan():
    assert np.isnan(naive.state_space_of_anything(BAD["NaN"]).A).all()


@pytest.mark.parametrize("name", GOOD)
def test_numbers_of_any_make_give_the_same(name):
    M = GOOD[name]
    plain = np.array(M, dtype=float)
    assert np.array_equal(np.asarray(cs.poles(M)), np.asarray(cs.poles(plain)))
    model = cs.LatentModel(A=M)
    assert np.array_equal(model.A, plain)
    assert np.array_equal(
        cs.frequency_response((M, *EDGE), [1.0]).response,
        cs.frequency_response((plain, *EDGE), [1.0]).response,
    )


def test_a_rate_that_has_no_square_is_told_from_states_in_odd_units():
    # the same system with its states 1e300 apart: no rate changes, nothing is refused
    T = np.array([1e150, 1e-150])
    odd = A * T[:, None] / T[None]
    assert np.abs(np.sort(np.asarray(cs.poles(odd)).real) - [-1.0, -0.5]).max() < 1e-12
    with pytest.raises(DataError, match=r"1e\+308, beyond 1e\+150.*unit of time"):
        cs.stability(1e308 * np.diag([-1.0, -0.5]))


TIMES = {
    "none": [], "scalar": 1.0, "plane": [[0.0, 1.0]], "NaN": [0.0, np.nan], "back": [1.0, 0.0],
    "twice": [0.0, 0.0], "complex": [1j], "word": ["a"], "nothing": None,
}  # fmt: skip


@pytest.mark.parametrize("name", TIMES)
@pytest.mark.parametrize("dt", [None, 0.5])
def test_times_that_are_none(name, dt):
    model = cs.LatentModel(A=A, B=np.eye(2), dt=dt)
    with pytest.raises(CellsysError):
        model.predict([1.0, 1.0], None, TIMES[name])
    assert model.predict([1.0, 1.0], None, [3.0]).shape == (1, 2)
    with pytest.raises(CellsysError, match=r"counted|grid"):
        cs.LatentModel(A=A, dt=1e-300).predict([1.0, 1.0], None, [0.0, 1e300])
    for z0, u in (([1j, 0], None), (["a", "b"], None), ([1, 1], ["a", "b"]), ([1, 1], 1j)):
        with pytest.raises(CellsysError):
            model.predict(z0, u, [0.0, 1.0])


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0, "a", None, 1j, [1.0]])
def test_gains_and_steps_that_are_none(value):
    with pytest.raises(CellsysError):
        cs.PolarityLaw(kappa=value)
    if value is not None:
        with pytest.raises(CellsysError):
            cs.LatentModel(A=A, dt=value)
    if value != -1.0:
        with pytest.raises(CellsysError):
            cs.PolarityLaw(kappa=1.0).step([1, 0, 0], [0, 1, 0], value)


@pytest.mark.parametrize(
    "p", [[np.nan, 0, 0], [1, 0], [[1, 0, 0]], [1j, 0, 0], ["a", "b", "c"], None]
)
def test_polarities_that_are_none(p):
    law = cs.PolarityLaw(kappa=1 / 60)
    with pytest.raises(CellsysError):
        law.step(p, [0.0, 1.0, 0.0], 1.0)
    if p != [np.nan, 0, 0]:
        with pytest.raises(CellsysError):
            law.rate(p, [0.0, 1.0, 0.0])
    # lists are taken as arrays, and agree with them
    assert np.array_equal(law.rate([1, 0, 0], [0, 1, 0]), [0.0, 1 / 60, 0.0])


@pytest.mark.parametrize("path", ["", None, 3, "a\0b"])
def test_paths_that_are_none(path):
    with pytest.raises(CellsysError, match="path must"):
        cs.LatentModel(A=A).save(path)


@pytest.mark.parametrize("p", [[1j, 0, 0], "a", [5e-324, 0, 0], [0, 0, 1.0], [np.nan, 0, 0]])
def test_starts_of_a_loop_that_are_none(p):
    loop = make(seed=1)
    with pytest.raises(CellsysError):
        loop.simulate([0.0, 1.0], DOP853(rtol=1e-6, atol=1e-8), p0=p)
    with pytest.raises(CellsysError, match="sensor must be"):
        cs.closed_loop(loop.model, controller=cs.PolarityLaw(), sensor=4)


def test_counts_of_cells():
    V = np.linalg.qr(np.random.default_rng(0).standard_normal((6, 2)))[0]
    one = cs.LatentModel(A=A, V=V, blocks={"component": range(3), "field": range(3, 6)})
    for K in (0, -1, 2.0, np.nan, "3", True, 10**30, [3]):
        with pytest.raises(CellsysError, match="n_cells"):
            cs.couple(one, n_cells=K)
    cells = cs.couple(one, n_cells=10**12)
    assert sum(cells.pole_set().multiplicity) == 2 * 10**12
    with pytest.raises(MemoryBudgetError, match="GB"):
        cells.simulate([0.0, 1.0], DOP853(rtol=1e-6, atol=1e-8))


PLACES = ("duration", "sample", "matrix.diameter", "matrix.modulus", "cells.0.radius")
QUANTITIES = (
    "1e400 um", "-5 um", "0 s", "nan um", "5", "5 kg", "", "1/0 s", "5 um^999999999", "1,5 um",
    "5 um\x00", "9" * 400 + " um", "\ud800", 10**400, float("nan"), True, None, [], {}, b"x",
)  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
def test_quantities_that_are_none(place):
    for value in QUANTITIES:
        table = tomllib.loads(TINY)
        inner = table
        *keys, last = place.split(".")
        for key in keys:
            inner = inner[int(key) if isinstance(inner, list) else key]
        inner[last] = value
        with pytest.raises(CellsysError, match=last):
            cs.Scene.parse(table)


def test_a_count_of_nodes_beyond_doubles():
    table = tomllib.loads(TINY)
    table["matrix"]["nodes"] = 10**400
    with pytest.raises(CellsysError):
        cs.build(cs.Scene.parse(table))
