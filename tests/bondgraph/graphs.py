"""Textbook bond graphs with linear state equations derived by hand.

Each entry: graph, A and B by hand (states and inputs in the graph's own order).
"""

from __future__ import annotations

import numpy as np

from cellsys.bondgraph import GY, TF, BondGraph, C, I, One, R, Se, Sf, Zero


def mass_spring_damper():
    """m v' = F - b v - k q."""
    m, k, b = 2.0, 3.0, 0.7
    graph = BondGraph(
        [Se("F"), One("v"), I("m", m), C("k", stiffness=k), R("b", b)],
        ["F -> v -> m", "v -> k", "v -> b"],
        name="mass, spring, damper",
    )
    return graph, [[-b / m, -k], [1 / m, 0]], [[1], [0]]


def series_circuit():
    """L i' = V - R i - q/C."""
    L, Rr, Cc = 0.5, 10.0, 2e-3
    graph = BondGraph(
        [Se("V"), One("i"), I("L", L), R("R", Rr), C("C", Cc)],
        ["V -> i", "i -> L", "i -> R", "i -> C"],
        units="si",
        name="series RLC",
    )
    return graph, [[-Rr / L, -1 / Cc], [1 / L, 0]], [[1], [0]]


def two_tanks():
    """Q -> tank 1 -> long pipe (inertia, friction) -> tank 2 -> valve."""
    C1, C2, Ip, Rp, Rv = 2.0, 3.0, 0.5, 0.1, 4.0
    graph = BondGraph(
        [
            Sf("Q"), Zero("p1"), C("tank1", C1), One("pipe"), I("inertia", Ip), R("friction", Rp),
            Zero("p2"), C("tank2", C2), R("valve", Rv),
        ],
        [
            "Q -> p1 -> pipe -> p2 -> valve", "p1 -> tank1", "p2 -> tank2",
            "pipe -> inertia", "pipe -> friction",
        ],
        name="two tanks",
    )  # fmt: skip
    A = [
        [0, -1 / Ip, 0],
        [1 / C1, -Rp / Ip, -1 / C2],
        [0, 1 / Ip, -1 / (Rv * C2)],
    ]
    return graph, A, [[1], [0], [0]]


def dc_motor():
    """Gyrator between circuit and shaft: e = K w, tau = K i."""
    Rr, L, K, J, b = 1.0, 0.5, 0.01, 0.02, 0.1
    graph = BondGraph(
        [
            Se("V"), One("circuit"), R("coil", Rr), I("inductor", L), GY("motor", K),
            One("shaft"), I("rotor", J), R("bearing", b),
        ],
        ["V -> circuit -> motor -> shaft", "circuit -> coil", "circuit -> inductor",
         "shaft -> rotor", "shaft -> bearing"],
        units="si",
        name="DC motor",
    )  # fmt: skip
    return graph, [[-Rr / L, -K / J], [K / L, -b / J]], [[1], [0]]


def lever():
    """Two inertias on a lever v_b = n v_a: the second depends on the first.

    (m_a + n^2 m_b) v_a' = F, so p_a' = m_a F / (m_a + n^2 m_b) = F/13 here.
    """
    m_a, m_b, n = 1.0, 3.0, 2.0
    graph = BondGraph(
        [Se("F"), One("a"), I("Ia", m_a), TF("lever", n), One("b"), I("Ib", m_b)],
        ["F -> a -> lever -> b -> Ib", "a -> Ia"],
        name="lever with dependent inertia",
    )
    return graph, [[0.0]], [[m_a / (m_a + n**2 * m_b)]]


def parallel_capacitors():
    """Two capacitors on one node fed by a current: q_1' = u C_1/(C_1 + C_2)."""
    C1, C2 = 1.0, 2.0
    graph = BondGraph(
        [Sf("u"), Zero("node"), C("C1", C1), C("C2", C2)],
        ["u -> node -> C1", "node -> C2"],
        name="parallel capacitors",
    )
    return graph, [[0.0]], [[C1 / (C1 + C2)]]


def bridge():
    """Wheatstone bridge with a capacitor across, fed by a voltage: resistors in a linear loop.

    Nodes a (top, V) and ground; b between R1 and R2, c between R3 and R4, C from b to c.
    By Thevenin the capacitor sees V (R2/(R1+R2) - R4/(R3+R4)) behind R1||R2 + R3||R4.
    """
    R1, R2, R3, R4, Cc = 1.0, 2.0, 3.0, 5.0, 0.25
    graph = BondGraph(
        [
            Se("V"), Zero("a"), One("j1"), R("R1", R1), Zero("b"), R("R2", R2),
            One("j3"), R("R3", R3), Zero("c"), R("R4", R4), One("across"), C("C", Cc),
        ],
        ["V -> a", "a -> j1 -> b -> R2", "j1 -> R1", "a -> j3 -> c -> R4", "j3 -> R3",
         "b -> across -> c", "across -> C"],
        name="resistor bridge",
    )  # fmt: skip
    behind = R1 * R2 / (R1 + R2) + R3 * R4 / (R3 + R4)
    drive = R2 / (R1 + R2) - R4 / (R3 + R4)
    return graph, [[-1 / (behind * Cc)]], [[drive / behind]]


