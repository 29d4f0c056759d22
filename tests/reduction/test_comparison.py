"""Reductors side by side: the table's numbers, divergence as a row, refusals, the figure."""

import matplotlib as mpl
import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import ParameterError, RankError
from cellsys.model import LatentModel
from cellsys.model.card import BASELINES
from cellsys.reduction import PCR, Contractive, LeastSquares, Ridge, reduce
from cellsys.reduction.comparison import compare_reductors
from tests.reduction.systems import spreading_data

mpl.use("Agg")


class Growing:
    """A reductor whose models leave all bounds within a run."""

    name = "Growing"
    own_basis = True

    def fit(self, data, order, *, test=None, basis=None):
        model = LeastSquares().fit(data, order)
        A = model.A + 2.0 * np.eye(order)
        return LatentModel(
            A=A, B=model.B, V=model.V, mean=model.mean, scale=model.scale, dt=model.dt,
            n_states=model.n_states, input_names=model.input_names,
        )  # fmt: skip


def test_rows_are_the_cards_of_the_models():
    train, test = spreading_data(runs=3), spreading_data(runs=2, first=3)
    methods = [PCR(), LeastSquares(), Ridge(step=20.0), Contractive(iterations=5)]
    table = compare_reductors(train, test, [3, 8], methods)
    assert [(r.method, r.order) for r in table.rows] == [
        (m.name, k) for m in methods for k in (3, 8)
    ]
    for method in methods[1:3]:
        # a basis of order 8 serves order 3: the same up to rounding
        held = reduce(train, order=3, method=method, test=test).card.held_out["cells"]
        row = table.row(method.name, 3)
        assert row.error == pytest.approx(held["model"], rel=1e-7)
        assert row.floor == pytest.approx(held["floor"], rel=1e-7)
    # other entries of a card's row (spreads, shares of runs) are no baselines
    assert set(table.baselines) >= {"nothing moves", "mean velocity", "mean motion"}
    assert set(table.baselines) <= set(BASELINES)
    assert table.baselines["nothing moves"] == 1.0
    # a coarse step's radius is per step of its own
    row = table.row("Ridge", 8)
    assert row.radius == pytest.approx(np.exp(20.0 * row.abscissa), rel=1e-12)
    assert all(r.fit_s > 0 and r.roll_out_ms > 0 for r in table.rows)
    assert table.best.error == min(r.error for r in table.rows)
    assert "held out" in str(table)


def test_a_diverging_model_is_a_row_that_says_so():
    train, test = spreading_data(runs=2), spreading_data(runs=1, first=2)
    table = compare_reductors(train, test, [4], [LeastSquares(), Growing()])
    bad = table.row("Growing", 4)
    assert bad.diverges
    assert np.isinf(bad.error)
    assert bad.abscissa > 0
    assert "diverges" in str(table)
    assert "grows like exp(" in str(table)
    assert not table.best.diverges
    only = compare_reductors(train, test, [4], [Growing()])
    assert "predict with none" in only.verdict()
    assert only.plot() is not None


def test_it_draws_itself():
    train, test = spreading_data(runs=2), spreading_data(runs=1, first=2)
    table = cs.compare_reductors(train, test, [2, 5], [LeastSquares(), Ridge(), PCR(literal=True)])
    ax = table.plot()
    names = [t.get_text() for t in ax.get_legend().get_texts()]
    assert names[:3] == ["LeastSquares", "Ridge", "PCR (literal)"]
    assert "projection floor" in names
    mpl.pyplot.close("all")


def test_refusals():
    train, test = spreading_data(runs=2), spreading_data(runs=1, first=2)
    with pytest.raises(ParameterError, match="split by run"):
        compare_reductors(train, train, [2])
    with pytest.raises(ParameterError, match="at least one"):
        compare_reductors(train, test, [])
    with pytest.raises(ParameterError, match="order"):
        compare_reductors(train, test, [0])
    with pytest.raises(RankError):
        compare_reductors(train, test, [500])
