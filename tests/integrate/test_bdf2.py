"""BDF2: second order with any bound of the tangent, kinks and jumps, its log and its estimate."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cellsys.integrate import BDF2, LinearlyImplicit, simulate
from cellsys.integrate.stepping import Stepper
from tests import naive
from tests.integrate.toys import Springs

TIMES = np.arange(0.0, 7.0, 1.0)
STEPS = (0.02, 0.01)


KNOWN = {}


def exact(system, t=TIMES):
    """By an 8th-order method at 1e-10, restarted at every stop point."""
    key = (type(system), system.stops, getattr(system, "jump", 0.0))
    if key not in KNOWN:
        KNOWN[key] = _exact(system, t)
    return KNOWN[key]


def _exact(system, t):
    edges = np.unique([t[0], t[-1], *system.stop_points()])
    x, rows = system.x0, [system.x0[None]]
    for a, b in pairwise(edges):
        inside = np.unique([*t[(t > a) & (t <= b)], b])

        def rhs(s, y, a=a, b=b):  # each side of a jump by its own law
            return system.rhs(min(max(s, np.nextafter(a, b)), np.nextafter(b, a)), y)

        run = solve_ivp(rhs, (a, b), x, method="DOP853", t_eval=inside, rtol=1e-10, atol=1e-11)
        x = run.y[:, -1]
        rows.append(run.y.T[np.isin(inside, t)])
    return np.concatenate(rows)


def errors(system, method=BDF2, steps=STEPS):
    """Largest error of each state group (nodes, internal) at two steps, (2, 2)."""
    reference = exact(system)
    gaps = [np.abs(simulate(system, method(step=h), TIMES).x - reference) for h in steps]
    return np.array([[gap[:, : system.n].max(), gap[:, system.n].max()] for gap in gaps])


@pytest.mark.parametrize("factor", [1.0, 1.3, 3.0])
def test_second_order_with_every_bound_of_the_tangent(factor):
    error = errors(Springs(factor=factor))
    # Two, with the third-order term of these steps: a quarter either way.
    order = np.log2(error[:-1] / error[1:])
    assert np.all(order > 1.75)
    assert np.all(order < 2.35)
    # The first-order method at the same step: ten times as far off, and more the better M is.
    euler = errors(Springs(factor=factor), LinearlyImplicit)
    assert np.all(error[-1] < 0.2 * euler[-1])


def test_naive_internal_states_of_first_order_spoil_it():
    """Only the internal state can tell: the springs do not see it."""

    class FirstOrder(Springs):
        def advance_by_middle(self, t, x, middle, x_new, dt):
            self.advance_internal(t, x, x_new, dt)

    error = errors(FirstOrder())[:, 1]
    assert np.all(np.log2(error[:-1] / error[1:]) < 1.2)


@pytest.mark.parametrize("stops", [(1.003, 4.4, 4.41, 5.5), (3.0, 3.0001)])
def test_steps_of_uneven_length_keep_the_order(stops):
    """Steps cut by stop points, some of them a hundredth of the others."""
    error = errors(Springs(stops=stops))[:, 0]
    assert np.all(np.log2(error[:-1] / error[1:]) > 1.6)
    assert error[-1] < 2.0 * errors(Springs())[-1, 0]


class Pulled(Springs):
    """Pulled by a force with a kink (the slope changes) or a jump at 5.02 s."""

    jump = 0.0

    def u(self, t, x):
        out = np.zeros(self.n + 1)
        out[self.n - 1] = 0.3 * min(t, 5.02) + (self.jump if t >= 5.02 else 0.0)
        return out


@pytest.mark.parametrize("jump", [0.0, 1.0])
def test_kinks_and_jumps_at_a_stop_point_keep_the_order(jump):
    system = Pulled(stops=(5.02,))
    object.__setattr__(system, "jump", jump)
    error = errors(system)[:, 0]
    assert np.all(np.log2(error[:-1] / error[1:]) > 1.6)
    # The velocity goes through a kink; a jump starts anew, with the laws of either side.
    assert _starts(system)[1:] == ([5.02] if jump else [])


def _starts(system):
    """When a run had no step to go on from."""
    found = []
    stepper = BDF2(step=0.1).start(system, 0.0, system.x0, np.random.default_rng(0))
    inner = stepper.weight

    def weight(t, x, dt, happened):
        a = inner(t, x, dt, happened)
        if a == 1.0:
            found.append(t)
        return a

    stepper.weight = weight
    stepper.advance(8.0)
    return found


def test_steps_hold_where_the_explicit_rule_of_the_same_order_blows_up():
    stiff = Springs(stiffness=5e3, pull=1.0)
    run = simulate(stiff, BDF2(step=0.05), TIMES)
    assert np.abs(run.x).max() < 0.01
    assert not np.isfinite(naive.two_step_extrapolation(stiff, 12.0, 0.05)).all()


def test_what_the_log_leaves_over_falls_at_second_order():
    share = [simulate(Springs(), BDF2(step=h), TIMES).residual_share()["x"] for h in STEPS]
    assert np.all(np.log2(np.array(share[:-1]) / share[1:]) > 1.6)


@pytest.mark.parametrize("logged", [True, False])
def test_the_estimate_is_of_the_size_of_the_error(logged):
    """From the log, at once; without one by the run at half the step."""
    run = simulate(Springs(), BDF2(step=0.02), TIMES, auxiliaries=logged)
    true = np.abs(run.x - exact(Springs())).max(axis=0)[:4].max()
    told = run.error.absolute[:4].max()
    assert ("residual" in run.error.method) == logged
    # What is left over is damped by springs much faster than the run is long.
    assert 0.5 * true < told < (100.0 if logged else 3.0) * true


def test_rounding_of_steps_makes_no_factorisation():
    """A third of a second: b - a differs in its last digits, the tangent's key does not."""

    class Kept(Springs):
        def majorant(self, t, x, dt):
            return tuple(block._replace(key="kept") for block in super().majorant(t, x, dt))

    for method in (LinearlyImplicit, BDF2):
        run = simulate(Kept(), method(step=1 / 3), np.arange(0.0, 20.0))
        # One, and with BDF2 those of its start: two lengths, first and second order.
        assert run.statistics["factorisations"] <= 4


