"""The card: floor, baselines, verdict in words; certainty of poles; figures of models."""

import dataclasses
import json

import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from cellsys.cell.worth import block_errors
from cellsys.model import Card, LatentModel
from cellsys.model.card import verdict
from cellsys.reduction import PCR, LeastSquares, fit_basis, pole_certainty, reduce
from cellsys.worth import assess
from cellsys.worth.assessment import encode_run, mean_motion, position_rows
from cellsys.worth.errors import mse
from tests.reduction.systems import linear_runs, one_step_data, stable_matrix, state_data

NAMES = {"model", "floor", "nothing moves", "mean velocity", "mean motion", "mse", "resolution"}


@pytest.fixture(scope="module")
def linear():
    """Training and held-out runs of one linear system, its order 4 exact."""
    rng = np.random.default_rng(0)
    A = stable_matrix(4, rng)
    wide = rng.standard_normal((4, 10))
    arrays = [x @ wide for x, _ in linear_runs(A, np.zeros((4, 0)), np.ones(4), 0.1, rng, runs=6)]
    return state_data(arrays[:4]), state_data(arrays[4:])


def test_an_exact_model_has_no_error_and_says_so(linear):
    data, test = linear
    model = reduce(data, order=4, method=LeastSquares(), test=test)
    card = model.card
    assert set(card.training) == set(card.held_out) == {"cells", "matrix"}
    for rows in (card.training, card.held_out):
        for row in rows.values():
            assert set(row) == NAMES
            assert row["nothing moves"] == 1.0
            # a roll-out of 60 steps of an exactly recovered system
            assert row["model"] < 1e-8
            assert row["floor"] < 1e-12 * 10
            assert row["mse"] < 1e-14
    assert "better than" in card.verdict
    assert card.verdict.startswith("order 4: held out its error on cells is 0.00 of the motion")
    assert card.samples == data.n_samples
    assert card.columns == 10
    assert len(card.runs) == 4


def test_the_floor_is_the_projection_error(linear):
    data, test = linear
    model = reduce(data, order=2, method=LeastSquares(), test=test)
    n, error, moved = data.states.size, 0.0, 0.0
    row = model.card.held_out["matrix"]
    squares = []
    for run in test.runs:
        x = run.x
        back = (x - model.mean) / model.scale @ model.V @ model.V.T * model.scale + model.mean
        error = np.linalg.norm((back - x)[:-1, 5:])
        moved = np.linalg.norm((x - x[0])[:, 5:])
        squares.append((error / moved) ** 2)
    assert n == 10
    assert abs(row["floor"] - np.sqrt(np.mean(squares))) < 1e-12
    assert row["floor"] > 1e-3


def test_baselines_are_what_they_say(linear):
    data, test = linear
    motion = mean_motion(data)
    assert np.allclose(motion, np.mean([r.x - r.x[0] for r in data.runs], axis=0))
    # a model that repeats the mean of the runs scores as "mean motion" does on itself
    same = dataclasses.replace(test, runs=(dataclasses.replace(data.runs[0], x=motion),))
    row = reduce(data, order=2, method=LeastSquares(), test=same).card.held_out["cells"]
    assert row["mean motion"] < 1e-12
    straight = np.arange(60)[:, None] * motion[-1] / 59
    same = dataclasses.replace(test, runs=(dataclasses.replace(data.runs[0], x=straight),))
    row = reduce(data, order=2, method=LeastSquares(), test=same).card.held_out["cells"]
    assert row["mean velocity"] < 1e-12
    assert row["mean motion"] > 1e-3


def test_nothing_moves_is_one_for_a_model_that_does_not_move(linear):
    data, _ = linear
    model = LatentModel(
        A=np.zeros((10, 10)), V=np.eye(10), dt=data.dt, n_states=10, notes={"method": "still"}
    )
    row = assess(model, data).training["cells"]
    assert abs(row["model"] - 1.0) < 1e-12
    assert row["floor"] == 0.0


def test_a_run_that_never_moves_does_not_divide_by_zero(linear):
    data, _ = linear
    still = state_data([np.tile(data.runs[0].x[0], (60, 1))])
    card = reduce(data, order=4, method=LeastSquares(), test=still).card
    assert np.isfinite(card.held_out["cells"]["floor"])
    json.dumps(card.table(), allow_nan=False)


