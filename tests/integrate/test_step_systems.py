"""Systems with a step of their own, run by the one `simulate`."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import cellsys as cs
from cellsys.integrate import StepRun
from cellsys.system import Event
from tests.loop.systems import make


@dataclass(frozen=True)
class Midpoint:
    """z' = a z + u by the implicit midpoint rule: a system of one's own, nothing inherited."""

    a: float = -0.1
    dt: float = 0.5

    states = cs.Layout(["z"])
    x0 = np.array([1.0])

    def step(self, x, u, t):
        push = 0.0 if u is None else u
        return (x * (1 + 0.5 * self.dt * self.a) + self.dt * push) / (1 - 0.5 * self.dt * self.a)


@dataclass(frozen=True)
class Refined(Midpoint):
    """With an estimate: half the step leaves a quarter of the error."""

    better_by = "half the step", 4.0 / 3.0

    def better(self):
        return replace(self, dt=0.5 * self.dt)


def exact(t, a=-0.1, u=0.0):
    return np.exp(a * t) * (1 + u / a) - u / a


def test_a_step_system_of_ones_own():
    t = 0.5 * np.arange(0, 41, 4)
    run = cs.simulate(Midpoint(), None, t)
    assert isinstance(run, cs.Trajectory)
    assert run.statistics["steps"] == 40
    # closed form of the rule itself: powers of its factor
    np.testing.assert_allclose(run.x[:, 0], (0.975 / 1.025) ** (t / 0.5), rtol=1e-14)
    assert run.error.absolute is None
    assert "without an estimate" in str(run.error)


def test_inputs_are_held_over_steps():
    t = 0.5 * np.arange(41)
    held = cs.simulate(Midpoint(), None, t, u=[0.3])
    each = cs.simulate(Midpoint(), None, t, u=np.full((40, 1), 0.3))
    np.testing.assert_array_equal(held.x, each.x)
    np.testing.assert_allclose(held.x[:, 0], exact(t, u=0.3), atol=1e-3)
    with pytest.raises(cs.DimensionError, match=r"\(40, n_u\)"):
        cs.simulate(Midpoint(), None, t, u=np.zeros((39, 1)))
    with pytest.raises(cs.DataError, match="NaN"):
        cs.simulate(Midpoint(), None, t, u=[np.nan])


def test_a_better_system_gives_the_estimate():
    t = 0.5 * np.arange(41)
    run = cs.simulate(Refined(), None, t, u=np.random.default_rng(0).standard_normal((40, 1)))
    fine = cs.simulate(Midpoint(dt=0.5 / 64), None, t, u=np.repeat(
        np.random.default_rng(0).standard_normal((40, 1)), 64, axis=0))  # fmt: skip
    error = np.abs(run.x - fine.x).max()
    assert error <= run.error.absolute.max() <= 2 * error
    assert run.error.method == "half the step"


def test_a_run_keeps_reports_and_shows():
    """`begin` gives one run its memory; another run starts afresh."""

    class Counting(StepRun):
        def __init__(self, system):
            super().__init__(system)
            self.seen = []

        @property
        def recorded(self):
            return cs.Layout(["twice"])

        def record(self, x):
            return 2 * x

        def step(self, x, u, t):
            self.seen.append(t)
            return super().step(x, u, t)

        def events(self):
            return [Event(self.seen[-1], "last step", "")]

        def statistics(self):
            return {"seen": len(self.seen)}

        def observed(self, marks, rows):
            return {"p": np.repeat(marks[:, None, None], 3, axis=2).astype(float)}

    class Kept(Midpoint):
        def begin(self):
            return Counting(self)

    for _ in range(2):
        run = cs.simulate(Kept(), None, [2.0, 3.0, 4.0])
        plain = cs.simulate(Midpoint(), None, [2.0, 3.0, 4.0])
        assert list(run.states.names) == ["twice"]
        np.testing.assert_array_equal(run.x, 2 * plain.x)
        assert run.statistics["seen"] == 4
        assert [e.time for e in run.events] == [3.5]
        np.testing.assert_array_equal(run.p[:, 0, 0], [0, 2, 4])


@pytest.mark.parametrize(
    "method", [cs.DOP853(rtol=1e-6, atol=1e-6), cs.Exponential(rtol=1e-6, atol=1e-6)]
)
def test_an_integrator_of_whole_runs_says_when_it_is_done(method):
    told = []
    system = make().system
    cs.simulate(system, method, [0.0, 1.0], auxiliaries=False, progress=told.append)
    assert told == [1.0]


def test_the_run_ends_where_it_is_told():
    told = []
    run = cs.simulate(
        Midpoint(), None, 0.5 * np.arange(100), until=lambda t, x: x[0] < 0.5, progress=told.append
    )
    assert run.x[-1, 0] < 0.5 <= run.x[-2, 0]
    assert len(run.t) == len(run.x) < 20
    assert told[-1] == 1.0


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: cs.simulate(Midpoint(), cs.DOP853(rtol=1e-6, atol=1e-6), [0.0, 1.0]),
         "steps by itself every 0.5 s and takes no integrator"),
        (lambda: cs.simulate(Midpoint(), None, [0.0, 0.7]), r"whole steps of 0.5 s.*t\[1\]"),
        (lambda: cs.simulate(Midpoint(dt=0.0), None, [0.0, 1.0]), "dt must be > 0"),
        (lambda: cs.simulate(object(), None, [0.0, 1.0]), "system"),
        (lambda: cs.simulate(cs.OdeSystem(states=["x"], x0=[1.0]), None, [0.0, 1.0]),
         "integrator"),
        (lambda: cs.simulate(cs.OdeSystem(states=["x"], x0=[1.0]),
                             cs.DOP853(rtol=1e-6, atol=1e-6), [0.0, 1.0], u=[1.0]), "leave u out"),
    ],
)  # fmt: skip
def test_refusals(call, match):
    with pytest.raises(cs.ParameterError, match=match):
        call()


def test_steps_that_fail_are_told_with_their_time():
    class Off(Midpoint):
        def step(self, x, u, t):
            return x * (np.nan if t > 2 else 1)

    with pytest.raises(cs.IntegrationError, match="z is not finite") as told:
        cs.simulate(Off(), None, [0.0, 5.0])
    assert told.value.time == 3.0

    class Wide(Midpoint):
        def step(self, x, u, t):
            return np.zeros(2)

    with pytest.raises(cs.DimensionError, match=r"Wide.step must return \(1,\)"):
        cs.simulate(Wide(), None, [0.0, 1.0])