def test_both_implicit_steppers_are_steppers():
    for method in (LinearlyImplicit, BDF2):
        started = method(step=0.1).start(Springs(), 0.0, np.zeros(5), np.random.default_rng(0))
        assert isinstance(started, Stepper)


@pytest.mark.parametrize("factor", [0.84, 1.0, 10.0, 300.0])
def test_one_correction_is_stable_with_every_over_estimate(factor):
    """At a thousand times the explicit limit, from a start that is far from rest."""
    assert _grows(factor, 0.5) < 1.0


def test_naive_start_on_the_whole_parabola_is_not():
    """Three points extrapolated for all they are worth: what M leaves over comes back larger."""
    assert _grows(10.0, 1.0) > 10.0


def _grows(factor, bend):
    """Size of a linear chain's motion after 60 s over that after 6 s."""

    class Bent(type(_stepper(1.0))):
        def predicted(self, t, x, dt):
            self.bend *= 2.0 * bend
            return super().predicted(t, x, dt)

    stepper = _stepper(factor)
    stepper.__class__ = Bent
    stepper.advance(6.0)
    early = np.abs(stepper.velocity).max()
    stepper.advance(60.0)
    return np.abs(stepper.velocity).max() / early


def _stepper(factor):
    system = Springs(stiffness=2e3, pull=0.0, factor=factor)
    start = 1e-6 * np.array([1.0, -2.0, 3.0, -1.0, 0.0])
    method = BDF2(step=1.0, corrections=1, largest_move=1e9)
    return method.start(system, 0.0, start, np.random.default_rng(0))
