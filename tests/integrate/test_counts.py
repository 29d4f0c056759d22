"""What integrators tell of their work, and where they give up."""

import numpy as np
import pytest

from cellsys.errors import IntegrationError, ParameterError
from cellsys.integrate import (
    BDF2,
    CVODES,
    DOP853,
    IDAS,
    LSODA,
    RKC,
    Collocation,
    ExplicitEuler,
    Exponential,
    LinearlyImplicit,
    Radau,
    RungeKutta4,
    simulate,
)
from tests.integrate.toys import Springs, scalar


def test_rkc_gives_up_where_the_right_hand_side_jumps():
    """x' = -sign(x) slides along 0: steps fall with the tolerance, and a bound says so."""
    system = scalar(lambda t, x: [-np.sign(x[0])], x0=[0.5])
    loose = simulate(system, RKC(rtol=1e-3, atol=1e-3, max_steps=10_000), np.array([0.0, 1.0]))
    assert abs(loose.x[-1, 0]) < 0.01
    with pytest.raises(IntegrationError, match="200 steps") as caught:
        simulate(system, RKC(rtol=1e-7, atol=1e-7, max_steps=200), np.array([0.0, 1.0]))
    assert 0.4 < caught.value.time < 0.6
    with pytest.raises(ParameterError, match="max_steps"):
        RKC(rtol=1e-3, atol=1e-3, max_steps=0)


@pytest.mark.parametrize("method", [
    CVODES(rtol=1e-6, atol=1e-6), IDAS(rtol=1e-6, atol=1e-6), Collocation(step=0.5),
    RungeKutta4(step=0.5), Exponential(step=0.5), DOP853(rtol=1e-6, atol=1e-6),
    Radau(rtol=1e-6, atol=1e-6), LSODA(rtol=1e-6, atol=1e-6), RKC(rtol=1e-4, atol=1e-4),
    LinearlyImplicit(step=0.05), BDF2(step=0.05), ExplicitEuler(step=0.01),
], ids=lambda m: type(m).__name__)  # fmt: skip
def test_every_integrator_counts_alike(method):
    system = Springs() if hasattr(method, "start") else scalar(lambda t, x: [-x[0]])
    found = simulate(system, method, np.linspace(0.0, 2.0, 5)).statistics
    assert {"rhs", "jacobians", "factorisations", "steps", "rejected", "wall_time"} <= set(found)
    assert found["steps"] > 0
    assert found["rhs"] is None or found["rhs"] > 0


def test_rejected_steps_of_an_explicit_method_are_counted():
    system = scalar(lambda t, x: [-x[0] + 1000.0 * (t > 1.0)], x0=[1.0])
    found = simulate(system, DOP853(rtol=1e-8, atol=1e-8), np.array([0.0, 2.0])).statistics
    assert found["rejected"] > 0
    smooth = scalar(lambda t, x: [-x[0]], x0=[1.0])
    # The first step is guessed; the error estimate of a smooth problem takes the others.
    calm = simulate(smooth, DOP853(rtol=1e-8, atol=1e-8), np.array([0.0, 2.0])).statistics
    assert calm["rejected"] <= 1
