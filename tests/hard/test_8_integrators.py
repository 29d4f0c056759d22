"""Integrators: stiff sets, jumps and pulses in the right-hand side, late NaN, tight tolerances."""

import numpy as np
import pytest

from cellsys.errors import CellsysError, DataError, IntegrationError, NotSymbolicError
from cellsys.integrate import (
    CVODES,
    DOP853,
    IDAS,
    LSODA,
    ExplicitEuler,
    LinearlyImplicit,
    Radau,
    RungeKutta4,
    simulate,
)
from cellsys.system import OdeSystem
from tests import naive
from tests.hard.stress import SEED, Case, Choice, Power, Real, hold
from tests.integrate.problems import E5, HIRES, OREGO, ROBER, VDPOL
from tests.integrate.test_hybrid import Hybrid
from tests.integrate.toys import Springs, scalar

NUMERIC = (DOP853, LSODA, Radau)


@pytest.mark.parametrize("problem", [HIRES, OREGO, ROBER, VDPOL], ids=lambda p: p.name)
@pytest.mark.parametrize("method", [CVODES, LSODA])
def test_stiff_sets_reach_their_published_ends(problem, method):
    run = simulate(
        problem.system, method(rtol=1e-9, atol=1e-13), [0.0, problem.end], auxiliaries=False
    )
    # global error of BDF and Adams codes: 10 to some 1000 rtol; published to 10 digits
    assert np.abs(run.x[-1] / np.array(problem.values) - 1).max() < 3e-5


def test_an_explicit_method_of_fixed_step_does_not():
    with pytest.raises(IntegrationError):
        simulate(HIRES.system, RungeKutta4(step=0.2), [0.0, 321.8122], auxiliaries=False)
    assert not np.isfinite(naive.fixed_step_end(HIRES.system, 321.8122, 0.2)).all()


def test_concentrations_stay_where_they_add_up():
    """ROBER conserves its sum; E5 has states of 1e-20 beside 1e-3."""
    run = simulate(ROBER.system, CVODES(rtol=1e-8, atol=1e-14), [0.0, 1e2, 1e4], auxiliaries=False)
    assert np.abs(run.x.sum(axis=1) - 1).max() < 1e-7
    run = simulate(E5.system, Radau(rtol=1e-8, atol=1e-24), [0.0, E5.end], auxiliaries=False)
    assert run.x[-1, 1] - run.x[-1, 2] - run.x[-1, 3] == pytest.approx(0, abs=1e-16)


def linear_relaxation(rate, method, tol, end):
    """x' = rate (1 - x) for rates 1e-8..1e8: 1 - exp(-rate t), stiff or frozen."""
    system = scalar(lambda t, x: [rate * (1.0 - x[0])], x0=[0.0])
    run = simulate(system, method(rtol=tol, atol=1e-2 * tol), [0.0, 0.5 * end, end])
    want = -np.expm1(-rate * np.array([0.5, 1.0]) * end)
    assert np.abs(run.x[1:, 0] - want).max() < 3e3 * tol


def test_explicit_steps_of_a_fast_relaxation():
    linear_relaxation(1e8, Radau, 1e-6, 1e4)
    system = scalar(lambda t, x: [1e8 * (1.0 - x[0])], x0=[0.0])
    assert not np.isfinite(naive.fixed_step_end(system, 100.0, 0.1)).all()


def a_pulse_shorter_than_a_step_is_felt(start, width, method):
    """A pulse of area 1 anywhere in 100 s: felt whole where its edges are named as stop points.

    The law is continuous from the right: the piece that ends at a stop point takes its left limit.
    """

    def push(t, x):
        return np.array([1.0 / width if start <= t < start + width else 0.0])

    given = {"states": ["x"], "x0": [0.0], "forcing": push}
    system = Hybrid(stops=(start, start + width), **given)
    run = simulate(system, method(rtol=1e-8, atol=1e-10), [0.0, 100.0], auxiliaries=False)
    # an edge is hit to a rounding of its time
    assert abs(run.x[-1, 0] - 1.0) < 1e-6 + 1e-13 / width


