"""Models from the equations: exact on linear systems, tangent on nonlinear ones, piecewise."""

from itertools import pairwise

import numpy as np
import pytest

from cellsys.errors import DataError, DimensionError, IntegrationError, ParameterError
from cellsys.integrate import CVODES, simulate
from cellsys.reduction import TPWL, Jacobian, compare_reductors, reduce
from cellsys.reduction.piecewise import PiecewiseModel, farthest_points
from cellsys.samples import snapshots
from cellsys.system import OdeSystem


def cubic(stiffness=0.5, forcing=None):
    """Three masses on a line of cubic springs, overdamped, tied to a wall."""
    W = np.array([[-1.0, 1.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, -1.0]])

    def springs(t, x):
        s = [x[0], x[1] - x[0], x[2] - x[1]]
        return [v + stiffness * v * v * v for v in s]

    return OdeSystem(
        states=["a", "b", "c"],
        auxiliaries=["f", "g", "h"],
        x0=np.array([0.5, 1.0, 2.0]),
        W_eta=W,
        law=springs,
        forcing=forcing,
    )


def tangent(x, stiffness=0.5):
    W = np.array([[-1.0, 1.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, -1.0]])
    E = np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])
    return W @ np.diag(1 + 3 * stiffness * (E @ x) ** 2) @ E


def runs_of(system, starts, t_end=4.0, samples=81):
    t = np.linspace(0.0, t_end, samples)
    return [simulate(system, CVODES(rtol=1e-10, atol=1e-12), t, np.array(x)) for x in starts]


STARTS = ([0.5, 1.0, 2.0], [-1.0, 0.3, 0.2], [1.0, -1.0, 0.5])


def test_poles_are_those_of_the_tangent():
    system = cubic()
    data = snapshots(runs_of(system, STARTS))
    for at in (None, [0.0, 0.0, 0.0], [1.0, -0.5, 2.0]):
        model = Jacobian(system, at).fit(data, 3)
        exact = np.linalg.eigvals(tangent(system.x0 if at is None else np.array(at)))
        # central differences of a cubic: h^2 = 1e-10 and rounding 1e-11
        assert np.abs(np.sort(model.poles().real) - np.sort(exact.real)).max() < 1e-8
        assert model.dt is None
        # the affine part: z' of the model at the point is f there
        x = system.x0 if at is None else np.array(at)
        z = model.encode(x)
        slope = model.scale * (model.V @ (model.A @ z + model.offset))
        assert np.abs(slope - system.rhs(0.0, x)).max() < 1e-8


def test_a_linear_system_is_predicted_exactly_with_its_input():
    def push(t, x):
        return [0.0, 0.0, 0.7]

    system = cubic(0.0, push)
    runs = runs_of(system, STARTS)
    model = reduce(snapshots(runs), order=3, method=Jacobian(system))
    data = snapshots(runs)
    z = model.predict(model.encode(runs[1].x[0]), np.asarray(data.runs[1].u), runs[1].t)
    # the reference's tolerance, 1e-10 a step, over 80 samples
    assert np.abs(model.reconstruct(z) - runs[1].x).max() < 1e-7
    assert model.card.training["states"]["model"] < 1e-6


def test_states_that_are_not_learned_are_held():
    system = cubic()
    data = snapshots(runs_of(system, STARTS))
    more = OdeSystem(
        states=["q", "a", "b", "c"],
        auxiliaries=["f", "g", "h"],
        x0=np.array([7.0, *system.x0]),
        W_eta=np.vstack([np.zeros(3), system.W_eta.toarray()]),
        law=lambda t, x: system.law(t, x[1:]),
    )
    a, b = Jacobian(system).fit(data, 3), Jacobian(more).fit(data, 3)
    assert np.allclose(a.A, b.A, rtol=1e-12, atol=1e-12)


