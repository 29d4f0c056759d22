"""Derivatives of runs and poles against differences and closed forms."""

import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import DimensionError, ParameterError
from tests.loop.systems import heading, make

TIGHT = cs.CVODES(rtol=1e-10, atol=1e-12)


def decay(rate=0.3, push=2.0):
    return cs.ParametricSystem(
        states=["x"],
        x0=[1.0],
        rate=lambda t, x, p: [-p["rate"] * x[0] + p["push"]],
        parameters={"rate": rate, "push": push},
    )


def test_linear_decay_in_closed_form():
    t = np.linspace(0, 5, 6)
    found = cs.parameter_sensitivities(decay(), TIGHT, t)
    e = np.exp(-0.3 * t)
    np.testing.assert_allclose(found.of("push")[:, 0], (1 - e) / 0.3, atol=1e-8)
    by_rate = -t * e - 2.0 / 0.09 * (1 - e) + 2.0 / 0.3 * t * e
    np.testing.assert_allclose(found.of("rate")[:, 0], by_rate, atol=1e-7)
    gradient, start = cs.end_gradient(decay(), TIGHT, t, [1.0])
    assert gradient["push"] == pytest.approx((1 - e[-1]) / 0.3, rel=1e-5)
    assert gradient["rate"] == pytest.approx(by_rate[-1], rel=1e-5)
    assert start[0] == pytest.approx(e[-1], rel=1e-5)


def test_loop_by_kappa_and_force_against_differences():
    loop = make(2, m=6)
    t = np.linspace(0, 60, 7)
    system = cs.parametric_loop(loop)
    np.testing.assert_allclose(
        cs.simulate(system, TIGHT, t, auxiliaries=False).x, loop.simulate(t, TIGHT).x, atol=1e-8
    )
    found = cs.parameter_sensitivities(system, TIGHT, t)
    gradient, _ = cs.end_gradient(system, TIGHT, t, np.ones(9))
    import dataclasses

    for name, value in system.parameters.items():
        step = 1e-4 * value
        runs = [
            cs.simulate(
                dataclasses.replace(system, parameters={**system.parameters, name: value + d}),
                TIGHT, t, auxiliaries=False,
            ).x
            for d in (step, -step)
        ]  # fmt: skip
        central = (runs[0] - runs[1]) / (2 * step)
        # Differences: step^2 and the runs' 1e-9 over the step.
        scale = np.abs(central).max()
        np.testing.assert_allclose(found.of(name), central, atol=2e-4 * scale)
        assert gradient[name] == pytest.approx(central[-1].sum(), abs=2e-3 * scale)


def test_poles_by_kappa():
    loop = make(1, m=4, normalise=False)
    point = loop.linearize(at=(loop.z0, heading(0.3)))
    dA = np.zeros_like(point.A)
    dA[-1] = point.A[-1] / point.kappa
    poles, slope = cs.pole_sensitivities(point.A, dA)
    step = 1e-6
    moved = np.linalg.eigvals(point.A + step * dA)
    for pole, d in zip(poles, slope, strict=True):
        assert np.abs(moved - (pole + step * d)).min() < 1e-9


def test_refusals():
    with pytest.raises(ParameterError, match="ParametricSystem"):
        cs.parameter_sensitivities(make(2).system, TIGHT, np.array([0.0, 1.0]))
    with pytest.raises(ParameterError, match="no parameter 'mass'"):
        cs.parameter_sensitivities(decay(), TIGHT, np.array([0.0, 1.0]), parameters=["mass"])
    with pytest.raises(DimensionError):
        cs.end_gradient(decay(), TIGHT, np.array([0.0, 1.0]), [1.0, 2.0])
    with pytest.raises(ParameterError, match="defective"):
        cs.pole_sensitivities(np.array([[0.0, 1.0], [0.0, 0.0]]), np.eye(2))
    with pytest.raises(ParameterError, match="finite"):
        decay(rate=np.nan)
