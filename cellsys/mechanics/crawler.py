"""The 1-D crawling cell of thesis chapter 3, as a hybrid system: one cell or several on one chain.

Two masses (lead, trail) joined by a spring and damper pull, through adhesion springs G1 and G2,
on two nodes of a chain (`Chain`). Between switches, with heading h = +-1 and tension positive,

    dp_lead/dt  = h (e_ECM2 - e_dECM - e_cell) - e_Blead - b_E f_ECM2
    dp_trail/dt = h (e_cell + e_dECM - e_ECM1) - e_Btrail - b_E f_ECM1            [thesis 38]

with ECM1 the trail's node and ECM2 the lead's: the adhesion force is written by the balance of
the attached node, b_E f_ECM = sum of tensions + adhesion [notes: theory, crawler].

Switching: the lead lets go and takes the next node ahead when its adhesion has relaxed to
`grab`; the trail breaks and takes the next node when its adhesion is stretched to `rupture`. The
reset map moves the attachment to that node where it is, then puts released nodes on the line
between their attached neighbours (massless nodes relax at once); masses keep position and
momentum. No motor: each re-grab of a stretched spring brings in energy.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from cellsys.arguments import checked
from cellsys.errors import ParameterError, SceneError
from cellsys.geometry.chain import MOST, Chain
from cellsys.mechanics import crawler_kernels as kernels
from cellsys.system import Block, EventFunction, Layout, OdeSystem

_Guard = Callable[[float, np.ndarray], float]
_Reset = Callable[[float, np.ndarray], np.ndarray]
_CELL_STATES = (
    ("lead", "um", "position"),
    ("trail", "um", "position"),
    ("p_lead", "pN s", "internal"),
    ("p_trail", "pN s", "internal"),
    ("ecm1", "um", "position"),
    ("ecm2", "um", "position"),
    ("d_ecm", "um", "position"),
    ("d_cell", "um", "position"),
)
_CELL_AUXILIARIES = (
    ("f_trail", "um/s"),
    ("f_lead", "um/s"),
    ("e_cell", "pN"),
    ("e_Btrail", "pN"),
    ("f_ECM1", "um/s"),
    ("f_ECM2", "um/s"),
    ("e_ECM1", "pN"),
    ("e_ECM2", "pN"),
    ("e_dECM", "pN"),
    ("e_Blead", "pN"),
)


@checked
@dataclass(frozen=True, kw_only=True)
class Crawler:
    """Parameters and start of one 1-D cell.

    Parameters
    ----------
    mass : float
        Of lead and trail each, pN s^2/um.
    drag, drag2 : float
        e_B = drag v + drag2 v |v|, pN s/um and pN s^2/um^2.
    stiffness, stiffness3, damping, length : float
        e_cell = stiffness s + stiffness3 s^3 + damping ds/dt, s = d_cell - length.
    adhesion_trail, adhesion_lead : float
        G1, G2, pN/um.
    grab, rupture : float
        Adhesion stretch at which the lead takes the next node, and at which the trail breaks, um.
    heading : {1, -1}
        Direction of crawling.
    trail_node, lead_node : int
        Nodes held at the start, counted from 1.
    trail, lead : float, optional
        Positions at the start, um; default at the held nodes.
    trail_velocity, lead_velocity : float
        At the start, um/s.

    Notes
    -----
    Default numbers: a working set without dimensions [notes: mechanics, crawler].
    """

    mass: float = 0.2
    drag: float = 1.0
    drag2: float = 0.3
    stiffness: float = 2.0
    stiffness3: float = 0.5
    damping: float = 0.5
    length: float = 4.0
    adhesion_trail: float = 6.0
    adhesion_lead: float = 6.0
    grab: float = 0.30
    rupture: float = 0.35
    heading: int = 1
    trail_node: int = 4
    lead_node: int = 8
    trail: float | None = None
    lead: float | None = None
    trail_velocity: float = 0.0
    lead_velocity: float = 0.0

    def __post_init__(self) -> None:
        for name in ("mass", "adhesion_trail", "adhesion_lead"):
            if not 1.0 / MOST <= getattr(self, name) <= MOST:
                raise ParameterError(
                    f"Crawler.{name} must be > 0, in [{1 / MOST:g}, {MOST:g}], "
                    f"got {getattr(self, name)!r}"
                )
        for name in ("drag", "drag2", "stiffness", "stiffness3", "damping", "length", "rupture"):
            if not 0 <= getattr(self, name) <= MOST:
                raise ParameterError(
                    f"Crawler.{name} must be >= 0 and <= {MOST:g}, got {getattr(self, name)!r}"
                )
        for name in ("grab", "trail", "lead", "trail_velocity", "lead_velocity"):
            value = getattr(self, name)
            if value is not None and not abs(value) <= MOST:
                raise ParameterError(
                    f"Crawler.{name} must be finite and at most {MOST:g} in size, got {value!r}"
                )
        if self.heading not in (1, -1):
            raise ParameterError(f"Crawler.heading must be 1 or -1, got {self.heading!r}")
        if (self.lead_node - self.trail_node) * self.heading < 1:
            raise ParameterError(
                f"Crawler.lead_node = {self.lead_node} must lie ahead of trail_node = "
                f"{self.trail_node} for heading {self.heading}"
            )

    def row(self) -> list[float]:
        """Numbers in the order of the compiled loops."""
        return [
            self.mass, self.drag, self.drag2, self.stiffness, self.stiffness3, self.damping,
            self.length, self.adhesion_trail, self.adhesion_lead, self.grab, self.rupture,
            float(self.heading),
        ]  # fmt: skip


@checked
def build_crawlers(cells: Sequence[Crawler], chain: Chain | None = None) -> CrawlerSystem:
    """One or several crawling cells on one chain.

    Raises
    ------
    SceneError
        No cell, a node outside the chain, or cells whose attachments cross or share a node.
    """
    return CrawlerSystem(tuple(cells), chain if chain is not None else Chain())


@checked
class CrawlerSystem(OdeSystem):
    """Cells on a chain: states of thesis eq. 37, then the held nodes [45].

    States: per cell ``cellK.lead, trail, p_lead, p_trail, ecm1, ecm2, d_ecm, d_cell``;
    ``chain.displacement`` (N,) from rest; per cell ``i_lead, i_trail`` (they change only at
    events). Auxiliaries: per cell thesis eq. 40 and e_Blead; ``chain.velocity`` (N,). All laws
    are in eta, as in eq. 39; W_eta is constant with entries 0, +-1 and -b_E.
    """

    cells: tuple[Crawler, ...]
    chain: Chain
    _table: np.ndarray  # one row of numbers per cell
    _numbers: np.ndarray  # of the chain
    _events: tuple[EventFunction, ...]

    def __init__(self, cells: tuple[Crawler, ...], chain: Chain) -> None:
        check_places(cells, chain)
        K, N = len(cells), chain.nodes
        names = [f"cell{k + 1}" for k in range(K)]
        states = Layout(
            [
                Block(f"{n}.{s}", (), u, role="component", kind=k)
                for n in names
                for s, u, k in _CELL_STATES
            ]
            + [Block("chain.displacement", (N,), "um", role="field")]
            + [
                Block(f"{n}.{s}", (), "1", role="component", kind="internal")
                for n in names
                for s in ("i_lead", "i_trail")
            ]
        )
        auxiliaries = Layout(
            [Block(f"{n}.{a}", (), u, role="component", kind="rate") for n in names
             for a, u in _CELL_AUXILIARIES]
            + [Block("chain.velocity", (N,), "um/s", role="field", kind="rate")]
        )  # fmt: skip
        table = np.array([c.row() for c in cells])
        numbers = np.array([chain.spacing, chain.stiffness, chain.stiffening, chain.drag])
        x0 = np.zeros(states.size)
        for k, cell in enumerate(cells):
            b, i = 8 * k, 8 * K + N + 2 * k
            at_trail, at_lead = cell.trail_node * chain.spacing, cell.lead_node * chain.spacing
            trail = at_trail if cell.trail is None else cell.trail
            lead = at_lead if cell.lead is None else cell.lead
            x0[b : b + 8] = [
                lead, trail, cell.mass * cell.lead_velocity, cell.mass * cell.trail_velocity,
                at_trail, at_lead, cell.heading * (at_lead - at_trail),
                cell.heading * (lead - trail),
            ]  # fmt: skip
            x0[i : i + 2] = cell.lead_node, cell.trail_node
        super().__init__(
            states=states, x0=x0, auxiliaries=auxiliaries, W_eta=_junctions(cells, chain)
        )
        for name, value in (
            ("cells", cells),
            ("chain", chain),
            ("_table", table),
            ("_numbers", numbers),
            ("_events", tuple(_events(table, numbers, N))),
        ):
            object.__setattr__(self, name, value)

    def eta(self, t: float, x: np.ndarray) -> np.ndarray:
        out = np.empty(self.auxiliaries.size)
        kernels.auxiliaries(x, self._table, self._numbers, self.chain.nodes, out)
        return out

    def rhs(self, t: float, x: np.ndarray) -> np.ndarray:
        out = np.empty(self.states.size)
        kernels.rates(x, self._table, self._numbers, self.chain.nodes, out)
        return out

    def u(self, t: float, x: np.ndarray) -> np.ndarray:
        return np.zeros(self.states.size)

    def events(self) -> tuple[EventFunction, ...]:
        return self._events

    def energy(self, x: np.ndarray) -> float:
        """Stored energy of masses, cell and adhesion springs and the chain, pN um."""
        N, K, total = self.chain.nodes, len(self.cells), 0.0
        for k, cell in enumerate(self.cells):
            lead, trail, p_lead, p_trail, ecm1, ecm2, _, d_cell = x[8 * k : 8 * k + 8]
            s = d_cell - cell.length
            total += (p_lead**2 + p_trail**2) / (2.0 * cell.mass)
            total += 0.5 * cell.stiffness * s**2 + 0.25 * cell.stiffness3 * s**4
            total += 0.5 * cell.adhesion_trail * (trail - ecm1) ** 2
            total += 0.5 * cell.adhesion_lead * (lead - ecm2) ** 2
        u = np.concatenate([[0.0], x[8 * K : 8 * K + N], [0.0]])
        strain = np.diff(u) / self.chain.spacing
        density = 0.5 * strain**2 + 0.25 * self.chain.stiffening * strain**4
        return float(total + self.chain.stiffness * self.chain.spacing * density.sum())

    def dissipation(self, x: np.ndarray) -> float:
        """Power lost in the drags of masses and attached nodes and in cell dampers, pN um/s."""
        eta, total = self.eta(0.0, x), 0.0
        for k, cell in enumerate(self.cells):
            v_trail, v_lead, _, e_trail, f1, f2, _, _, _, e_lead = eta[10 * k : 10 * k + 10]
            total += e_trail * v_trail + e_lead * v_lead + cell.damping * (v_lead - v_trail) ** 2
            total += self.chain.drag * (f1**2 + f2**2)
        return float(total)

    def loads(self, x: np.ndarray) -> np.ndarray:
        """Nodal loads of adhesion and drag on the chain (..., N), pN, of states (..., n)."""
        x = np.atleast_2d(x)
        K, N = len(self.cells), self.chain.nodes
        u = x[..., 8 * K : 8 * K + N]
        return self.chain.loads(u)


def check_places(cells: tuple[Crawler, ...], chain: Chain) -> None:
    """Raise `SceneError` for no cell, nodes outside the chain, or cells on each other's nodes."""
    if not cells:
        raise SceneError("a chain needs at least one cell")
    spans = []
    for k, cell in enumerate(cells):
        low, high = sorted((cell.trail_node, cell.lead_node))
        for name in ("trail_node", "lead_node"):
            node = getattr(cell, name)
            if not 1 <= node <= chain.nodes:
                raise SceneError(
                    f"cells[{k}].{name} = {node} must be one of the chain's nodes 1..{chain.nodes}"
                )
        spans.append((low, high, k))
    spans.sort()
    for (_, high, a), (low, _, b) in itertools.pairwise(spans):
        if low <= high:
            raise SceneError(
                f"cell{a + 1} and cell{b + 1} overlap on nodes {low}..{high}; "
                "move one of them (trail_node, lead_node)"
            )


