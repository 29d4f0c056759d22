"""Steppers on small systems: order, stop points, averages, failures, resuming."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from cellsys.errors import (
    DataError,
    DimensionError,
    IntegrationError,
    MemoryBudgetError,
    NotSymbolicError,
    ParameterError,
)
from cellsys.integrate import (
    BDF2,
    CVODES,
    RKC,
    ExplicitEuler,
    LinearlyImplicit,
    RungeKutta4,
    simulate,
    stability_limit,
)
from cellsys.integrate.stepping import cuts
from cellsys.store import RunWriter
from tests.integrate.toys import Springs, scalar
from tests.naive import lagged_tangent_velocities

TIMES = np.arange(0.0, 13.0, 1.0)
FIXED = [ExplicitEuler, LinearlyImplicit]
IMPLICIT = [LinearlyImplicit, BDF2]


@pytest.fixture(scope="module")
def exact():
    """The chain by an 8th-order method at 1e-12: exact for what is measured here."""
    system = Springs()
    run = solve_ivp(
        system.rhs, (0, 12), system.x0, method="DOP853", t_eval=TIMES, rtol=1e-12, atol=1e-13
    )
    return run.y.T


@pytest.mark.parametrize("method", FIXED)
def test_first_order(method, exact):
    steps = [0.02, 0.01, 0.005] if method is LinearlyImplicit else [0.01, 0.005, 0.0025]
    error = [np.abs(simulate(Springs(), method(step=h), TIMES).x - exact).max() for h in steps]
    order = np.log2(np.array(error[:-1]) / error[1:])
    # First order, with the second-order term of these steps: a tenth either way.
    assert np.all(order > 0.9)
    assert np.all(order < 1.15)
    assert error[-1] < 0.01


@pytest.mark.parametrize(("method", "order"), [(RungeKutta4, 4.0)])
def test_order_of_symbolic_steppers(method, order):
    system = scalar(lambda t, x: [-(x[0] ** 3) + t])
    t = np.linspace(0, 4, 9)
    reference = simulate(system, CVODES(rtol=1e-12, atol=1e-13), t).x
    error = [np.abs(simulate(system, method(step=h), t).x - reference).max() for h in (0.25, 0.125)]
    assert np.log2(error[0] / error[1]) == pytest.approx(order, abs=0.7)


def test_cvodes_follows_its_tolerance():
    system = scalar(lambda t, x: [-(x[0] ** 3)])
    t = np.linspace(0, 10, 11)
    exact_values = 1.0 / np.sqrt(1.0 + 2.0 * t)
    loose, tight = (
        np.abs(simulate(system, CVODES(rtol=r, atol=r), t).x[:, 0] - exact_values).max()
        for r in (1e-4, 1e-9)
    )
    # Local tolerance times the number of steps: a hundredfold slack.
    assert loose < 1e-2
    assert tight < 1e-7
    assert tight < loose


@pytest.mark.parametrize("method", [*FIXED, BDF2])
def test_every_logged_sample_obeys_the_equation(method):
    """(x_k+1 - x_k)/dt = W_x x + W_eta eta + u + step_residual to rounding, and it shrinks."""
    share = []
    for h in (0.01, 0.005):
        run = simulate(Springs(), method(step=h), TIMES)
        rate = np.diff(run.x, axis=0) / np.diff(run.t)[:, None]
        right = run.x[:-1] @ run.W_x.T.toarray() + run.eta @ run.W_eta.T.toarray() + run.u
        assert np.abs(rate - right).max() < 1e-12 * (1 + np.abs(run.eta).max())
        share.append(run.residual_share()["x"])
        last = run.auxiliary("step_residual")
        assert last.shape == (12, 5)
    # Euler's average of the laws is exact by construction; the implicit one leaves O(step).
    assert share[1] <= 0.6 * share[0] + 1e-13
    assert share[0] < 0.05


def test_explicit_euler_leaves_nothing_over():
    run = simulate(Springs(), ExplicitEuler(step=0.01), TIMES)
    assert np.abs(run.auxiliary("step_residual")).max() < 1e-12


@pytest.mark.parametrize("method", IMPLICIT)
def test_a_large_majorant_is_stable_and_a_small_one_oscillates(method):
    """M = 1.3 K and 3 K are stable at 100 times the explicit limit; M = 0.4 K is a two-cycle."""
    stiff = {"stiffness": 5e3, "pull": 1.0}
    for factor in (0.76, 1.3, 3.0):
        run = simulate(Springs(factor=factor, **stiff), method(step=0.05), TIMES)
        assert np.abs(run.x).max() < 0.01
    sign = lagged_tangent_velocities(Springs(**stiff), factor=0.4, step=0.05)
    assert np.sum(sign[1:] * sign[:-1] < 0) > 0.9 * (len(sign) - 1)


def test_stability_limit_is_where_explicit_euler_ends():
    system = Springs(factor=1.0, pull=0.01)
    limit = stability_limit(system)
    D = np.eye(4) - np.eye(4, k=-1)
    exact_limit = 2.0 * 2.0 / np.linalg.eigvalsh(50.0 * D.T @ D)[-1]
    # The Rayleigh quotient is a few percent low, hence the built-in factor 1.05.
    assert 0.9 * exact_limit < limit <= exact_limit
    x0 = np.array([1e-6, -1e-6, 1e-6, -1e-6, 0.0])
    for factor, grows in ((0.99, False), (1.2, True)):
        step = factor * exact_limit
        still = Springs(pull=0.0)
        run = simulate(still, ExplicitEuler(step=step * 1.0001), np.array([0.0, 40 * step]), x0=x0)
        assert (np.abs(run.x[1]).max() > 1e-6) == grows
    with pytest.raises(ParameterError, match="majorant"):
        stability_limit(scalar(lambda t, x: [-x[0]]))


# Stop points


@given(
    st.floats(-100, 100),
    st.floats(1e-3, 50),
    st.floats(1e-2, 10),
    st.lists(st.floats(-100, 150), max_size=5),
)
def test_cuts_hit_the_ends_and_every_stop(t0, length, step, stops):
    t1 = t0 + length
    times = cuts(t0, t1, step, np.unique(stops))
    assert times[0] == t0
    assert times[-1] == t1
    assert np.all(np.diff(times) > 0) or np.any(np.diff(np.unique([t0, t1, *stops])) < 1e-9)
    assert np.diff(times).max() <= step * (1 + 1e-9)
    for stop in stops:
        if t0 < stop < t1:
            assert stop in times


def pulse(t):
    """A triangle of height 1 from 2.2 s to 2.3 s."""
    return float(np.interp(t, [2.2, 2.25, 2.3], [0.0, 1.0, 0.0]))


class Pulsed(Springs):
    def u(self, t, x):
        out = np.zeros(self.n + 1)
        out[self.n - 1] = 5.0 * pulse(t)
        return out


@pytest.mark.parametrize("method", [*FIXED, BDF2])
def test_a_short_pulse_between_samples_is_felt(method):
    """Impulse 5 x 0.05 s; a piecewise linear history with stops at its knots is summed exactly."""
    t = np.array([0.0, 2.0, 4.0])
    step = 0.5 if method in IMPLICIT else 0.02
    run = simulate(Pulsed(stops=(2.2, 2.25, 2.3)), method(step=step), t)
    assert 2.0 * run.u[1, 3] == pytest.approx(5.0 * 0.05, rel=1e-12)
    assert np.abs(run.x[2]).max() > 1e-6
    assert not run.u[0].any()
    assert run.statistics["steps"] >= 4 + 6 if method in IMPLICIT else True


def test_without_stop_points_the_pulse_is_stepped_over():
    run = simulate(Pulsed(), LinearlyImplicit(step=0.5), np.array([0.0, 2.0, 4.0]))
    assert not run.u.any()
    assert not run.x.any()


@pytest.mark.parametrize("integrator", [RungeKutta4(step=0.5), CVODES(rtol=1e-8, atol=1e-10)])
def test_symbolic_integrators_stop_too(integrator):
    import casadi as ca

    class Stopped(type(scalar(lambda t, x: [-x[0]]))):
        def stop_points(self):
            return (2.2, 2.3)

    def law(t, x):
        inside = ca.logic_and(t >= 2.2, t < 2.3)
        return [ca.if_else(inside, 7.0, 0.0)]

    given_ = {"states": ["x"], "auxiliaries": ["r"], "x0": [0.0], "W_eta": [[1.0]], "law": law}
    run = simulate(Stopped(**given_), integrator, np.array([0.0, 2.0, 4.0]))
    # The right-hand side is constant on each side of a stop; RK4 samples the very end of an
    # interval, which belongs to the next one: a sixth of the weight.
    assert run.x[-1, 0] == pytest.approx(
        0.7, rel=0.17 if isinstance(integrator, RungeKutta4) else 1e-5
    )


# Failures


def late_nan(limit):
    return lambda t, x: [np.nan if t > limit else -0.1 * x[0]]


def test_nan_late_in_a_run_names_time_state_and_step():
    with pytest.raises(IntegrationError, match="x is not finite") as caught:
        simulate(scalar(late_nan(7.0)), ExplicitEuler(step=0.25), TIMES)
    error = caught.value
    assert 7.0 < error.time <= 7.5
    assert error.step == 0.25
    assert np.isfinite(error.state_norm)


class LateNaN(Springs):
    def u(self, t, x):
        return super().u(t, x) * (np.nan if t > 7.0 else 1.0)


def test_nan_in_an_implicit_run_is_an_integration_error():
    with pytest.raises(IntegrationError) as caught:
        simulate(LateNaN(), LinearlyImplicit(step=0.25), TIMES)
    assert 6.9 < caught.value.time <= 7.5


@pytest.mark.parametrize("integrator", [CVODES(rtol=1e-3, atol=1e-5), RungeKutta4(step=0.1)])
def test_blow_up_in_finite_time_is_an_integration_error(integrator):
    """x' = x^3 from 1 ends at t = 1/2."""
    with pytest.raises(IntegrationError) as caught:
        simulate(scalar(lambda t, x: [x[0] ** 3]), integrator, np.linspace(0, 20, 5))
    assert caught.value.time >= 0.0


