"""Nonlinear laws, modulated and matrix two-ports, fields, vector bonds, CasADi, linearisation."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.integrate import solve_ivp

from cellsys.bondgraph import (
    TF,
    BondGraph,
    C,
    CField,
    I,
    Internal,
    NodalEffort,
    One,
    R,
    Se,
    Zero,
)
from cellsys.errors import CausalityError
from cellsys.system import Block


def oscillator():
    """Mass 1, cubic spring, quadratic damper [notes: measurements, smooth case]."""
    return BondGraph(
        [One("v"), I("m", 1.0, p0=0.3), C("k", law=lambda q: q + 0.5 * q**3, q0=1.0),
         R("b", law=lambda v: 0.1 * v + 0.2 * v * (v * v) ** 0.5)],
        ["v -> m", "v -> k", "v -> b"],
        name="oscillator",
    )  # fmt: skip


def test_only_nonlinear_laws_are_auxiliaries():
    equations = oscillator().equations()
    assert [b.name for b in equations.auxiliaries] == ["k.e", "b.e"]
    np.testing.assert_array_equal(equations.W_eta.toarray(), [[-1, -1], [0, 0]])
    np.testing.assert_array_equal(equations.W_x.toarray(), [[0, 0], [1, 0]])


@pytest.mark.parametrize("make", ["oscillator", "crank"])
def test_energy_balance_along_a_trajectory(make):
    """dH/dt = -dissipation + sources along a trajectory, to the integrator's tolerance."""
    equations = {"oscillator": oscillator, "crank": crank}[make]().equations()
    rtol = 1e-10
    run = solve_ivp(
        equations.system.rhs, (0, 20), equations.x0, rtol=rtol, atol=1e-12, dense_output=True
    )
    nodes, weights = np.polynomial.legendre.leggauss(12)
    spent = 0.0
    for a, b in itertools.pairwise(run.t):
        times = 0.5 * (a + b) + 0.5 * (b - a) * nodes
        power = [equations.power(t, run.sol(t)) for t in times]
        net = [p["dissipation"] - p["sources"] for p in power]
        spent += 0.5 * (b - a) * float(np.dot(weights, net))
    energy = [sum(equations.energy(t, x).values()) for t, x in
              ((0.0, run.y[:, 0]), (20.0, run.y[:, -1]))]  # fmt: skip
    # Dense output of RK45 is of order 4: a thousand times the tolerance over 20 s.
    assert abs(energy[0] - energy[1] - spent) < 1000 * rtol * max(energy)


def test_casadi_form_equals_the_numeric_one():
    import casadi as ca

    system = oscillator().equations().system
    form = system.casadi()
    f = ca.Function("f", [form.t, form.x], [form.xdot])
    x = np.array([0.4, -0.7])
    np.testing.assert_allclose(f(0.0, x).full().ravel(), system.rhs(0.0, x), rtol=1e-15)


def test_linearize_about_a_point():
    equations = oscillator().equations()
    plant = equations.linearize({"k.q": 2.0, "m.p": 0.0}, outputs=["k.q", "v.f", "b.e"])
    assert plant.dt == 0
    assert plant.state_labels == ["m_p", "k_q"]
    assert plant.output_labels == ["k_q", "v_f", "b_e"]
    # d(q + q^3/2)/dq = 1 + 1.5 q^2 = 7; the damper's slope at rest is 0.1
    np.testing.assert_allclose(plant.A, [[-0.1, -7.0], [1.0, 0.0]], rtol=1e-9)
    np.testing.assert_allclose(plant.C, [[0, 1], [1, 0], [0.1, 0]], rtol=1e-9, atol=1e-12)


def test_numeric_laws_are_linearised_by_differences():
    graph = BondGraph(
        [One("v"), I("m", 1.0), C("k", law=lambda q: np.interp(q, [-9, 9], [-18, 18]))],
        ["v -> m", "v -> k"],
    )
    np.testing.assert_allclose(
        graph.equations().linearize([0.1, 0.3]).A, [[0, -2], [1, 0]], atol=1e-9
    )


def crank():
    """A torque on an inertia that moves a spring and damper through a crank of ratio(theta)."""

    def lever(s):
        import casadi as ca

        theta = s["theta"]
        return 0.5 * (np.cos(theta) if isinstance(theta, (float, np.floating)) else ca.cos(theta))

    return BondGraph(
        [Se("torque", 0.2), One("w", position="theta", x0=0.3), I("J", 2.0), TF("crank", lever),
         One("slide"), C("k", stiffness=3.0, q0=0.1), R("b", 0.4)],
        ["torque -> w -> crank -> slide -> k", "w -> J", "slide -> b"],
    )  # fmt: skip


def test_modulated_transformer_keeps_W_constant():
    """J w' = T - a(theta) (k q + b a w),  q' = a w, a = 0.5 cos(theta)."""
    equations = crank().equations()
    assert {b.name for b in equations.auxiliaries} == {"crank.in.e", "crank.out.f"}
    rng = np.random.default_rng(0)
    for _ in range(20):
        x = rng.standard_normal(3)
        theta, p, q = x
        a, w = 0.5 * np.cos(theta), p / 2.0
        expected = [w, 0.2 - a * (3 * q + 0.4 * a * w), a * w]
        np.testing.assert_allclose(equations.system.rhs(0.0, x), expected, rtol=1e-13, atol=1e-14)
        power = equations.power(0.0, x)
        left = power["sources"] - power["dissipation"] - power["storage"]
        assert abs(left) < 1e-13
    import casadi as ca

    form = equations.system.casadi()
    f = ca.Function("f", [form.x], [form.xdot])
    np.testing.assert_allclose(f(x).full().ravel(), equations.system.rhs(0.0, x), rtol=1e-14)