def test_a_pulse_is_missed_without_its_edges():
    def push(t, x):
        return np.array([1e4 if 50.0 < t < 50.0001 else 0.0])

    blind = OdeSystem(states=["x"], x0=[0.0], forcing=push)
    assert abs(simulate(blind, DOP853(rtol=1e-8, atol=1e-10), [0.0, 100.0]).x[-1, 0] - 1) > 0.5
    a_pulse_shorter_than_a_step_is_felt(50.0, 1e-4, DOP853)


def nan_late_is_named(when, method):
    """A law that turns NaN at a time: an error with that time, the state and the step."""
    system = OdeSystem(
        states=["x"], x0=[1.0], forcing=lambda t, x: np.array([np.nan if t > when else -x[0]])
    )
    with pytest.raises(IntegrationError) as caught:
        simulate(system, method(rtol=1e-6, atol=1e-9), np.linspace(0.0, 10.0, 11))
    assert 0.0 <= caught.value.time <= 10.0
    assert np.isfinite(caught.value.state_norm)
    assert caught.value.step >= 0.0


@pytest.mark.parametrize("method", [*NUMERIC, CVODES])
@pytest.mark.parametrize("late", [0.0, 1e-9, 1e-4])
def test_a_law_that_is_nan_from_the_start_does_not_hang(method, late):
    """scipy's first step becomes NaN, and is tried for ever."""
    system = OdeSystem(
        states=["x"], x0=[1.0],
        forcing=lambda t, x: np.array([-x[0] if t < late else np.nan]),
    )  # fmt: skip
    with pytest.raises((IntegrationError, NotSymbolicError)):
        simulate(system, method(rtol=1e-6, atol=1e-9), [0.0, 1.0], auxiliaries=False)


@pytest.mark.parametrize("value", [0, -1, np.nan, "a", None, 1j, [1e-6]])
def test_tolerances_and_steps_that_are_none(value):
    for method in (*NUMERIC, CVODES, IDAS):
        with pytest.raises(CellsysError, match=r"rtol|atol"):
            method(rtol=value, atol=1e-8)
        with pytest.raises(CellsysError, match=r"rtol|atol"):
            method(rtol=1e-6, atol=value)
    for method in (LinearlyImplicit, ExplicitEuler, RungeKutta4):
        with pytest.raises(CellsysError, match="step"):
            method(step=value)
    decay = scalar(lambda t, x: [-x[0]])
    for t in ([1j], ["a"], [0.0, 1e308], [-1e308, 1e308]):
        with pytest.raises(CellsysError):
            simulate(decay, DOP853(rtol=1e-6, atol=1e-9), t)
    for method in (ExplicitEuler, RungeKutta4):
        # 1e15 steps: refused before their times are stored
        with pytest.raises(CellsysError, match="steps"):
            simulate(decay, method(step=1e-15), [0.0, 1.0])


def test_naive_steps_return_the_nan():
    system = OdeSystem(
        states=["x"], x0=[1.0], forcing=lambda t, x: np.array([np.nan if t > 5 else -x[0]])
    )
    assert np.isnan(naive.fixed_step_end(system, 10.0, 0.1)).all()


@pytest.mark.parametrize("method", [DOP853, CVODES, LSODA])
def test_a_tolerance_of_rounding(method):
    """rtol = 1e-14: met to a few hundred roundings, or refused with its reason; no endless run."""
    system = scalar(lambda t, x: [-x[0]])
    said = ""
    try:
        run = simulate(system, method(rtol=1e-14, atol=1e-16), [0.0, 1.0, 5.0], auxiliaries=False)
    except CellsysError as refusal:
        said = str(refusal)
        run = None
    if run is None:
        assert "rtol" in said or "toler" in said or "failed" in said
    else:
        assert np.abs(run.x[:, 0] / np.exp(-run.t) - 1).max() < 1e-11


