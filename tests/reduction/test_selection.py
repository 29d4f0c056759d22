"""Selection split by run and nested; learning curve; no number leaks."""

import dataclasses

import matplotlib as mpl
import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import DataError, ParameterError
from cellsys.reduction import LeastSquares, Ridge, candidates, learning_curve, reduce, select_model
from cellsys.reduction.comparison import described
from cellsys.reduction.selection import deal
from tests.reduction.systems import spreading_data

mpl.use("Agg")

SEEN = []


@dataclasses.dataclass(frozen=True)
class Spy:
    """Least squares that notes which runs it was fitted to."""

    name = "Spy"
    own_basis = True

    def fit(self, data, order, *, test=None, basis=None):
        SEEN.append({r.label for r in data.runs})
        return LeastSquares().fit(data, order)


def test_grid():
    methods = candidates(Ridge(), {"ridge": [1e-3, 1.0], "step": [5.0, 10.0, 20.0]})
    assert len(methods) == 6
    assert methods[1] == Ridge(ridge=1e-3, step=10.0)
    with pytest.raises(ParameterError, match="it has ridge, step, svd"):
        candidates(Ridge(), {"rigde": [1.0]})


def test_a_method_in_words():
    assert described(Ridge()) == "Ridge()"
    assert described(Ridge(ridge=2.0, step=5.0)) == "Ridge(ridge=2.0, step=5.0)"
    assert described(Spy()) == "Spy()"


def test_runs_are_dealt_whole_and_once():
    for n, folds in ((7, 3), (3, 5), (8, 4)):
        groups = deal(list(range(n)), folds)
        assert sorted(i for g in groups for i in g) == list(range(n))
        assert all(groups)


def test_nothing_that_is_measured_on_was_learned_from():
    """Outer held-out runs are absent from every fit that chooses for them."""
    data = spreading_data(runs=6, T=40)
    SEEN.clear()
    chosen = select_model(data, [Spy()], [2, 4], folds=3, inner=2)
    labels = {r.label for r in data.runs}
    # per outer fold 2 inner folds x 2 orders and one refit, in this order
    for k, fold in enumerate(chosen.folds):
        fits = SEEN[5 * k : 5 * k + 5]
        assert all(not (seen & set(fold.runs)) for seen in fits)
        assert fits[4] == labels - set(fold.runs)
    assert SEEN[-1] == labels
    assert {label for f in chosen.folds for label in f.runs} == labels


def test_the_choice_is_the_best_candidate_and_the_nested_error_is_that_of_its_folds():
    data = spreading_data(runs=6, T=60)
    methods = [LeastSquares(), *candidates(Ridge(), {"ridge": [1e-2, 100.0]})]
    chosen = select_model(data, methods, [3, 10], folds=3, inner=2)
    assert chosen.rows[0].error == min(r.error for r in chosen.rows)
    assert (chosen.settings, chosen.order) == (chosen.rows[0].settings, chosen.rows[0].order)
    assert chosen.model.order == chosen.order
    assert chosen.error == pytest.approx(np.sqrt(np.mean([f.error**2 for f in chosen.folds])))
    # a penalty that leaves no dynamics must lose
    worst = max(chosen.rows, key=lambda r: r.error)
    assert "100.0" in worst.settings
    fold = chosen.folds[0]
    kept = tuple(r for r in data.runs if r.label not in fold.runs)
    out = tuple(r for r in data.runs if r.label in fold.runs)
    method = next(m for m in methods if described(m) == fold.settings)
    card = reduce(
        dataclasses.replace(data, runs=kept),
        order=fold.order,
        method=method,
        test=dataclasses.replace(data, runs=out),
    ).card
    assert fold.error == pytest.approx(card.held_out["cells"]["model"], rel=1e-6)
    again = cs.select_model(data, methods, [3, 10], folds=3, inner=2)
    assert [r.error for r in again.rows] == [r.error for r in chosen.rows]
    assert "nested error" in str(chosen)
    chosen.plot()
    mpl.pyplot.close("all")


@pytest.mark.slow
def test_choosing_on_the_test_runs_flatters():
    """Pure noise has nothing to choose: the best of many candidates looks better than it is."""
    rng = np.random.default_rng(1)
    runs = [np.cumsum(rng.standard_normal((12, 3)), axis=0) for _ in range(5)]
    data = cs.snapshots(runs, dt=1.0, scale="none")
    methods = candidates(Ridge(), {"ridge": [0.0, 0.03, 0.3, 3.0, 30.0], "step": [1.0, 2.0, 3.0]})
    chosen = select_model(data, methods, [1, 2, 3], folds=5, inner=4)
    naive = min(r.error for r in chosen.rows)  # selection and report on the same folds
    assert naive == chosen.validation_error
    assert naive < chosen.error


def test_learning_curve():
    train, test = spreading_data(runs=4, T=50), spreading_data(runs=2, T=50, first=4)
    curve = learning_curve(train, test, LeastSquares(), 6, draws=2)
    assert curve.counts == (1, 2, 4)
    card = reduce(train, order=6, method=LeastSquares(), test=test).card
    assert curve.held_out[-1] == pytest.approx(card.held_out["cells"]["model"], rel=1e-9)
    assert curve.training[-1] == pytest.approx(card.training["cells"]["model"], rel=1e-9)
    assert curve.held_out_spread[-1] == 0.0  # one draw is all there is
    # one run of six directions with inputs says less than four
    assert curve.held_out[-1] < curve.held_out[0]
    assert "held out" in str(curve)
    curve.plot()
    mpl.pyplot.close("all")


def test_refusals():
    data = spreading_data(runs=2, T=20)
    with pytest.raises(DataError, match="at least 3 runs"):
        select_model(data, [Ridge()], [2])
    with pytest.raises(ParameterError, match="at least one"):
        select_model(data, [], [2])
    with pytest.raises(ParameterError, match="folds"):
        select_model(data, [Ridge()], [2], folds=1)
    with pytest.raises(ParameterError, match="split by run"):
        learning_curve(data, data, Ridge(), 2)
    other = spreading_data(runs=1, T=20, first=2)
    with pytest.raises(ParameterError, match="between 1 and the 2"):
        learning_curve(data, other, Ridge(), 2, [3])
