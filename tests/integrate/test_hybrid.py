"""Root-found events, reset maps, stop points and the order of the variable-step methods."""

from __future__ import annotations

import numpy as np
import pytest

from cellsys.errors import IntegrationError, ParameterError
from cellsys.integrate import (
    CVODES,
    DOP853,
    LSODA,
    ExplicitEuler,
    Radau,
    RungeKutta4,
    simulate,
)
from cellsys.system import EventFunction, OdeSystem

METHODS = (DOP853, LSODA, Radau)


class Hybrid(OdeSystem):
    """A system with given events and stop points."""

    def __init__(self, events=(), stops=(), **kwargs):
        super().__init__(**kwargs)
        object.__setattr__(self, "_given", (tuple(events), tuple(stops)))

    def events(self):
        return self._given[0]

    def stop_points(self):
        return self._given[1]


def ball(level=False, restitution=0.8):
    """Falls from height 1 with g = 2: bounces at t = 1, then after 2 e, 2 e^2, ..."""
    bounce = EventFunction(
        name="bounce",
        guard=lambda t, x: x[0],
        direction=-1,
        reset=lambda t, x: np.array([0.0, -restitution * x[1]]),
        level=level,
    )
    return Hybrid(
        [bounce], states=["height", "speed"], x0=[1.0, 0.0], W_x=[[0, 1], [0, 0]],
        forcing=lambda t, x: np.array([0.0, -2.0]),
    )  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