def test_verdict_words():
    def row(model):
        return {
            "cells": {"model": model, "floor": 0.1, "nothing moves": 1.0, "mean velocity": 0.8,
                      "mean motion": 0.6, "mse": 1.0}
        }  # fmt: skip

    better = verdict(7, (-0.1, 0.0), {}, row(0.3))
    assert better == (
        "order 7: held out its error on cells is 0.30 of the motion, better than mean motion "
        "(0.60); its basis allows 0.10."
    )
    worse = verdict(7, (0.2, 0.01), row(0.3), row(0.7))
    assert "held out its error on cells is 0.70 of the motion, worse than mean motion" in worse
    assert worse.endswith("do not predict with it; it has a growing mode (0.2 +- 0.01 1/s).")
    near = row(0.62)
    near["cells"]["resolution"] = 0.05
    assert "not told apart from mean motion (0.60)" in verdict(7, (-0.1, 0.0), {}, near)
    open_ = verdict(7, (0.2, 0.3), {}, row(0.3))
    assert "whether its slowest mode grows (0.2 +- 0.3 1/s) is not decided by the data" in open_
    for huge in (1e7, float("inf"), float("nan"), np.finfo(float).max):
        assert "its roll-out diverges held out; do not predict with it" in verdict(
            7, (-1.0, 0.0), {}, row(huge)
        )
    assert verdict(7, (-1.0, 0.0), {}, {}) == "order 7: not measured against data."


def test_a_diverging_model_says_so_in_plain_numbers(linear):
    data, _ = linear
    basis = fit_basis(data, 2)
    model = LatentModel(
        A=[[1e4, 0.0], [0.0, 1.0]],
        offset=[1.0, 1.0],
        V=basis.V,
        mean=basis.mean,
        scale=basis.scale,
        dt=data.dt,
        n_states=10,
    )
    card = assess(model, data)
    assert "diverges in training" in card.verdict
    assert "model diverges" in str(card)
    text = json.dumps(card.table(), allow_nan=False)
    assert json.loads(text)["training"]["cells"]["floor"] < 1.0


def test_scores_stay_finite_between_large_and_diverged(linear):
    """Growth to 1e140: no IntegrationError yet, squares overflow, the card stays plain."""
    data, _ = linear
    basis = fit_basis(data, 1)
    model = LatentModel(
        A=[[10 * (10 ** (150 / 59) * 0.999)]],
        offset=[1.0], V=basis.V, mean=basis.mean, scale=basis.scale, dt=data.dt, n_states=10,
    )  # fmt: skip
    card = assess(model, data)
    assert "diverges" in card.verdict
    json.dumps(card.table(), allow_nan=False)


def test_card_prints_and_tables():
    card = Card(
        order=3,
        method="PCR()",
        scale="block",
        samples=10,
        columns=5,
        runs=("a", "b"),
        spectral_abscissa=-0.5,
        input_share_explained=0.42,
    )
    assert "order 3, PCR(), scale='block', 10 samples x 5 columns from 2 runs" in str(card)
    assert "commands explain 42 % of the input u" in str(card)
    assert card.table()["runs"] == ["a", "b"]


def test_start_is_encoded_from_the_instantaneous_laws():
    data = one_step_data(seed=3, commands=True)
    model = reduce(data, order=5)
    starts = [model.encode(r.x[0], r.eta_start) for r in data.runs]
    assert np.abs(model.z_start - np.mean(starts, axis=0)).max() < 1e-12
    logged = np.mean([encode_run(model, r)[0] for r in data.runs], axis=0)
    assert np.abs(model.z_start - logged).max() > 1e-6  # the noise on eta tells them apart


def test_position_rows_are_positions_only():
    data = one_step_data()
    assert position_rows(data) == {"cells": slice(0, 4), "matrix": slice(4, 8)}


def test_mse_is_equation_86_whatever_the_block_looks_like():
    """(1/T) sum_t e_t^T e_t: summed over coordinates, for tables and for nodes alike."""
    error = np.random.default_rng(0).standard_normal((7, 5, 3))
    by_hand = sum(float(e.ravel() @ e.ravel()) for e in error) / 7
    assert mse(error) == pytest.approx(by_hand, rel=1e-14)
    assert mse(error.reshape(7, 15)) == pytest.approx(by_hand, rel=1e-14)
    found = block_errors(error, np.zeros_like(error) + np.arange(7)[:, None, None])
    assert found["mse"] == pytest.approx(mse(error - np.arange(7)[:, None, None]), rel=1e-14)


def test_models_draw_themselves():
    data = one_step_data(seed=1)
    model = reduce(data, order=4)
    for result in (model, pole_certainty(data, PCR(), 4), LatentModel(A=[[-10.0]], dt=0.1)):
        ax = plt.figure().subplots()
        assert result.plot(ax) is ax
        ax.figure.canvas.draw()
        plt.close("all")
    own = model.plot()
    assert own.get_xlabel() == "Re (1/s)"
    plt.close("all")