def test_multiport_field_is_conservative():
    """A C-field with H = (a^2 + b^2 + a^2 b^2)/2 between two masses."""
    graph = BondGraph(
        [One("u"), I("m1", 1.0, p0=0.5), One("v"), I("m2", 2.0),
         CField("F", ("a", "b"), lambda a, b: (a + a * b * b, b + a * a * b), q0={"a": 1.0})],
        ["u -> m1", "v -> m2", "u -> F.a", "v -> F.b"],
    )  # fmt: skip
    equations = graph.equations()
    run = solve_ivp(equations.system.rhs, (0, 10), equations.x0, rtol=1e-10, atol=1e-12)
    energy = [sum(equations.energy(0.0, x).values()) for x in run.y.T[[0, -1]]]
    a, b = 1.0, 0.0
    assert energy[0] == pytest.approx(0.5 * (a * a + b * b + a * a * b * b) + 0.125, rel=1e-14)
    # RK45 drifts by about its tolerance per unit of time.
    assert abs(energy[1] - energy[0]) < 1e-8


def test_one_element_of_many_springs_on_a_node_array():
    """dx/dt = -C^-1 M^T e(q), dq/dt = M dx/dt: nodes with drag, springs through incidence M."""
    rng = np.random.default_rng(3)
    n, springs = 40, 90
    ends = np.array([rng.choice(n, 2, replace=False) for _ in range(springs)])
    M = sp.csr_array(
        (np.tile([1.0, -1.0], springs), (np.repeat(np.arange(springs), 2), ends.ravel())),
        (springs, n),
    )
    drag = rng.uniform(1, 2, (n, 1)) * np.ones((n, 3))
    graph = BondGraph(
        [One("nodes", shape=(n, 3), position="x", x0=rng.standard_normal((n, 3))),
         R("drag", conductance=1 / drag), TF("incidence", M), Zero("spring", shape=(springs, 3)),
         C("fibres", law=lambda q: 2.0 * q + q**3), NodalEffort("push", lambda t, s: -s["x"])],
        ["nodes -> drag", "nodes -> incidence -> spring -> fibres", "push -> nodes"],
    )  # fmt: skip
    equations = graph.equations()
    assert [b.name for b in equations.auxiliaries] == ["fibres.e", "push"]
    x = rng.standard_normal(equations.states.size)
    eta = equations.eta(0.0, x)
    place, q = x[: 3 * n].reshape(n, 3), x[3 * n :].reshape(springs, 3)
    np.testing.assert_allclose(eta[: 3 * springs], (2 * q + q**3).ravel(), rtol=1e-15)
    v = (-(M.T @ (2 * q + q**3)) - place) / drag
    expected = np.concatenate([v.ravel(), (M @ v).ravel()])
    np.testing.assert_allclose(equations.system.rhs(0.0, x), expected, rtol=1e-13, atol=1e-12)
    power = equations.power(0.0, x)
    pushed = -sum(equations.port_power(0.0, x)[k] for k in ("push",))
    left = pushed - power["dissipation"] - power["storage"]
    assert abs(left) < 1e-11 * (1 + power["dissipation"])


def test_internal_states_have_their_rate_in_eta():
    graph = BondGraph(
        [One("nodes", shape=(2, 3), position="x"), R("drag", 2.0), NodalEffort("f"),
         Internal("bond", Block("cell.bond", (2,), "1"), lambda t, s: 1.0 - s["cell.bond"])],
        ["nodes -> drag", "f -> nodes"],
    )  # fmt: skip
    equations = graph.equations()
    assert [b.name for b in equations.states] == ["x", "cell.bond"]
    assert [b.name for b in equations.auxiliaries] == ["f", "cell.bond.rate"]
    W = equations.W_eta.toarray()
    np.testing.assert_array_equal(W, np.diag([0.5] * 6 + [1.0, 1.0]))
    with pytest.raises(CausalityError, match="'f' was given without a law"):
        equations.eta(0.0, equations.x0)


def test_print_and_latex_show_the_equations():
    equations = crank().equations()
    text = str(equations)
    assert "d J.p   /dt = torque - crank.in.e" in text
    assert "ratio(x)" in text
    plain = str(oscillator())
    assert "d m.p /dt = -k.e - b.e" in plain
    assert "k.e = k(k.q)" in plain
    latex = oscillator().equations().latex()
    assert "\\dot {p_{\\mathrm{m}}} &= -e_{\\mathrm{k}} - e_{\\mathrm{b}}" in latex


def test_causal_strokes():
    """Every 0-junction has one bond that gives it its effort, every 1-junction one its flow."""
    graph = crank()
    tail = {k: v == "tail" for k, v in graph.equations().causality.items()}
    names = [b.name for b in graph.joined]
    for junction, bonds in graph.junction_bonds.items():
        from_outside = [tail[names[b]] == (sign > 0) for b, sign in bonds]
        one = isinstance(graph.by_name[junction], One)
        assert sum(not o if one else o for o in from_outside) == 1, junction