def test_one_piece_is_the_jacobian_at_the_start_and_more_pieces_are_better():
    system = cubic(2.0)
    train = snapshots(runs_of(system, STARTS))
    test = snapshots(runs_of(system, ([0.6, 0.9, 1.8],)))
    for run in test.runs:
        object.__setattr__(run, "label", "held out")
    one = TPWL(system, points=1).fit(train, 3)
    linear = Jacobian(system).fit(train, 3)
    t = np.linspace(0.0, 1.0, 11)
    fine = PiecewiseModel(
        frozen=one.frozen, points=one.points, A=one.A, offset=one.offset, step=1e-3
    )
    z0 = linear.encode(system.x0)
    exact = linear.predict(z0, None, t)
    # second order: h^2 |A|^3 with h = 1e-3, |A| about 30
    assert np.abs(fine.predict(z0, None, t) - exact).max() < 1e-2 * np.abs(exact).max()
    table = compare_reductors(
        train, test, [3], [Jacobian(system), TPWL(system, 5), TPWL(system, 40)]
    )
    error = [r.error for r in table.rows]
    assert error[2] < 0.3 * error[0]
    assert [r.method for r in table.rows] == ["Jacobian", "TPWL", "TPWL"]


def test_integration_of_the_pieces_is_of_second_order():
    system = cubic(2.0)
    model = TPWL(system, 8).fit(snapshots(runs_of(system, STARTS)), 3)
    t, ends = np.array([0.0, 0.8]), []
    for step in (0.02, 0.01, 0.005, 0.0025):
        of = PiecewiseModel(
            frozen=model.frozen, points=model.points, A=model.A, offset=model.offset, step=step
        )
        ends.append(of.predict(model.encode(system.x0), None, t)[-1])
    change = [np.linalg.norm(b - a) for a, b in pairwise(ends)]
    # the blend is smooth but sharp: order 2 within half an order
    assert np.log2(change[1] / change[2]) > 1.5


def test_weights_and_points():
    model = TPWL(cubic(), 6).fit(snapshots(runs_of(cubic(), STARTS)), 2)
    assert model.weights(model.points[2]).tolist() == [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    w = model.weights(model.points[2] + 1e-3)
    assert w[2] > 0.99
    assert w.sum() == pytest.approx(1.0)
    assert np.allclose(model.at(model.points[3]).A, model.A[3])
    assert len(model.poles(model.points[1])) == 2
    line = np.arange(11.0)[:, None]
    assert farthest_points(line, 3) == [0, 10, 5]
    assert farthest_points(np.zeros((4, 2)), 3) == [0]


def test_a_piecewise_model_has_a_card_like_any_other():
    system = cubic()
    model = reduce(snapshots(runs_of(system, STARTS)), order=2, method=TPWL(system, 4))
    assert "TPWL(OdeSystem, points=4)" in str(model.card)
    assert model.card.training["states"]["model"] > 0


def test_refusals():
    system = cubic()
    data = snapshots(runs_of(system, STARTS[:2]))
    with pytest.raises(DimensionError, match="shape"):
        Jacobian(system, [0.0])
    with pytest.raises(DataError, match="NaN"):
        Jacobian(system, [0.0, np.nan, 0.0])
    with pytest.raises(ParameterError, match="points"):
        TPWL(system, 0)
    other = OdeSystem(states=["z"], x0=[0.0])
    with pytest.raises(DimensionError, match="'a'"):
        Jacobian(other).fit(data, 2)
    model = TPWL(system, 3).fit(data, 2)
    grown = PiecewiseModel(
        frozen=model.frozen,
        points=model.points,
        A=model.A + 9 * np.eye(2),
        offset=model.offset,
        step=0.05,
    )
    with pytest.raises(IntegrationError, match="diverges"):
        grown.predict(np.ones(2), None, np.arange(0.0, 200.0))
    for z0, u, t, error in (
        (np.ones(3), None, [0.0, 1.0], DimensionError),
        (np.ones(2), None, [1.0, 0.0], DataError),
        (np.ones(2), np.ones(5), [0.0, 1.0], DimensionError),
    ):
        with pytest.raises(error):
            model.predict(z0, u, np.array(t))
