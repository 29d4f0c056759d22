"""What may be said of a model: better, growing, held out; and how certain its poles are."""

import dataclasses
import itertools

import numpy as np
import pytest

from cellsys.errors import ParameterError
from cellsys.model import LatentModel
from cellsys.reduction import (
    PCR,
    Contractive,
    LeastSquares,
    Ridge,
    fit_basis,
    pole_certainty,
    reduce,
)
from cellsys.samples import RunData, snapshots
from cellsys.spectra import damping, stability
from cellsys.spectra import poles as cs_poles
from cellsys.worth.assessment import baselines, mean_motion
from tests.reduction.systems import one_step_data, state_data


def oscillator(samples=200, dt=0.1, omega=0.7, runs=1):
    """Undamped, exact to rounding, in four columns."""
    t = dt * np.arange(samples)
    wide = np.random.default_rng(3).standard_normal((2, 4))
    return [
        np.stack([np.cos(omega * t + i), np.sin(omega * t + i)], axis=1) @ wide for i in range(runs)
    ]


@pytest.mark.parametrize("method", [LeastSquares(), Ridge(ridge=0.0)])
def test_one_run_is_not_compared_with_its_own_mean(method):
    """The mean motion of one run is that run: it says nothing of a model (thesis data come so)."""
    (x,) = oscillator()
    model = reduce(state_data([x]), order=2, method=method)
    assert model.card.training["cells"]["model"] < 1e-9
    assert "mean motion" not in model.card.training["cells"]
    assert "no held-out run: training error only" in model.card.verdict
    assert "do not predict" not in model.card.verdict
    # the naive comparison: the run beside the mean over all runs, itself among them
    rows = {"cells": slice(0, 2)}
    naive = baselines(RunData(x=x), rows, mean_motion(state_data([x])))
    assert naive["cells"]["mean motion"] < model.card.training["cells"]["model"]


def test_replicates_are_one_run():
    (x,) = oscillator()
    model = reduce(state_data([x, x, x]), order=2, method=LeastSquares(), test=state_data([x]))
    assert not model.card.held_out
    assert "training error only" in model.card.verdict
    assert "do not count" in " ".join(model.card.warnings)
    # a run of its own is held out
    other = state_data(oscillator(runs=2)[1:])
    model = reduce(state_data([x, x, x]), order=2, method=LeastSquares(), test=other)
    assert "better than" in model.card.verdict


def test_runs_that_a_baseline_describes_exactly_cannot_rank_models():
    """All runs the same motion but for rounding: neither the model nor the mean is worse."""
    (x,) = oscillator()
    shifted = state_data([x + 1e-3 * k for k in range(3)])
    model = reduce(shifted, order=3, method=LeastSquares(), test=state_data([x + 5e-3]))
    row = model.card.held_out["cells"]
    assert row["mean motion"] < 1e-9
    assert row["model"] < 1e-6
    assert "cannot tell a model from it" in model.card.verdict


def test_an_undamped_exact_model_does_not_grow():
    (x,) = oscillator()
    for arrays in ([x], oscillator(runs=4)):
        model = reduce(state_data(arrays), order=2, method=LeastSquares())
        assert abs(model.growth()) < 1e-12
        assert "growing" not in model.card.verdict
        report = stability(model.plant(), certainty=model.certainty())
        assert report.verdict == "not decided"
        assert np.all(np.isinf(damping(model.plant(), certainty=model.certainty()).time_constant))
    # the same run with a mode that truly grows, twice its size at the end
    grown = x * np.exp(np.log(2) / 20 * 0.1 * np.arange(200))[:, None]
    model = reduce(state_data([grown]), order=2, method=LeastSquares())
    assert "it has a growing mode (0.035 +- " in model.card.verdict


def undecided_runs(runs=6):
    """A slow mode that grows in some runs and decays in others: its mean rate is next to 0."""
    rates = 0.02 * np.array([1, 1, -1, -1, 1, -1])[:runs]
    t = 0.1 * np.arange(60)
    wide = np.array([[1.0, 0.3], [0.2, 1.0]])
    return state_data(
        [
            np.stack([np.exp(-2.0 * t), (-1) ** i * np.exp(r * t)], axis=1) @ wide
            for i, r in enumerate(rates)
        ]
    )