def _junctions(cells: tuple[Crawler, ...], chain: Chain) -> sp.csr_array:
    """W_eta of thesis eq. 39 as it is read in [notes: theory, crawler]."""
    K, N = len(cells), chain.nodes
    W = sp.lil_array((10 * K + N, 10 * K + N))
    for k, cell in enumerate(cells):
        h, b, e = cell.heading, 8 * k, 10 * k
        f_trail, f_lead, e_cell, e_Bt, f1, f2, e1, e2, e_d, e_Bl = range(e, e + 10)
        W[b, f_lead] = W[b + 1, f_trail] = 1
        for row, terms in (
            (b + 2, ((e2, h), (e_d, -h), (e_cell, -h), (e_Bl, -1), (f2, -chain.drag))),
            (b + 3, ((e_cell, h), (e_d, h), (e1, -h), (e_Bt, -1), (f1, -chain.drag))),
            (b + 4, ((f1, 1),)),
            (b + 5, ((f2, 1),)),
            (b + 6, ((f2, h), (f1, -h))),
            (b + 7, ((f_lead, h), (f_trail, -h))),
        ):
            for column, value in terms:
                W[row, column] = value
    W[8 * K + np.arange(N), 10 * K + np.arange(N)] = 1
    return sp.csr_array(W)


def _events(table: np.ndarray, numbers: np.ndarray, N: int) -> list[EventFunction]:
    """Lead and trail of every cell: level guards, so that nothing already past is missed."""

    def pair(c: int, trail: bool) -> tuple[_Guard, _Reset]:
        return (
            lambda t, x: kernels.guard(x, table, N, c, trail),
            lambda t, x: kernels.regrab(x, table, numbers, N, c, trail),
        )

    out = []
    for c in range(len(table)):
        for trail, name in ((False, "lead takes the next node"), (True, "trail breaks")):
            guard, reset = pair(c, trail)
            out.append(
                EventFunction(
                    name=f"cell{c + 1} {name}", guard=guard, direction=-1, reset=reset, level=True
                )
            )
    return out
