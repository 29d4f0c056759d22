"""Bond graph of the 1-D crawling cell between two switches [thesis Fig. 6b].

Scalar bonds; 1-junctions are the velocities of trail, lead and the two attached nodes, each
spring hangs on the 0-junction-and-1-junction pair of its own rate. The eight storages and five
resistors give a W with entries 0 and +-1.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cellsys.bondgraph import BondElement, BondGraph, C, I, One, R, Zero
from cellsys.geometry.chain import Chain
from cellsys.mechanics.crawler import Crawler


def crawler_graph(
    cell: Crawler, chain: Chain, trail_node: int | None = None, lead_node: int | None = None
) -> BondGraph:
    """The cell's bond graph while it holds these nodes; heading 1.

    Parameters
    ----------
    trail_node, lead_node : int, optional
        Attached nodes; default those of the start.

    Returns
    -------
    BondGraph
        States: ``m_trail.p, m_lead.p``, stretch ``.q`` of ``cell, G1, G2`` (adhesions) and of the
        sections ``behind, between, ahead``.
    """
    i = cell.trail_node if trail_node is None else trail_node
    j = cell.lead_node if lead_node is None else lead_node
    a = chain.spacing

    def section(name: str, springs: int) -> C:
        def tension(q: Any) -> Any:
            strain = q / (springs * a)
            return chain.stiffness * (strain + chain.stiffening * strain**3)

        return C(name, law=tension)

    def drag(name: str) -> R:
        return R(
            name,
            law=lambda v: cell.drag * v + cell.drag2 * v * (v * v) ** 0.5,
            monotone=True,
        )

    def spring(q: Any) -> Any:
        return cell.stiffness * q + cell.stiffness3 * q**3

    elements: list[BondElement] = [
        One("trail"), One("lead"), One("node1"), One("node2"),
        I("m_trail", cell.mass), I("m_lead", cell.mass), drag("B_trail"), drag("B_lead"),
        C("cell", law=spring), R("b_cell", cell.damping),
        C("G1", stiffness=cell.adhesion_trail), C("G2", stiffness=cell.adhesion_lead),
        section("behind", i), section("between", j - i), section("ahead", chain.nodes + 1 - j),
        R("b_node1", chain.drag), R("b_node2", chain.drag),
    ]  # fmt: skip
    bonds = [
        "trail -> m_trail", "lead -> m_lead", "trail -> B_trail", "lead -> B_lead",
        "node1 -> b_node1", "node2 -> b_node2", "node1 -> behind", "ahead -> node2",
    ]  # fmt: skip
    # A spring between two velocities: 0-junction for its force, 1-junction for its rate.
    for low, high, parts in (
        ("trail", "lead", ("cell", "b_cell")),
        ("node1", "trail", ("G1",)),
        ("lead", "node2", ("G2",)),
        ("node1", "node2", ("between",)),
    ):
        rate = f"{parts[0]}.rate"
        force = f"{parts[0]}.force"
        elements += [Zero(force), One(rate)] if len(parts) > 1 else [Zero(force)]
        bonds += [f"{force} -> {low}", f"{high} -> {force}"]
        if len(parts) > 1:
            bonds += [f"{force} -> {rate}", *(f"{rate} -> {p}" for p in parts)]
        else:
            bonds += [f"{force} -> {parts[0]}"]
    return BondGraph(elements, bonds, name="1-D crawling cell")


def graph_state(cell: Crawler, chain: Chain, x: np.ndarray) -> np.ndarray:
    """The graph's eight states from a state of `CrawlerSystem` with one cell, thesis order.

    Order of the graph: m_trail.p, m_lead.p, cell.q, G1.q, G2.q, behind.q, between.q, ahead.q.
    """
    lead, trail, p_lead, p_trail, ecm1, ecm2, _, d_cell = x[:8]
    i, j = x[-1], x[-2]
    a = chain.spacing
    behind = ecm1 - a * i
    ahead = -(ecm2 - a * j)
    return np.array(
        [
            p_trail, p_lead, d_cell - cell.length, trail - ecm1, ecm2 - lead,
            behind, (ecm2 - a * j) - behind, ahead,
        ]
    )  # fmt: skip