def test_divergence_of_explicit_euler_is_an_integration_error():
    with pytest.raises(IntegrationError, match="smaller step"):
        simulate(scalar(lambda t, x: [-(x[0] ** 3)], x0=[10.0]), ExplicitEuler(step=0.5), TIMES)


@pytest.mark.parametrize("method", IMPLICIT)
def test_a_step_that_moves_too_far_is_halved_then_refused(method):
    with pytest.raises(IntegrationError, match=f"{method.__name__}: a node .* largest_move = "):
        simulate(Springs(pull=1e7), method(step=0.5), TIMES)
    run = simulate(Springs(stiffness=5.0, pull=20.0, drag=0.5), method(step=0.5), TIMES)
    assert run.statistics["rejected"] > 0
    right = run.eta @ run.W_eta.T.toarray() + run.u
    rate = np.diff(run.x, axis=0) / np.diff(run.t)[:, None]
    assert np.abs(rate - right).max() < 1e-12 * (1 + np.abs(run.eta).max())


@pytest.mark.parametrize("step", [0.0, -1.0, np.nan, np.inf])
def test_steps_must_be_positive_times(step):
    for method in (*FIXED, BDF2, RungeKutta4):
        with pytest.raises(ParameterError, match="step"):
            method(step=step)


def test_integrators_have_no_defaults_for_their_tolerances():
    for make in (LinearlyImplicit, BDF2, ExplicitEuler, RungeKutta4, CVODES):
        with pytest.raises(TypeError, match="missing"):
            make()
    for bad in ({"rtol": 0.0, "atol": 1e-6}, {"rtol": 1e-6, "atol": np.nan}):
        with pytest.raises(ParameterError):
            CVODES(**bad)
    for name in ("refresh", "corrections", "tolerance", "largest_move"):
        with pytest.raises(ParameterError, match=name):
            LinearlyImplicit(step=0.5, **{name: 0})
        with pytest.raises(ParameterError, match=rf"BDF2.{name} must be .*, got 0"):
            BDF2(step=0.5, **{name: 0})