def transformer_chain():
    """Mass, lever n1, lever n2, spring, damper: the spring seen through both."""
    m, n1, n2, k, b = 2.0, 3.0, 0.25, 4.0, 0.6
    graph = BondGraph(
        [
            Se("F"), One("v"), I("m", m), TF("T1", n1), TF("T2", n2), One("end"),
            C("k", stiffness=k), R("b", b),
        ],
        ["F -> v -> T1 -> T2 -> end -> k", "v -> m", "end -> b"],
        name="transformer chain",
    )  # fmt: skip
    r = n1 * n2
    return graph, [[-b * r * r / m, -r * k], [r / m, 0]], [[1], [0]]


def quarter_car():
    """Road velocity -> tyre -> axle -> suspension -> body."""
    kt, mu, ks, bs, ms = 200.0, 3.0, 20.0, 1.5, 30.0
    graph = BondGraph(
        [
            Sf("road"), Zero("t"), C("tyre", stiffness=kt), One("axle"), I("mu", mu), Zero("s"),
            One("strut"), C("spring", stiffness=ks), R("damper", bs), One("body"), I("ms", ms),
        ],
        ["road -> t -> axle -> s -> body -> ms", "t -> tyre", "axle -> mu", "s -> strut",
         "strut -> spring", "strut -> damper"],
        name="quarter car",
    )  # fmt: skip
    A = [
        [0, -1 / mu, 0, 0],
        [kt, -bs / mu, -ks, bs / ms],
        [0, 1 / mu, 0, -1 / ms],
        [0, bs / mu, ks, -bs / ms],
    ]
    return graph, A, [[1], [0], [0], [0]]


def gyrator_as_inductor():
    """A capacitor behind a gyrator is an inductor: L = r^2 C, beside a parallel RC."""
    r, C1, C2, Rr = 2.0, 0.5, 0.25, 3.0
    graph = BondGraph(
        [Sf("i"), Zero("n"), C("C1", C1), R("R", Rr), GY("G", r), C("C2", C2), One("j"),
         R("R2", 1.5)],
        ["i -> n -> C1", "n -> R", "n -> G -> j -> C2", "j -> R2"],
        name="gyrator as inductor",
    )  # fmt: skip
    # GY: e_in = r f_out, e_out = r f_in; on the far 1-junction r f_in = e_C2 + R2 f_out.
    R2 = 1.5
    A = [[-1 / (Rr * C1) - R2 / (r * r * C1), -1 / (r * C2)], [1 / (r * C1), 0]]
    return graph, A, [[1], [0]]


ALL = (
    mass_spring_damper, series_circuit, two_tanks, dc_motor, lever, parallel_capacitors, bridge,
    transformer_chain, quarter_car, gyrator_as_inductor,
)  # fmt: skip


def chain(n: int, *, shape: tuple[int, ...] = (), law=None) -> BondGraph:
    """n masses joined by springs and dampers, driven at one end: 8 n - 1 bonds or so."""
    elements, bonds = [Se("F", 1.0)], []
    for i in range(n):
        spring = C(f"k{i}", law=law) if law is not None else C(f"k{i}", stiffness=1.0 + i % 3)
        elements += [
            One(f"v{i}", shape=shape), I(f"m{i}", 1.0 + 0.1 * (i % 5)), Zero(f"f{i}", shape=shape),
            One(f"s{i}", shape=shape), spring, R(f"b{i}", 0.2),
        ]  # fmt: skip
        bonds += [f"v{i} -> m{i}", f"v{i} -> f{i}", f"f{i} -> s{i}", f"s{i} -> k{i}",
                  f"s{i} -> b{i}"]  # fmt: skip
        if i:
            bonds.append(f"f{i - 1} -> v{i}")
    elements += [Se("end", np.zeros(shape) if shape else 0.0)]
    bonds += ["F -> v0", f"f{n - 1} -> last -> end"]
    elements += [One("last", shape=shape), R("b_end", 1.0)]
    bonds += ["last -> b_end"]
    return BondGraph(elements, bonds, name=f"chain of {n}")
