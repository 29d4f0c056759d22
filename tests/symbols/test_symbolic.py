"""Symbolic loops against the systems they are of, complex steps and differences."""

import dataclasses

import casadi as ca
import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import ParameterError
from tests.loop.systems import NAMES, make
from tests.population.systems import model


def coupled(form=None, kappa=1 / 60):
    law = cs.PolarityLaw(kappa)
    return cs.couple(
        model(m=3, steered=True, centred=True), 3, form, headings=[0.0, 1.0, 2.0], controller=law
    )


LOOPS = [
    make,
    lambda: make(normalise=False),
    lambda: make(noise=0.5),
    coupled,
    lambda: coupled(cs.Feedback()),
]


@pytest.mark.parametrize(
    "made", LOOPS, ids=["single", "raw", "graded", "superposition", "feedback"]
)
def test_rate_is_that_of_the_system(made):
    loop = made()
    form = cs.symbolic(loop, parameters=("kappa", "K_d"))
    f = form.function()
    rng = np.random.default_rng(0)
    for _ in range(3):
        x = form.x0 + 0.3 * rng.standard_normal(len(form.x0))
        found = np.asarray(f(x, form.u0, form.p0)[0]).ravel()
        known = loop.system.rhs(0.0, x)
        assert np.abs(found - known).max() < 1e-12 * max(1.0, np.abs(known).max())
    assert len(form.states) == len(form.x0) == f.size1_in("x")
    assert len(form.parameters) == len(form.p0)
    assert len(form.outputs) == f.size1_out("y")
    assert form.parameters[:2] == ("kappa", "K_d[0,0]")


def test_jacobian_is_a_complex_step():
    loop = make(normalise=True)
    form = cs.symbolic(loop)
    J = ca.Function("J", [form.x, form.u, form.p], [ca.jacobian(form.rhs, form.x)])
    x = form.x0
    found = np.asarray(J(x, form.u0, form.p0))
    A, B, b = loop.model.continuous_matrices()
    m, K_d = loop.order, loop.sensor.K_d

    def rate(v):  # written out again, in complex numbers
        z, p = v[:m], v[m:]
        size = np.sqrt(p[0] ** 2 + p[1] ** 2)
        c, s = p[0] / size, p[1] / size
        features = np.array([c, s, c * c - s * s, 2 * s * c])
        d = K_d[:, 0] + K_d[:, 1:] @ z
        d = d / np.sqrt(np.sum(d * d))
        turn = (d * np.sum(p * p) - p * np.sum(p * d)) / 60
        return np.concatenate([A @ z + B @ features + b, turn])

    h = 1e-30
    known = np.column_stack([rate(x + 1j * h * e).imag / h for e in np.eye(len(x))])
    assert np.abs(found - known).max() < 1e-12 * np.abs(known).max()


@pytest.mark.parametrize("made", [make, coupled], ids=["single", "coupled"])
def test_steps_and_integrators_are_runs(made):
    loop = made()
    form, t = cs.symbolic(loop), np.array([0.0, 5.0, 10.0])
    known = cs.simulate(loop.system, cs.RungeKutta4(step=5.0), t).x
    rk4 = form.rk4(5.0)
    x = form.x0
    for row in known[1:]:
        x = np.asarray(rk4(x, form.u0, form.p0)).ravel()
        assert np.abs(x - row).max() < 1e-12 * np.abs(row).max()
    F = form.integrator(cs.CVODES(rtol=1e-9, atol=1e-9), 10.0)
    end = np.asarray(F(x0=form.x0, p=form.p0)["xf"]).ravel()
    fine = cs.simulate(loop.system, cs.DOP853(rtol=1e-11, atol=1e-12), t).x[-1]
    assert np.abs(end - fine).max() < 1e-7 * np.abs(fine).max()  # CVODES at 1e-9
    with pytest.raises(ParameterError, match="DOP853 has no derivatives"):
        form.integrator(cs.DOP853(rtol=1e-6, atol=1e-6), 1.0)
    with pytest.raises(ParameterError, match="step"):
        form.rk4(0.0)


def test_sensitivity_of_a_heading_to_kappa():
    form = cs.symbolic(make())
    F = form.integrator(cs.CVODES(rtol=1e-10, atol=1e-10), 20.0)
    xf = F(x0=form.x0, p=form.p)["xf"]
    slope = ca.Function("s", [form.p], [ca.jacobian(xf, form.p)])
    found = np.asarray(slope(form.p0)).ravel()
    h = 1e-5
    ends = [
        make(kappa=1 / 60 + s * h).simulate([0.0, 20.0], cs.DOP853(rtol=1e-12, atol=1e-12)).x[-1]
        for s in (1, -1)
    ]
    known = (ends[0] - ends[1]) / (2 * h)
    assert np.abs(found - known).max() < 1e-6 * np.abs(known).max()


def test_commands_as_inputs():
    loop = make(names=("cell1.amplitude", *NAMES))
    form = cs.symbolic(loop, inputs=("amplitude", "heading"))
    assert form.inputs == ("amplitude", "heading")
    f, (A, B, b) = form.function(), loop.model.continuous_matrices()
    x, q = form.x0, 0.7
    c = 1.5 * np.array([1.0, np.cos(q), np.sin(q), np.cos(2 * q), np.sin(2 * q)])
    found = np.asarray(f(x, [1.5, q], form.p0)[0]).ravel()[: loop.order]
    known = A @ x[: loop.order] + B @ c + b
    assert np.abs(found - known).max() < 1e-13 * np.abs(known).max()
    both = cs.symbolic(coupled(), inputs=("amplitude",))
    assert both.inputs == ("cell1_amplitude", "cell2_amplitude", "cell3_amplitude")


def test_plants_as_parameters_and_refusals():
    loop = make()
    form = cs.symbolic(loop, parameters=("A", "B", "offset"))
    other = dataclasses.replace(loop.model, A=1.1 * loop.model.A)
    p = np.concatenate([other.A.ravel(), form.p0[25:]])
    found = np.asarray(form.function()(form.x0, form.u0, p)[0]).ravel()
    known = dataclasses.replace(loop, model=other).system.rhs(0.0, form.x0)
    assert np.abs(found - known).max() < 1e-13
    assert form.parameters[0] == "A[0,0]"
    assert form.parameters[-1] == "offset[4]"
    with pytest.raises(ParameterError, match="parameters must be"):
        cs.symbolic(coupled(), parameters=("A",))
    with pytest.raises(ParameterError, match="inputs must be"):
        cs.symbolic(loop, inputs=("force",))
