"""The 2.5-D full-order model: cells on a fibre disc, assembled from the effects of a scene.

    C dx/dt = sum of nodal efforts + exogenous forces          [thesis eq. 60-71]

Every effect that is present puts elements on junction arrays (nodes of a cell, nodes of the
matrix); each element's port is a block of eta with the constant block I/C of W_eta. What is
absent has no block, no state and no cost [notes: mechanics, equation of motion].
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from cellsys.effects.matrix import Drag
from cellsys.effects.protocol import Configuration, Effect, Element, JunctionArray, Site, Stiffness
from cellsys.effects.tangent import combine
from cellsys.geometry.network import FibreNetwork
from cellsys.laws.sensing import nodal_sum
from cellsys.mechanics.cholesky import SparseCholesky
from cellsys.mechanics.junctions import Place, junction_graph, place_of, product
from cellsys.mechanics.node_arrays import CellSpec, held, node_arrays
from cellsys.mechanics.rest import rested
from cellsys.overdamped import MajorantBlock, OverdampedSystem, RankOne
from cellsys.system import Event, Layout

_Driven = tuple[Element, tuple[tuple[slice, tuple[int, ...], np.ndarray], ...], tuple[Place, ...]]


def build_spreading(
    cells: tuple[CellSpec, ...],
    matrix: FibreNetwork | None,
    effects: dict[str, Effect],
    drag: Drag,
) -> SpreadingSystem:
    """Assemble the system; effects are checked against their needs by the caller's scene.

    `effects` are those that do not act on a single cell. Elements are built on the matrix, then
    on one cell after the other, then on all cells together, then on all node arrays.
    """
    bodies = tuple(c.body for c in cells)
    arrays = list(node_arrays(cells, matrix, drag))
    elements: list[Element] = []

    def attach(kind: str, chosen: dict[str, Effect], site: Site) -> Site:
        for effect in chosen.values():
            if effect.acts_on == kind:
                site = replace(site, arrays=tuple(arrays), built=tuple(elements))
                arrays.extend(effect.arrays(site))
                elements.extend(effect.elements(replace(site, arrays=tuple(arrays))))
        return replace(site, arrays=tuple(arrays), built=tuple(elements))

    whole = Site(cell=None, matrix=matrix, commands=None, effects=effects, cells=bodies)
    if matrix is not None:
        attach("matrix", effects, whole)
    for cell in cells:
        own = Site(
            cell=cell.body,
            matrix=matrix,
            commands=cell.commands,
            effects={**effects, **cell.effects},
            cells=bodies,
        )
        attach("cell", cell.effects, own)
        if any(effect.steers for effect in cell.effects.values()):
            from cellsys.effects.steering import polarity_element

            elements.append(polarity_element(replace(own, built=tuple(elements))))
    attach("cells", effects, whole)
    holding = [e for e in elements if e.holds]
    arrays = [held(array, holding) for array in arrays]
    attach("scene", effects, whole)
    for element in elements:
        element.connect(elements)
    lies = matrix is None or matrix.flat
    return SpreadingSystem(
        cells, matrix, tuple(elements), tuple(rested(arrays, elements, lies=lies))
    )


class SpreadingSystem(OverdampedSystem):
    """Cells and matrix as one overdamped system; see the module's text.

    States: ``cellK.position`` (n, 3) um, ``matrix.displacement`` (N, 3) um from rest, then
    internal states. Auxiliaries: one nodal force block per port, pN, then the rates of the
    internal states. Linear laws (foundation) stay in eta too: the log holds interval averages,
    and the average of a linear law is no function of x_k.
    """

    _made_by: ClassVar[str] = "cs.build(scene) of a scene on a disc"

    cells: tuple[CellSpec, ...]
    matrix: FibreNetwork | None
    elements: tuple[Element, ...]
    arrays: tuple[JunctionArray, ...]
    _arrays: dict[str, str]  # block of each array
    _index: dict[str, np.ndarray]
    _drag: np.ndarray
    _last: tuple[tuple[np.ndarray, Configuration], ...]
    _senses: bool
    _nodes: tuple[tuple[str, slice, tuple[int, ...]], ...]
    _inside: tuple[tuple[str, slice, tuple[int, ...]], ...]
    _forces: tuple[tuple[Element, tuple[Place, ...]], ...]
    _driven: tuple[_Driven, ...]
    _undriven: np.ndarray
    _advancing: tuple[Element, ...]
    _low_rank: tuple[Element, ...]
    _switching: tuple[Element, ...]
    _blocks: tuple[tuple[slice, slice], ...]
    _cholesky: dict[str, SparseCholesky]

    def __init__(
        self,
        cells: tuple[CellSpec, ...],
        matrix: FibreNetwork | None,
        elements: tuple[Element, ...],
        nodes: tuple[JunctionArray, ...],
    ) -> None:
        arrays = {array.name: array.block.name for array in nodes}
        inside = [b for e in elements for b in e.internal]
        equations = junction_graph(
            nodes,
            list(dict.fromkeys(p for e in elements for p in e.ports)),
            [(b, np.asarray(e.initial(b), float)) for e in elements for b in e.internal],
        ).equations()
        states, auxiliaries = equations.states, equations.auxiliaries
        c = np.zeros(states.size)
        for array in nodes:
            c[states.slice(array.block.name)] = array.drag.ravel()
        mobility = np.where(c > 0, 1.0 / np.where(c > 0, c, 1.0), 1.0)  # 0 where clamped
        inputs = Layout([block for e in elements for block in e.commanded])
        super().__init__(
            states=states,
            x0=equations.x0,
            auxiliaries=auxiliaries,
            inputs=inputs,
            W_eta=equations.W_eta,
        )
        still = np.zeros(states.size)
        still.setflags(write=False)

        def driven(element: Element) -> _Driven:
            pushed = [place_of(states, arrays[port.array]) for port in element.inputs]
            return (
                element,
                tuple((piece, shape, mobility[piece]) for piece, shape in pushed),
                tuple(place_of(states, arrays[h.array]) for h in element.holds),
            )

        for name, value in (
            ("cells", cells),
            ("matrix", matrix),
            ("elements", elements),
            ("arrays", nodes),
            ("_arrays", arrays),
            ("_drag", c),
            ("_last", ()),
            ("_senses", any(getattr(e, "sensing", None) is not None for e in elements)),
            # What a step goes through, found once: what is absent is not asked.
            ("_nodes", tuple((a, *place_of(states, b)) for a, b in arrays.items())),
            ("_inside", tuple((b.name, *place_of(states, b.name)) for b in inside)),
            (
                "_forces",
                tuple(
                    (e, tuple(place_of(auxiliaries, p.block) for p in e.ports))
                    for e in elements
                    if e.ports
                ),
            ),
            ("_driven", tuple(driven(e) for e in elements if e.inputs or e.holds)),
            ("_undriven", still),
            ("_advancing", tuple(e for e in elements if e.internal or e.holds)),
            ("_low_rank", _having("low_rank", elements)),
            ("_switching", _having("between_steps", elements)),
            (
                "_blocks",
                tuple((states.slice(b.name), auxiliaries.slice(f"{b.name}.rate")) for b in inside),
            ),
            ("_cholesky", {}),
        ):
            object.__setattr__(self, name, value)
        index = {a: np.arange(p.start, p.stop).reshape(-1, 3) for a, p, _ in self._nodes}
        object.__setattr__(self, "_index", index)

    def nodes_of(self, array: str) -> int:
        """Number of nodes of a junction array."""
        return len(self._index[array])

    # Views

    def configuration(self, t: float, x: np.ndarray) -> Configuration:
        """Named views into x; those of the step under way are kept, with what was found there."""
        for kept_x, kept in self._last:
            if kept_x is x and kept.t == t:
                return kept
        nodes = {a: x[piece].reshape(shape) for a, piece, shape in self._nodes}
        internal = {b: x[piece].reshape(shape) for b, piece, shape in self._inside}
        return Configuration(t, nodes, internal)

    def energy(self, t: float, x: np.ndarray) -> dict[str, float]:
        """Stored energy of every element that has one, pN um."""
        s, stored = self.configuration(t, x), _having("energy", self.elements)
        return {element.name: float(element.energy(s)) for element in stored}

    # OdeSystem

    def efforts(self, t: float, x: np.ndarray) -> np.ndarray:
        return self._efforts(self.configuration(t, x))

    def _efforts(self, s: Configuration) -> np.ndarray:
        eta = np.zeros(self.auxiliaries.size)
        for element, places in self._forces:
            element.efforts(s, tuple([eta[piece].reshape(shape) for piece, shape in places]))
        return eta

    def eta(self, t: float, x: np.ndarray) -> np.ndarray:
        return self.laws(t, x)[0]

    def laws(self, t: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        s = self.configuration(t, x)
        eta, u = self._efforts(s), self._u(s)
        rate = self.rate(x, eta, u)
        velocity = {a: self.states.view(rate, b) for a, b in self._arrays.items()}
        for element in self.elements:
            if element.internal:
                out = tuple(self.auxiliaries.view(eta, f"{b.name}.rate") for b in element.internal)
                element.rates(s, velocity, out)
        for states, rates in self._blocks:
            rate[states] = eta[rates]  # by W_eta = 1
        return eta, u, rate

    def u(self, t: float, x: np.ndarray) -> np.ndarray:
        return self._u(self.configuration(t, x))

    def rate(self, x: np.ndarray, eta: np.ndarray, u: np.ndarray) -> np.ndarray:
        out = u.copy() if self._driven else np.zeros(self.states.size)
        product(self.W_eta.indptr, self.W_eta.indices, self.W_eta.data, eta, out)
        return out

    def _u(self, s: Configuration) -> np.ndarray:
        if not self._driven:
            return self._undriven
        u = np.zeros(self.states.size)
        for element, pushed, places in self._driven:
            for piece, shape, mobility in pushed:
                out = np.zeros(shape)
                element.force(s, (out,))
                u[piece] += mobility * out.ravel()
            if places:
                element.flows(s, tuple([u[piece].reshape(shape) for piece, shape in places]))
        return u

    def geometry(self) -> dict[str, np.ndarray]:
        """Constant places by name.

        ``cellK.triangles`` (m, 3), corners of the membrane's triangles; of a matrix
        ``matrix.rest`` (N, 3) um, ``matrix.surface``, the nodes that adhesions reach,
        ``matrix.fibres`` (m, 2), the ends of the fibres, and ``matrix.stiffness`` (N,) pN/um, the
        sum over the fibres at each node at rest; and what elements `describe`.
        """
        bodies = [cell.body for cell in self.cells]
        membranes = {f"{body.name}.triangles": body.membrane.triangles for body in bodies}
        if self.matrix is None:
            return membranes
        matrix = self.matrix
        total = nodal_sum(len(matrix.position), matrix.fibres, matrix.stiffness)
        membranes |= {**matrix.describe(), "matrix.stiffness": total}
        for element in self.elements:
            membranes |= element.describe()
        return membranes

    def stop_points(self) -> tuple[float, ...]:
        return tuple(sorted({t for e in self.elements for t in e.stop_points()}))

    def observe(self, t: float, x: np.ndarray) -> dict[str, np.ndarray]:
        s = self.configuration(t, x)
        out: dict[str, list[np.ndarray]] = {}
        for element in self.elements:
            for name, value in element.observe(s).items():
                out.setdefault(name, []).append(value)
        if not self._senses:
            # Nothing is sensed: a direction that only repeats p is no measurement to learn from.
            out.pop("d", None)
        read = {name: np.array(values) for name, values in out.items()}
        for element in self.elements:
            read |= element.measure(s)
        return read

    # OverdampedSystem

    @property
    def discrete(self) -> bool:
        """Whether something happens between steps, which only a stepping integrator makes."""
        return bool(self._switching)

    def drag(self) -> np.ndarray:
        return self._drag

    def internal_blocks(self) -> tuple[tuple[slice, slice], ...]:
        return self._blocks

    def forget(self) -> None:
        for element in self.elements:
            element.forget()

    def advance_internal(self, t: float, x: np.ndarray, x_new: np.ndarray, dt: float) -> None:
        s, end = self.configuration(t, x), self.configuration(t + dt, x_new)
        object.__setattr__(self, "_last", ((x, s), (x_new, end)))
        for element in self._advancing:
            element.advance(s, end, dt)

    def advance_by_middle(
        self, t: float, x: np.ndarray, middle: np.ndarray, x_new: np.ndarray, dt: float
    ) -> None:
        s, m = self.configuration(t, x), self.configuration(t + 0.5 * dt, middle)
        end = self.configuration(t + dt, x_new)
        object.__setattr__(self, "_last", ((x, s), (middle, m), (x_new, end)))
        for element in self._advancing:
            element.advance_by_middle(s, m, end, dt)

    def majorant(self, t: float, x: np.ndarray, dt: float) -> tuple[MajorantBlock, ...]:
        s = self.configuration(t, x)
        parts: dict[str, list[Stiffness]] = {array: [] for array in self._index}
        for element in self.elements:
            for item in element.stiffness(s):
                parts[item.array].append(item)
        blocks = []
        for array, items in parts.items():
            for block in combine(array, self._index[array], items, t):
                factor = self._cholesky.setdefault(block.name, SparseCholesky())
                blocks.append(block._replace(factor=factor))
        return tuple(blocks)

    def low_rank(self, t: float, x: np.ndarray) -> tuple[RankOne, ...]:
        if not self._low_rank:
            return ()
        s = self.configuration(t, x)
        return tuple(
            RankOne(self._index[array].ravel(), k, g.ravel())
            for element in self._low_rank
            for array, k, g in element.low_rank(s)
        )

    def between_steps(
        self, t: float, x: np.ndarray, dt: float, rng: np.random.Generator
    ) -> tuple[np.ndarray, tuple[Event, ...]]:
        switching = self._switching
        if not switching:
            return x, ()
        x = x.copy()
        s = self.configuration(t, x)
        events: list[Event] = []
        for element in switching:
            events.extend(element.between_steps(s, dt, rng))
        return x, tuple(events)


def _having(method: str, elements: tuple[Element, ...]) -> tuple[Element, ...]:
    """The elements that have an optional method of their own."""
    return tuple(e for e in elements if getattr(type(e), method) is not getattr(Element, method))
