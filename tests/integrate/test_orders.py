"""Order of convergence, stop points and averages of RKC, Collocation, IDAS and RungeKutta4."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cellsys.errors import IntegrationError, ParameterError
from cellsys.integrate import (
    CVODES,
    IDAS,
    RKC,
    Collocation,
    Exponential,
    RungeKutta4,
    simulate,
    stability_limit,
)
from cellsys.integrate.rkc import coefficients
from tests.integrate.toys import Springs, scalar


def curved():
    return scalar(lambda t, x: [-(x[0] ** 3) + t])


def exact(t):
    run = solve_ivp(
        lambda s, x: -(x**3) + s, (t[0], t[-1]), [1.0], "DOP853", t_eval=t, rtol=1e-13, atol=1e-14
    )
    return run.y.T


@pytest.mark.parametrize(
    ("method", "order"),
    [
        (lambda h: RungeKutta4(step=h), 4),
        (lambda h: Collocation(step=h, stages=1), 1),
        (lambda h: Collocation(step=h, stages=2), 3),
        (lambda h: Collocation(step=h, stages=3), 5),
    ],
    ids=["RK4", "Radau 1", "Radau 2", "Radau 3"],
)
def test_order_of_fixed_steps(method, order):
    t = np.linspace(0, 4, 5)
    error = [np.abs(simulate(curved(), method(h), t).x - exact(t)).max() for h in (0.25, 0.125)]
    # The next term of the expansion at these steps.
    assert np.log2(error[0] / error[1]) == pytest.approx(order, abs=0.7)


def test_rkc_is_of_second_order():
    """Error per factor 1000 in the tolerance: 1000^(2/3) = 100 for local error h^3, within 3."""
    t = np.linspace(0, 12, 4)
    system = Springs()
    fine = solve_ivp(system.rhs, (0, 12), system.x0, "DOP853", t_eval=t, rtol=1e-12, atol=1e-13)
    steps, error = [], []
    for rtol in (1e-4, 1e-7):
        run = simulate(Springs(), RKC(rtol=rtol, atol=rtol), t)
        steps.append(run.statistics["steps"])
        error.append(np.abs(run.x - fine.y.T).max())
    assert np.log(error[0] / error[1]) / np.log(steps[1] / steps[0]) == pytest.approx(2.0, abs=0.4)


def test_rkc_stages_satisfy_the_order_conditions():
    """On x' = x + t the step's expansion agrees to second order, for any number of stages."""
    for s in (2, 5, 20, 100):
        rows, c = coefficients(s)
        assert c[s] == pytest.approx(1.0, abs=1e-12)

        # Stability polynomial P(z) = 1 + z + z^2/2 + .. by its values near zero.
        def P(z, rows=rows, s=s):
            before, now = 1.0, 1.0 + rows[0, 2] * z
            for mu, nu, mu_t, gamma in rows[1:]:
                before, now = (
                    now,
                    (1 - mu - nu) + mu * now + nu * before + mu_t * z * now + gamma * z,
                )
            return now  # fmt: skip

        h = 1e-3
        assert (P(h) - P(-h)) / (2 * h) == pytest.approx(1.0, abs=1e-5)
        assert (P(h) - 2 * P(0) + P(-h)) / h**2 == pytest.approx(1.0, abs=1e-4)
        edge = 0.65 * (s**2 - 1)
        assert max(abs(P(z)) for z in np.linspace(-edge, -1e-3, 400)) <= 1.0


@pytest.mark.slow
def test_rkc_goes_far_beyond_the_explicit_limit():
    system = Springs(stiffness=5e4)
    t = np.linspace(0, 12, 4)
    run = simulate(system, RKC(rtol=1e-3, atol=1e-4), t)
    limit = stability_limit(system)
    # Mean step in units of the explicit limit, and evaluations against Euler's at its limit.
    assert 12 / run.statistics["steps"] > 20 * limit
    assert run.statistics["rhs"] < 0.5 * 12 / limit
    fine = simulate(system, RKC(rtol=1e-7, atol=1e-8), t)
    assert np.abs(run.x - fine.x).max() < 50 * 1e-3 * np.abs(fine.x).max()
    assert np.abs(run.x - fine.x).max() < 20 * run.error.absolute.max()


def test_rkc_needs_a_largest_step_where_a_system_changes_between_steps():
    class Remeshed(Springs):
        discrete = True

    system = Remeshed()
    with pytest.raises(ParameterError, match="largest_step"):
        simulate(system, RKC(rtol=1e-3, atol=1e-3), np.array([0.0, 1.0]))


PULSE = (1.0, 1.02)  # a pulse of 100 over a fiftieth of a second


def pulsed():
    import casadi as ca

    class Pulsed(type(curved())):
        def stop_points(self):
            return PULSE

    def push(t):
        if isinstance(t, float):
            return 100.0 if PULSE[0] <= t < PULSE[1] else 0.0
        return ca.if_else(ca.logic_and(t >= PULSE[0], t < PULSE[1]), 100.0, 0.0)

    return Pulsed(
        states=["x"], auxiliaries=["rate"], x0=[0.0], W_eta=[[1.0]],
        law=lambda t, x: [push(t) - 0.01 * x[0]],
    )  # fmt: skip


@pytest.mark.parametrize(
    "method",
    [
        CVODES(rtol=1e-8, atol=1e-9),
        IDAS(rtol=1e-8, atol=1e-9),
        RungeKutta4(step=1.0),
        Collocation(step=1.0),
        RKC(rtol=1e-8, atol=1e-9),
        Exponential(step=1.0, order=4),
    ],
    ids=lambda m: type(m).__name__,
)
def test_no_step_jumps_over_a_pulse(method):
    """What the pulse leaves, 100 (1 - e^-0.0002)/0.01, decays with 0.01 1/s."""
    t = np.array([0.0, 10.0, 20.0])
    run = simulate(pulsed(), method, t)
    left = 1e4 * (1 - np.exp(-0.01 * 0.02))
    np.testing.assert_allclose(run.x[1:, 0], left * np.exp(-0.01 * (t[1:] - 1.02)), rtol=1e-6)
    # The average rate over the first interval is what the state gained there.
    if not isinstance(method, (Exponential, RKC)):
        assert run.eta[0, 0] * 10 == pytest.approx(run.x[1, 0], rel=1e-6)
    naive = simulate(pulsed(), RungeKutta4(step=5.0), np.array([0.0, 0.5]))
    assert naive.x[-1, 0] == 0.0


def test_averages_add_up_over_samples_and_stop_points():
    t = np.linspace(0, 3, 14)
    run = simulate(pulsed(), CVODES(rtol=1e-9, atol=1e-10), t)
    np.testing.assert_allclose(run.eta[:, 0] * np.diff(t), np.diff(run.x[:, 0]), atol=1e-6)
    assert run.residual_share() == {"x": pytest.approx(0.0, abs=1e-6)}


def test_rkc_resumes_bit_for_bit():
    class Store:
        def __init__(self, arrays, kept=None):
            self.arrays, self.kept, self.saved = arrays, kept, []

        def checkpoint(self, arrays, metadata):
            copied = {k: np.array(v) for k, v in arrays.items()}
            self.saved.append((copied, {**metadata, "statistics": dict(metadata["statistics"])}))

        def last_checkpoint(self):
            return self.kept

    t = np.linspace(0, 50, 51)
    method = RKC(rtol=1e-4, atol=1e-5)
    first = Store({"x": np.zeros((51, 5))})
    whole = simulate(Springs(), method, t, sink=first, auxiliaries=False)
    second = Store({"x": np.array(whole.x)}, first.saved[0])
    second.arrays["x"][30:] = 0.0
    again = simulate(Springs(), method, t, sink=second, auxiliaries=False)
    np.testing.assert_array_equal(again.x, whole.x)


def test_failures_carry_time_norm_and_step():
    bad = scalar(lambda t, x: [x[0] ** 2])
    for method in (CVODES(rtol=1e-6, atol=1e-8), RKC(rtol=1e-4, atol=1e-6), RungeKutta4(step=0.1)):
        with pytest.raises(IntegrationError) as caught:
            simulate(bad, method, np.array([0.0, 0.5, 3.0]))
        assert np.isfinite(caught.value.state_norm)
        assert caught.value.step > 0