def test_the_larger_of_two_bounds_is_shown_everywhere(tmp_path):
    data = undecided_runs()
    model = reduce(data, order=2, method=LeastSquares())
    known = model.certainty()
    slow = int(np.argmax(model.poles().real))
    assert known.spread[slow] > 2 * abs(known.poles[slow].real)  # its sign is open
    plain, told = cs_poles(model.plant()), cs_poles(model.plant(), certainty=known)
    assert plain.error_bound.max() < 1e-10  # rounding alone would call it certain
    assert np.allclose(np.sort(told.error_bound), np.sort(known.spread), rtol=1e-6)
    assert stability(model.plant()).verdict in ("stable", "unstable")
    report = stability(model.plant(), certainty=known)
    assert report.verdict == "not decided"
    assert "not decided by the data" in report.reason
    assert report.poles.error_bound.max() == told.error_bound.max()
    # kept in the file, and in the z plane too
    again = LatentModel.load(model.save(tmp_path / "m.npz"))
    assert np.array_equal(again.certainty().spread, known.spread)
    step = stability(model.plant(discrete=True), certainty=again.certainty(discrete=True))
    assert step.verdict == "not decided"
    with pytest.raises(ParameterError, match="z plane"):
        stability(model.plant(), certainty=again.certainty(discrete=True))
    other = LatentModel(A=[[-1.0, 0.0], [0.0, -2.0]])
    with pytest.raises(ParameterError, match="other poles"):
        stability(other.plant(), certainty=known)


def test_certainty_of_poles():
    data = one_step_data(seed=9, runs=5, T=60)
    result = pole_certainty(data, PCR(), 6)
    assert np.array_equal(result.poles, PCR().fit(data, 6, basis=fit_basis(data, 6)).poles())
    assert result.spread.shape == (6,)
    assert np.all(result.spread > 0)
    # of one run: stretches of it are left out
    single = pole_certainty(one_step_data(runs=1), PCR(), 3)
    assert single.left_out == "stretch"
    assert np.all(single.spread > 0)
    # in the training basis: the order of the runs does not matter
    turned = dataclasses.replace(data, runs=data.runs[::-1])
    again = pole_certainty(turned, PCR(), 6)
    assert np.abs(np.sort(again.spread) - np.sort(result.spread)).max() < 1e-6


@pytest.mark.parametrize("method", [PCR(), LeastSquares(), Ridge(step=0.2), Contractive()])
def test_spread_is_that_of_models_fitted_without_each_run(method):
    """Oracle: new fits in the same basis on data without a run, poles matched by hand."""
    data = one_step_data(seed=2, runs=4, T=60, commands=True)
    basis = fit_basis(data, 3)
    result = pole_certainty(data, method, 3, basis)
    far = np.zeros(3)
    for i in range(4):
        rest = dataclasses.replace(data, runs=tuple(r for j, r in enumerate(data.runs) if j != i))
        other = method.fit(rest, 3, basis=basis).poles()
        best = min(itertools.permutations(other), key=lambda o: np.abs(result.poles - o).sum())
        far = np.maximum(far, np.abs(result.poles - np.array(best)))
    real = np.abs(result.poles.imag) < 1e-12
    assert np.allclose(result.spread[real], far[real], rtol=1e-8)
    assert np.all(result.spread >= far - 1e-12)


def test_data_that_are_no_places_are_not_called_so():
    rng = np.random.default_rng(0)
    model = reduce(snapshots([rng.standard_normal((40, 3)).cumsum(0)], dt=1.0), order=2,
                   method=LeastSquares())  # fmt: skip
    assert set(model.card.training) == {"states"}
    assert "um^2" not in str(model.card)
    places = reduce(state_data(oscillator()), order=2, method=LeastSquares())
    assert "um^2" in str(places.card)