def test_times_and_states_are_checked():
    system, method = scalar(lambda t, x: [-x[0]]), ExplicitEuler(step=0.1)
    for bad, kind in (
        ([0.0, 1.0, 1.0], DataError),
        ([1.0, 0.0], DataError),
        ([0.0, np.nan], DataError),
        ([], DimensionError),
        ([[0.0, 1.0]], DimensionError),
    ):
        with pytest.raises(kind):
            simulate(system, method, np.array(bad))
    with pytest.raises(DimensionError, match="x0"):
        simulate(system, method, TIMES, x0=np.zeros(2))
    with pytest.raises(DataError, match="x0"):
        simulate(system, method, TIMES, x0=np.array([np.nan]))
    for implicit in IMPLICIT:
        with pytest.raises(ParameterError, match=f"{implicit.__name__} needs .* majorant"):
            simulate(system, implicit(step=0.5), TIMES)
    with pytest.raises(NotSymbolicError):
        simulate(scalar(lambda t, x: [float(x[0])]), RungeKutta4(step=0.5), TIMES)


def test_one_sample_is_a_run_of_no_steps():
    run = simulate(Springs(), LinearlyImplicit(step=0.5), np.array([3.0]))
    assert run.x.shape == (1, 5)
    assert run.eta.shape == (0, 10)


