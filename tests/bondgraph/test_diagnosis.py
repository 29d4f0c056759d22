"""What is wrong with a graph is said by name."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from cellsys.bondgraph import GY, TF, BondGraph, C, CField, I, One, R, Se, Sf, Zero
from cellsys.errors import (
    CausalityError,
    DimensionError,
    NotSymbolicError,
    ParameterError,
    UnitError,
)


def cube(v):
    return v**3


def test_conflicting_sources():
    graph = BondGraph(
        [Se("battery", 1), Se("mains", 2), Zero("n"), R("r", 1.0)],
        ["battery -> n", "mains -> n", "n -> r"],
    )
    with pytest.raises(CausalityError, match=r"'mains' conflicts with 'battery'.*same effort"):
        graph.equations()


def test_nonlinear_dependent_storage_is_refused_with_the_reason():
    graph = BondGraph(
        [Sf("u"), Zero("n"), C("a", law=cube), C("b", law=cube)], ["u -> n -> a", "n -> b"]
    )
    with pytest.raises(CausalityError, match=r"'b' is nonlinear and dependent.*'a'.*M\(x\)"):
        graph.equations()


def test_linear_storage_dependent_on_a_nonlinear_one_is_refused():
    graph = BondGraph(
        [Sf("u"), Zero("n"), C("a", 1.0), C("b", law=cube)], ["u -> n -> a", "n -> b"]
    )
    with pytest.raises(CausalityError, match=r"'a' is dependent on the nonlinear element 'b\.e'"):
        graph.equations()


def test_storage_on_a_source():
    """Dependent on a constant voltage it holds a constant charge; on a varying one: refused."""
    elements = [Zero("n"), C("c", 2.0), R("r", 1.0)]
    bonds = ["V -> n -> c", "n -> r"]
    assert BondGraph([Se("V", 3.0), *elements], bonds).equations().dependent == ("c",)
    with pytest.raises(CausalityError, match="time-varying source 'V'"):
        BondGraph([Se("V", np.sin), *elements], bonds).equations()


def resistors(**laws):
    """Capacitor -> R1 in series with (R2 || R3): no storage between the resistors."""
    return BondGraph(
        [C("c", 1.0, q0=2.0), One("j"), R("r1", **laws["r1"]), Zero("n"), R("r2", **laws["r2"]),
         R("r3", 4.0)],
        ["c -> j -> n -> r2", "j -> r1", "n -> r3"],
    )  # fmt: skip


def test_algebraic_loop_of_resistors():
    r1, r2 = {"law": cube}, {"inverse": lambda e: e + e**3}
    with pytest.raises(CausalityError, match=r"algebraic loop through 'r1\.e', 'r2\.f'"):
        resistors(r1=r1, r2=r2).equations()
    equations = resistors(r1={**r1, "monotone": True}, r2={**r2, "monotone": True}).equations()
    assert equations.loops == (("r1.e", "r2.f"),)
    flow = brentq(
        lambda f: 2.0 - f**3 - brentq(lambda e: e + e**3 + e / 4 - f, -9, 9, xtol=1e-15),
        0, 3, xtol=1e-15,
    )  # fmt: skip
    # The capacitor's bond points out of it: its displacement falls by the flow.
    rate = equations.system.rhs(0.0, np.array([-2.0]))
    assert abs(abs(rate[0]) - flow) < 1e-12  # Newton to rounding, brentq to 1e-15
    power = equations.power(0.0, np.array([2.0]))
    assert abs(power["dissipation"] + power["storage"]) < 1e-12
    with pytest.raises(NotSymbolicError, match="algebraic loop"):
        equations.system.casadi()
    # It is still linearised, by differences of the solved loop.
    rates = [equations.system.rhs(0.0, np.array([q]))[0] for q in (2.0 + 1e-5, 2.0 - 1e-5)]
    slope = (rates[0] - rates[1]) / 2e-5
    assert equations.linearize({"c.q": 2.0}).A[0, 0] == pytest.approx(slope, rel=1e-6)


def test_resistor_forced_the_other_way_round():
    graph = BondGraph([Se("V", 1.0), Zero("n"), R("r", law=cube)], ["V -> n -> r"])
    with pytest.raises(CausalityError, match=r"'r' must give its flow.*'V'.*inverse="):
        graph.equations()


def test_disconnected_parts_and_open_ports():
    with pytest.raises(CausalityError, match=r"2 disconnected parts: \{m, j, F\}; \{n, c, r\}"):
        BondGraph(
            [I("m", 1.0), One("j"), Se("F"), Zero("n"), C("c", 1.0), R("r", 1.0)],
            ["F -> j -> m", "c -> n -> r"],
        )
    with pytest.raises(CausalityError, match=r"'T\.out' is left open"):
        BondGraph([Se("F"), TF("T", 2.0)], ["F -> T"])
    with pytest.raises(CausalityError, match="junction 'j' has 1 bond"):
        BondGraph([Se("F"), One("j")], ["F -> j"])
    with pytest.raises(CausalityError, match="'m' has 2 bonds"):
        BondGraph([I("m", 1.0), One("a"), One("b")], ["a -> m", "b -> m", "a -> b"])


def test_a_loop_of_junctions_without_an_element():
    graph = BondGraph(
        [Se("V"), Zero("a"), Zero("b"), R("r", 1.0)], ["V -> a", "a -> b", "a -> b", "b -> r"]
    )
    with pytest.raises(CausalityError, match="nothing determines"):
        graph.equations()


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: BondGraph([One("a"), One("a")], []), ParameterError, "'a' is given twice"),
        (lambda: BondGraph([One("a")], ["a -> b"]), ParameterError, "no element 'b'"),
        (lambda: BondGraph([One("a")], ["a"]), ParameterError, "two ends"),
        (lambda: R("r"), ParameterError, "exactly one of"),
        (lambda: C("c", 1.0, stiffness=2.0), ParameterError, "exactly one of"),
        (lambda: CField("c"), ParameterError, "named ends"),
        (
            lambda: BondGraph([Zero("a", shape=(2, 3)), Zero("b")], ["a -> b", "a -> b"]),
            ParameterError,
            "different shape",
        ),
    ],
)
def test_bad_declarations(make, error, words):
    with pytest.raises(error, match=words):
        make()


@pytest.mark.parametrize(
    ("element", "error", "words"),
    [
        (R("r", -1.0), ParameterError, "must be >= 0"),
        (R("r", np.nan), ParameterError, "finite"),
        (R("r", "3 blub"), UnitError, "unknown unit"),
        (R("r", "3 N/m"), UnitError, "wrong dimension"),
        (R("r", np.ones(4)), DimensionError, "must fit shape"),
        (R("r", "2 ohm"), UnitError, "wrong dimension"),
    ],
)
def test_bad_parameters(element, error, words):
    graph = BondGraph(
        [Se("F", "1 N"), One("j", domain="translation"), I("m", "1 kg"), element],
        ["F -> j -> m", "j -> r"],
        units="si",
    )
    with pytest.raises(error, match=words):
        graph.equations()


def test_units_are_converted():
    def damping(units):
        graph = BondGraph(
            [Se("F"), One("j", domain="translation"), I("m", "1 kg"), R("r", "2 N s/m")],
            ["F -> j -> m", "j -> r"],
            units=units,
        )
        return graph.equations()

    # -r/m = -2 1/s in any units; the state's unit follows
    for units, name in (("si", "N s"), ("cell", "pN s")):
        equations = damping(units)
        assert equations.W_x.toarray()[0, 0] == pytest.approx(-2.0, rel=1e-12)
        assert equations.states["m.p"].unit == name


def test_gyrator_ratio_has_units():
    def motor(ratio):
        return BondGraph(
            [Se("V", "1 V"), One("i", domain="electric"), I("L", "1 H"), GY("K", ratio),
             One("w", domain="rotation"), I("J", "1 kg m^2")],
            ["V -> i -> K -> w -> J", "i -> L"],
            units="si",
        ).equations()  # fmt: skip

    assert motor("10 mN m/A").W_x.toarray()[0, 1] == pytest.approx(-0.01)
    assert motor("10 mV s").W_x.toarray()[0, 1] == pytest.approx(-0.01)
    with pytest.raises(UnitError, match="wrong dimension"):
        motor("10 N")


def test_sources_have_units_and_may_depend_on_time():
    def circuit(value):
        return BondGraph(
            [Se("V", value), One("i", domain="electric"), R("r", "1 ohm"), I("L", "2 H")],
            ["V -> i -> r", "i -> L"],
            units="si",
        ).equations()

    np.testing.assert_allclose(circuit("250 mV").u(0.0, np.zeros(1)), [0.25])
    np.testing.assert_allclose(circuit(np.sin).u(0.3, np.zeros(1)), [np.sin(0.3)])
    with pytest.raises(UnitError, match=r"source 'V'.*wrong dimension"):
        circuit("3 A")


def test_a_law_of_the_wrong_size_is_named():
    graph = BondGraph(
        [One("v", shape=(2, 3)), I("m", 1.0), C("k", law=lambda q: q[0])], ["v -> m", "v -> k"]
    )
    with pytest.raises(DimensionError, match=r"law of 'k\.e' must return 6 value"):
        graph.equations().system.rhs(0.0, np.zeros(12))