def test_bouncing_ball(method):
    run = simulate(ball(), method(rtol=1e-10, atol=1e-12), np.linspace(0, 5, 51))
    e = 0.8
    expected = np.cumsum([1.0, 2 * e, 2 * e**2, 2 * e**3])
    expected = expected[expected < 5]
    times = np.array([ev.time for ev in run.events])
    # Errors of 1e-10 at each of the three bounces, amplified by 1/e per bounce; LSODA's global
    # error is some 50 tolerances.
    np.testing.assert_allclose(times, expected, rtol=0, atol=2e-8)
    assert {ev.name for ev in run.events} == {"bounce"}
    assert np.all(run.x[:, 0] > -1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_energy_between_bounces_and_averages(method):
    """x_k+1 - x_k = dt (W_x x + W_eta eta + u) + residual; the jump is in the residual."""
    run = simulate(ball(), method(rtol=1e-9, atol=1e-11), np.linspace(0, 1.5, 16))
    rate = np.diff(run.x, axis=0) / 0.1
    np.testing.assert_allclose(run.u[:, 1], -2.0, rtol=1e-12)
    residual = run.auxiliary("step_residual")
    jump = np.zeros(15)
    jump[9] = 1.8 * 2.0 / 0.1  # speed -2 -> 1.6 at t = 1, in the tenth or eleventh interval
    total = residual[:, 1] * 0.1
    assert total.sum() == pytest.approx(3.6, rel=1e-6)
    assert np.count_nonzero(np.abs(total) > 1e-6) == 1
    assert rate.shape == (15, 2)


@pytest.mark.parametrize("method", METHODS)
def test_a_guard_already_past_zero_fires_only_if_it_is_a_level(method):
    def system(level):
        event = EventFunction(
            name="low",
            guard=lambda t, x: x[0] - 1.0,
            direction=-1,
            reset=lambda t, x: np.array([x[0] + 2.0]),
            level=level,
        )
        return Hybrid([event], states=["x"], x0=[0.5], W_x=[[-1.0]])

    settings = method(rtol=1e-8, atol=1e-10)
    assert not simulate(system(False), settings, [0.0, 3.0]).events
    run = simulate(system(True), settings, [0.0, 3.0])
    assert run.events[0].time == 0.0
    # 2.5 decays to 1 in log 2.5, then 3 to 1 in log 3
    assert run.events[1].time == pytest.approx(np.log(2.5), abs=1e-6)
    assert run.events[2].time == pytest.approx(np.log(2.5) + np.log(3), abs=1e-6)


def test_two_guards_that_trigger_each_other_are_called_chattering():
    low = EventFunction(
        name="down",
        guard=lambda t, x: 1.0 - x[0],
        direction=-1,
        reset=lambda t, x: x - 1.0,
        level=True,
    )
    high = EventFunction(
        name="up",
        guard=lambda t, x: x[0] - 0.5,
        direction=-1,
        reset=lambda t, x: x + 1.0,
        level=True,
    )
    system = Hybrid([low, high], states=["x"], x0=[0.9], forcing=lambda t, x: np.ones(1))
    with pytest.raises(IntegrationError, match=r"chattering.*separate the thresholds") as error:
        simulate(system, DOP853(rtol=1e-6, atol=1e-8, cascade=20), [0.0, 1.0])
    assert error.value.time == pytest.approx(0.1, abs=1e-9)


def test_accumulating_bounces_are_called_chattering():
    """A ball with e = 0.3 has infinitely many bounces before t = 1 + 2 e/(1 - e) = 1.857."""
    with pytest.raises(IntegrationError, match="chattering") as error:
        simulate(ball(restitution=0.3), DOP853(rtol=1e-8, atol=1e-10, cascade=5), [0.0, 3.0])
    assert error.value.time == pytest.approx(1 + 2 * 0.3 / 0.7, abs=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_observed_crossings_of_either_direction(method):
    """An event without reset notes every zero of sin t, and only that."""

    def wave(direction):
        event = EventFunction(name="zero", guard=lambda t, x: x[0], direction=direction)
        return Hybrid([event], states=["s", "c"], x0=[0.0, 1.0], W_x=[[0, 1], [-1, 0]])

    settings = method(rtol=1e-9, atol=1e-11)
    for direction, expected in ((0, [1, 2, 3]), (-1, [1, 3]), (1, [2])):
        run = simulate(wave(direction), settings, np.linspace(0, 10, 7))
        times = np.array([e.time for e in run.events]) / np.pi
        np.testing.assert_allclose(times, expected, atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_no_step_crosses_a_stop_point(method):
    """dx/dt jumps from 0 to 1 at t = 1/3: exact at once if a step ends there."""

    def system(stops):
        return Hybrid(
            (), stops, states=["x"], x0=[0.0],
            forcing=lambda t, x: np.array([1.0 if t >= 1 / 3 else 0.0]),
        )  # fmt: skip

    settings = method(rtol=1e-6, atol=1e-9)
    run = simulate(system([1 / 3]), settings, [0.0, 0.5, 1.0])
    np.testing.assert_allclose(run.x[:, 0], [0, 0.5 - 1 / 3, 1 - 1 / 3], atol=1e-8)
    assert run.statistics["steps"] < 60


def forced(t, x):
    return np.array([np.cos(t) + np.sin(t)])


def test_order_of_the_runge_kutta_methods():
    """x' = -x + cos t + sin t, x = sin t: error ~ h^p with fixed steps (p = 8, 5)."""
    system = OdeSystem(states=["x"], x0=[0.0], W_x=[[-1.0]], forcing=forced)
    for method, order, steps in ((DOP853, 8, (1.0, 0.5, 0.25)), (Radau, 5, (0.5, 0.25, 0.125))):
        errors = []
        for h in steps:
            # A tolerance of 1e6 accepts every step, so h is the step throughout.
            settings = method(rtol=1e6, atol=1e6, first_step=h, max_step=h)
            run = simulate(system, settings, [0.0, 8.0])
            assert run.statistics["steps"] == round(8.0 / h)
            errors.append(abs(run.x[-1, 0] - np.sin(8.0)))
        slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
        assert order - 0.6 < slope < order + 1.2, (method.__name__, errors)


@pytest.mark.parametrize("method", METHODS)
def test_error_follows_the_tolerance(method):
    system = OdeSystem(states=["x"], x0=[0.0], W_x=[[-1.0]], forcing=forced)
    errors = []
    for tolerance in (1e-4, 1e-6, 1e-8):
        run = simulate(system, method(rtol=tolerance, atol=tolerance), np.linspace(0, 8, 9))
        errors.append(np.abs(run.x[:, 0] - np.sin(run.t)).max())
        assert errors[-1] < 100 * tolerance  # local control: global error some ten times more
    assert errors[2] < 0.05 * errors[0]


def test_agrees_with_cvodes_on_a_smooth_system():
    def law(t, x):
        return x[0] ** 3

    system = OdeSystem(
        states=["x", "v"], x0=[1.0, 0.0], auxiliaries=["e"], W_x=[[0, 1], [0, -0.1]],
        W_eta=[[0], [-1.0]], law=law,
    )  # fmt: skip
    t = np.linspace(0, 5, 26)
    a = simulate(system, DOP853(rtol=1e-10, atol=1e-12), t)
    b = simulate(system, CVODES(rtol=1e-10, atol=1e-12), t)
    np.testing.assert_allclose(a.x, b.x, atol=1e-7)
    np.testing.assert_allclose(a.eta[:, 0], b.eta[:, 0], atol=1e-7)  # interval averages alike
    rests = [run.auxiliary("step_residual")[:, 0] for run in (a, b)]
    np.testing.assert_allclose(*rests, atol=1e-6)


def test_failures_are_typed():
    blow = OdeSystem(states=["x"], x0=[1.0], auxiliaries=["e"], W_eta=[[1.0]],
                     law=lambda t, x: x**2)  # fmt: skip
    for method in METHODS:
        with pytest.raises(IntegrationError) as error:
            simulate(blow, method(rtol=1e-6, atol=1e-8, max_steps=5000), [0.0, 2.0])
        assert 0.5 < error.value.time <= 2.0
    stiff = OdeSystem(states=["x"], x0=[1.0], W_x=[[-1e5]])
    with pytest.raises(IntegrationError, match="spent its 100 steps"):
        simulate(stiff, DOP853(rtol=1e-6, atol=1e-8, max_steps=100), [0.0, 10.0])
    bad = EventFunction(
        name="bad",
        guard=lambda t, x: x[0] - 0.5,
        direction=-1,
        reset=lambda t, x: np.array([np.nan]),
    )
    decay = Hybrid([bad], states=["x"], x0=[1.0], W_x=[[-1.0]])
    with pytest.raises(IntegrationError, match="reset of event 'bad'"):
        simulate(decay, DOP853(rtol=1e-6, atol=1e-8), [0.0, 2.0])


@pytest.mark.parametrize("method", METHODS)
def test_settings_are_checked(method):
    with pytest.raises(TypeError):
        method()
    with pytest.raises(ParameterError, match="rtol must be > 0"):
        method(rtol=0.0, atol=1e-6)
    with pytest.raises(ParameterError, match="first_step"):
        method(rtol=1e-6, atol=1e-6, first_step=-1.0)
    level = EventFunction(name="l", guard=lambda t, x: x[0], direction=0, reset=None, level=True)
    system = Hybrid([level], states=["x"], x0=[1.0], W_x=[[-1.0]])
    with pytest.raises(ParameterError, match="level needs direction"):
        simulate(system, method(rtol=1e-6, atol=1e-6), [0.0, 1.0])


@pytest.mark.parametrize(
    "other", [CVODES(rtol=1e-6, atol=1e-8), RungeKutta4(step=0.1), ExplicitEuler(step=0.1)]
)
def test_methods_without_event_location_refuse_a_system_with_events(other):
    with pytest.raises(ParameterError, match=r"does not look for events.*'bounce'.*DOP853"):
        simulate(ball(), other, [0.0, 1.0])