def test_a_record_larger_than_memory_is_refused_with_the_estimate():
    big = np.arange(10**6 + 1.0)
    system = scalar(lambda t, x: [-x[0]])

    class Wide(type(system)):
        def observe(self, t, x):
            return {"d": np.broadcast_to(0.0, (10**7, 3))}

    wide = Wide(states=["x"], x0=[1.0])
    with pytest.raises(MemoryBudgetError, match=r"needs \d+\.\d GB .* sample less often"):
        simulate(wide, ExplicitEuler(step=1.0), big)


# Resuming


class Interrupted(RuntimeError):
    pass


class Stopping(RunWriter):
    """A run folder whose process dies at one checkpoint (before or after writing it)."""

    die_at, before = None, False

    def checkpoint(self, arrays, metadata):
        if metadata["sample"] == self.die_at and self.before:
            raise Interrupted
        super().checkpoint(arrays, metadata)
        if metadata["sample"] == self.die_at:
            raise Interrupted


@pytest.mark.parametrize("method", [*FIXED, BDF2])
@pytest.mark.parametrize("before", [False, True])
def test_an_interrupted_run_continues_bit_for_bit(tmp_path, method, before):
    from cellsys.integrate.record import record_shapes

    t, step = np.arange(0.0, 71.0), 0.015 if method is ExplicitEuler else 0.1
    shapes = record_shapes(Springs(), t, True)
    whole = simulate(Springs(), method(step=step), t, sink=RunWriter(tmp_path / "a", shapes, {}))
    broken = Stopping(tmp_path / "b", shapes, {})
    broken.die_at, broken.before = 40, before
    with pytest.raises(Interrupted):
        simulate(Springs(), method(step=step), t, sink=broken)
    # What was written after the last checkpoint does not count: spoil it.
    again = RunWriter(tmp_path / "b", shapes, {})
    done = again.last_checkpoint()[1]["sample"]
    assert done == (20 if before else 40)
    again.arrays["x"][done + 1 :] = np.nan
    again.arrays["eta"][done:] = np.nan
    resumed = simulate(Springs(), method(step=step), t, sink=again)
    for name in ("x", "eta", "u"):
        assert np.array_equal(getattr(resumed, name), getattr(whole, name)), name
    for count in ("steps", "rhs", "factorisations"):
        assert resumed.statistics[count] == whole.statistics[count]


def test_a_run_with_a_sink_is_the_run_without(tmp_path):
    from cellsys.integrate.record import record_shapes

    t = np.arange(0.0, 45.0)
    sink = RunWriter(tmp_path / "a", record_shapes(Springs(), t, True), {})
    one = simulate(Springs(), LinearlyImplicit(step=0.1), t, sink=sink)
    two = simulate(Springs(), LinearlyImplicit(step=0.1), t)
    assert np.array_equal(one.x, two.x)
    assert np.array_equal(one.eta, two.eta)


# Discrete changes


class Drawing(Springs):
    """Remembers over which intervals its discrete changes were drawn; a hard start is shortened."""

    discrete = True

    def between_steps(self, t, x, dt, rng):
        self.drawn.append((t, t + dt))
        return x, ()


@pytest.mark.parametrize("method", [*IMPLICIT, RKC])
def test_every_interval_is_drawn_once_however_short_the_steps(method):
    """A probability of an interval that is cut by the error control was used again and again."""
    system = Drawing(stiffness=500.0)
    object.__setattr__(system, "drawn", [])
    told = {"rtol": 1e-5, "atol": 1e-7, "largest_step": 0.5} if method is RKC else {"step": 0.5}
    run = simulate(system, method(**told), np.array([0.0, 1.3, 3.0]))
    ends = [b for _, b in system.drawn]
    assert [a for a, _ in system.drawn] == pytest.approx([0.0, *ends[:-1]], abs=1e-12)
    assert ends[-1] == pytest.approx(3.0, abs=1e-12)
    if method is RKC:
        assert run.statistics["steps"] > 2 * len(ends)