def test_a_tolerance_loosened_without_being_asked():
    assert naive.tolerance_taken(1e-14) > 1.5e-14


@pytest.mark.parametrize("t", [[0.0, 0.0], [1.0, 0.0], [0.0, np.nan], [], [[0.0, 1.0]]])
def test_intervals_that_are_none(t):
    with pytest.raises(CellsysError):
        simulate(scalar(lambda t, x: [-x[0]]), DOP853(rtol=1e-6, atol=1e-9), t)
    alone = simulate(scalar(lambda t, x: [-x[0]]), DOP853(rtol=1e-6, atol=1e-9), [3.0])
    assert alone.x.shape == (1, 1)


def tiny_and_huge_intervals(start, length, method):
    """From t = start over `length`: as small as rounding of t lets it be, or refused."""
    system = scalar(lambda t, x: [-1e-3 * x[0]])
    run = simulate(system, method(rtol=1e-8, atol=1e-12), [start, start + length])
    elapsed = (start + length) - start
    assert abs(run.x[-1, 0] - np.exp(-1e-3 * elapsed)) < 1e-5
    assert run.t[-1] == start + length


def test_a_short_interval_far_from_zero():
    tiny_and_huge_intervals(1e7, 1e-6, DOP853)
    # naive: a time that steps are added to; 1e-10 s at 1e7 s is below its rounding
    assert naive.accumulated(1e7, 1e-10, 10**4) == 1e7


def implicit_steps_halve_their_error(stiffness, pull, seed):
    """Springs from soft to stiff: first order in the step, bounded at the largest."""
    ends = []
    for step in (0.1, 0.05, 0.025, 0.0125):
        system = Springs(stiffness=stiffness, pull=pull)
        run = simulate(system, LinearlyImplicit(step=step), [0.0, 4.0], auxiliaries=False)
        ends.append(run.x[-1])
    assert np.all(np.isfinite(ends))
    far, near = (np.abs(a - b).max() for a, b in ((ends[1], ends[2]), (ends[2], ends[3])))
    # halving the step must not make it worse; 1e-9 is rounding of stiff solves
    assert near < 0.75 * far + 1e-9


def test_explicit_steps_blow_up_where_implicit_ones_hold():
    system = Springs(stiffness=1e5)
    held = simulate(system, LinearlyImplicit(step=0.1), [0.0, 4.0], auxiliaries=False)
    assert np.abs(held.x).max() < 10.0
    with pytest.raises(IntegrationError):
        simulate(Springs(stiffness=1e5), ExplicitEuler(step=0.1), [0.0, 4.0], auxiliaries=False)


def test_what_an_integrator_cannot_do_it_says():
    with pytest.raises(NotSymbolicError):
        simulate(Springs(), IDAS(rtol=1e-6, atol=1e-8), [0.0, 1.0])
    with pytest.raises(DataError):
        simulate(scalar(lambda t, x: [-x[0]]), DOP853(rtol=1e-6, atol=1e-9), [0, 1], x0=[np.nan])


METHODS = Choice(*NUMERIC)
CASES = (
    Case(
        "relaxation",
        linear_relaxation,
        {
            "rate": Power(-8, 8),
            "method": Choice(LSODA, Radau),
            "tol": Power(-9, -4),
            "end": Power(-2, 4),
        },
    ),
    Case(
        "short pulse",
        a_pulse_shorter_than_a_step_is_felt,
        {"start": Real(0, 99), "width": Power(-6, -0.3), "method": METHODS},
    ),
    Case("NaN late", nan_late_is_named, {"when": Real(0.1, 9.9), "method": METHODS}),
    Case(
        "intervals",
        tiny_and_huge_intervals,
        {"start": Power(-3, 7), "length": Power(-6, 5), "method": METHODS},
    ),
    Case(
        "implicit steps",
        implicit_steps_halve_their_error,
        {"stiffness": Power(-1, 4), "pull": Power(-1, 1.3), "seed": SEED},
    ),
)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_random_instances(case):
    hold(case, 4)
