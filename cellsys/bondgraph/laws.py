"""Evaluation of the auxiliaries eta(t, x): storage first, then resistors in their own order.

A set of resistors that need each other's outputs is an algebraic loop, v = law(a + S v). S is
skew where nothing else stands between (the junctions conserve power), so monotone laws have one
solution, and the matrix I - diag(law') S of Newton's method is never singular.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, overload

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp

from cellsys.bondgraph.elements import (
    GY,
    TF,
    BondElement,
    C,
    CField,
    I,
    Internal,
    Law,
    NodalEffort,
    R,
    Ratio,
    Se,
    Sf,
)
from cellsys.bondgraph.expressions import (
    Expression,
    Matrix,
    Numbers,
    States,
    Symbol,
    Vector,
    apply,
    column,
    numbers,
    shaped,
)
from cellsys.bondgraph.junctions import is_modulated, modulation
from cellsys.bondgraph.outputs import Output, constants_of, output_sign
from cellsys.bondgraph.quantities import dimension_of, read
from cellsys.bondgraph.structure import Structure
from cellsys.errors import CausalityError, DimensionError, IntegrationError, NotSymbolicError
from cellsys.laws.arrays import is_symbolic
from cellsys.system import Layout

if TYPE_CHECKING:
    import casadi as ca

# Of time, state and the states by name: what depends on no other auxiliary.
DirectLaw = Callable[[float | Symbol, Vector, States], Expression]
NEWTON_STEPS = 60
_NONE = np.zeros(0)
DENSE = 500  # matrices up to this many rows are kept dense: a product then costs a microsecond


@dataclass(frozen=True, kw_only=True)
class _Memoryless:
    """A resistor or a modulated port: eta[place] = sign law(A_x x + A_eta eta + A_s s)."""

    name: str
    place: slice
    shape: tuple[int, ...]
    apply: Callable[[Expression, States], Expression]
    A_x: Matrix
    A_eta: Matrix
    A_s: Matrix
    solvable: bool


class Laws:
    """eta(t, x) of a structure; also with given source values, for linearisation."""

    def __init__(self, structure: Structure) -> None:
        self.structure = structure
        graph = structure.graph
        self.given = [(self._value(o), o.shape) for o in structure.outputs if o.kind == "source"]
        kept = [o for o in structure.outputs if o.kind in ("law", "rate")]
        self.places = {}
        start = 0
        for o in kept:
            n = o.place.stop - o.place.start
            self.places[o.name] = slice(start, start + n)
            start += n
        self.size = start
        self.storage: list[tuple[str, slice, DirectLaw]] = []
        memoryless: list[_Memoryless] = []
        for o in kept:
            place = self.places[o.name]
            element = graph.by_name[o.name] if o.kind == "rate" else graph.ports[o.index].element
            if isinstance(element, R) or is_modulated(element):
                memoryless.append(self._memoryless(o, place))
            else:
                self.storage.append((o.name, place, self._direct(o, element)))
        groups = _sorted(memoryless)
        self.order = [(group, _is_loop(group)) for group in groups]
        self.looks = any(  # whether a law asks for states by name
            o.kind == "rate"
            or isinstance(graph.ports[o.index].element, (CField, NodalEffort, TF, GY))
            for o in kept
        )
        for group in groups:
            blocking = [m.name for m in group if not m.solvable]
            if len(group) > 1 and blocking:
                raise CausalityError(
                    f"algebraic loop through {', '.join(repr(m.name) for m in group)}: solvable "
                    f"only if the laws increase; promise it by R(..., monotone=True) for "
                    f"{', '.join(blocking)}, or put a storage between"
                )
        self.loops = tuple(tuple(m.name for m in g) for g, loop in self.order if loop)

    @overload
    def sources(self, t: float) -> np.ndarray: ...

    @overload
    def sources(self, t: float | Symbol) -> Vector: ...

    def sources(self, t: float | Symbol) -> Vector:
        """Values of all sources at time t, (n_inputs,)."""
        if not self.structure.inputs.size:
            return _NONE
        parts = [(value(t) if callable(value) else value, shape) for value, shape in self.given]
        if any(is_symbolic(v) for v, _ in parts):
            return column([v for v, _ in parts])
        flat = [np.broadcast_to(numbers(v), shape).ravel() for v, shape in parts]
        return np.concatenate(flat) if flat else np.zeros(0)

    def _value(self, output: Output) -> Numbers | Law:
        """A source's function of time, or its number in the graph's units."""
        graph = self.structure.graph
        port = graph.ports[output.index]
        source = port.element
        if not isinstance(source, (Se, Sf)):
            raise CausalityError(f"{output.name!r} is no source")
        if callable(source.value):
            return source.value
        quantity = "effort" if output.quantity == "e" else "flow"
        expected = dimension_of(quantity, graph.domains[port.bond])
        return read(source.value, expected, graph.units, f"source {output.name!r}")

    def view(self, x: Vector) -> States:
        """States by name, each in its block's shape."""
        states: Layout = self.structure.states
        if not isinstance(x, np.ndarray):
            return {b.name: x[states.slice(b.name)] for b in states}
        return {b.name: shaped(x[states.slice(b.name)], b.shape) for b in states}

    @overload
    def eta(self, t: float, x: np.ndarray, s: np.ndarray) -> np.ndarray: ...

    @overload
    def eta(self, t: float, x: ca.SX, s: ca.SX) -> ca.SX: ...

    @overload
    def eta(self, t: float | Symbol, x: Vector, s: Vector) -> Vector: ...

    def eta(self, t: float | Symbol, x: Vector, s: Vector) -> Vector:
        """Auxiliaries at time t, state x and source values s."""
        symbolic = is_symbolic(t, x, s)
        views = self.view(x) if self.looks else {}
        eta: Vector = np.zeros(self.size)
        if symbolic:
            import casadi as ca

            eta = ca.SX.zeros(self.size, 1) if not isinstance(x, ca.MX) else ca.MX.zeros(self.size)
        for name, place, law in self.storage:
            _put(eta, name, place, law(t, x, views))
        for group, loop in self.order:
            if loop:
                if symbolic:
                    raise NotSymbolicError(
                        "this graph has an algebraic loop through "
                        f"{', '.join(m.name for m in group)}, which is solved by iteration: it "
                        "has no CasADi form; use a numeric integrator"
                    )
                self._solve(group, t, numbers(x), numbers(s), numbers(eta), views)
                continue
            m = group[0]
            v = apply(m.A_x, x) + apply(m.A_eta, eta) + apply(m.A_s, s)
            _put(eta, m.name, m.place, m.apply(shaped(v, m.shape), views))
        return eta

    def _direct(self, o: Output, element: BondElement) -> DirectLaw:
        """Law of a storage or nodal effort: a function of the state alone."""
        graph, states = self.structure.graph, self.structure.states
        if isinstance(element, (NodalEffort, Internal)):
            law = element.law if isinstance(element, NodalEffort) else element.rate
            if law is None:
                return _unowned(o.name)
            return lambda t, x, s: law(t, s)
        port = graph.ports[o.index]
        if isinstance(element, CField):
            names = [self.structure.state_of[f"{element.name}.{end}"] for end in element.ends]
            which = element.ends.index(port.port)
            many = element.law
            return lambda t, x, s: many(*(s[n] for n in names))[which]
        if not isinstance(element, (C, I)):
            raise CausalityError(f"{element.name!r} has no law of the state")
        piece, own = states.slice(self.structure.state_of[port.name]), element.law
        if own is None:
            factor = constants_of(o)
            return lambda t, x, s: factor * x[piece]
        return lambda t, x, s: own(shaped(x[piece], o.shape))

    def _memoryless(self, o: Output, place: slice) -> _Memoryless:
        structure = self.structure
        graph = structure.graph
        port = graph.ports[o.index]
        element = port.element
        sign = output_sign(port, o.quantity)
        seen = port.name
        solvable = True
        ratio = modulation(element)
        law: Callable[[Expression, States], Expression]
        if ratio is not None:
            a, b = graph.two_port_sides(element)
            seen = b.name if port == a else a.name
            direct = (
                o.quantity == "e"
                if not isinstance(element, TF)
                else ((port == a) == (o.quantity == "e"))
            )
            law = _modulated(ratio, direct)
        elif o.constant is not None:
            factor = sign * (o.constant.reshape(o.shape) if o.shape else float(o.constant[0]))
            law = _linear(factor)
        else:
            function = None
            if isinstance(element, R):
                function = element.law if o.quantity == "e" else element.inverse
                solvable = element.monotone
            if function is None:
                raise CausalityError(f"{element.name!r} has no law for what it is asked")
            law = _signed(function, sign)

        rows = structure.inner[seen]
        small = max(structure.states.size, self.size) <= DENSE

        def seen_of(Y: sp.csr_array) -> Matrix:
            A = sp.csr_array(rows @ Y)
            return A.toarray() if small else A

        A_x, A_eta, A_s = (seen_of(Y) for Y in (structure.Y_x, structure.Y_eta, structure.Y_s))
        return _Memoryless(
            name=o.name,
            place=place,
            shape=o.shape,
            apply=law,
            A_x=A_x,
            A_eta=A_eta,
            A_s=A_s,
            solvable=solvable,
        )

    def _solve(
        self,
        group: list[_Memoryless],
        t: float | Symbol,
        x: np.ndarray,
        s: np.ndarray,
        eta: np.ndarray,
        views: States,
    ) -> None:
        """Damped Newton on v - law(a + S v) = 0, to rounding."""
        index = np.concatenate([np.arange(m.place.start, m.place.stop) for m in group])
        edges = np.cumsum([0, *(m.place.stop - m.place.start for m in group)])
        cuts = list(itertools.pairwise(edges))
        eta[index] = 0.0
        base = [m.A_x @ x + m.A_eta @ eta + m.A_s @ s for m in group]
        S = np.vstack([_dense(m.A_eta)[:, index] for m in group])

        def laws(w: np.ndarray) -> np.ndarray:
            return np.concatenate(
                [
                    numbers(m.apply(shaped(w[a:b], m.shape), views)).ravel()
                    for m, (a, b) in zip(group, cuts, strict=True)
                ]
            )

        a0 = np.concatenate(base)
        v = np.zeros(index.size)
        residual = v - laws(a0 + S @ v)
        for _ in range(NEWTON_STEPS):
            w = a0 + S @ v
            h = 1e-6 * (1.0 + np.abs(w))
            slope = (laws(w + h) - laws(w - h)) / (2.0 * h)
            step = sla.solve(np.eye(index.size) - slope[:, None] * S, -residual)
            size, damp = float(np.linalg.norm(residual)), 1.0
            while True:
                trial = v + damp * step
                after = trial - laws(a0 + S @ trial)
                if float(np.linalg.norm(after)) < size or damp < 1e-6:
                    break
                damp *= 0.5
            if not float(np.linalg.norm(after)) < size:
                break
            v, residual = trial, after
        scale = 1.0 + float(np.linalg.norm(v)) + float(np.linalg.norm(a0))
        if not float(np.linalg.norm(residual)) <= 1e-9 * scale:
            raise IntegrationError(
                f"algebraic loop through {', '.join(m.name for m in group)} was not solved",
                time=float(numbers(t)),
                state_norm=float(np.linalg.norm(x)),
                step=float(np.linalg.norm(residual)),
            )
        eta[index] = v


def _dense(matrix: Matrix) -> np.ndarray:
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


def _modulated(ratio: Ratio, direct: bool) -> Callable[[Expression, States], Expression]:
    return (lambda v, s: ratio(s) * v) if direct else (lambda v, s: v / ratio(s))


def _linear(factor: float | np.ndarray) -> Callable[[Expression, States], Expression]:
    return lambda v, s: factor * v


def _signed(function: Law, sign: int) -> Callable[[Expression, States], Expression]:
    return lambda v, s: sign * function(v)


def _unowned(name: str) -> DirectLaw:
    def missing(t: float | Symbol, x: Vector, s: States) -> Expression:
        raise CausalityError(f"{name!r} was given without a law: its owner evaluates eta")

    return missing


def _put(eta: Vector, name: str, place: slice, value: Expression) -> None:
    """Store a law's value; DimensionError names the law whose value does not fit."""
    if not isinstance(eta, np.ndarray):
        eta[place] = value
        return
    try:
        eta[place] = value.ravel() if isinstance(value, np.ndarray) else value
    except ValueError:
        raise DimensionError(
            f"the law of {name!r} must return {place.stop - place.start} value(s), "
            f"got shape {np.asarray(value).shape}"
        ) from None


def _is_loop(group: list[_Memoryless]) -> bool:
    if len(group) > 1:
        return True
    m = group[0]
    own = m.A_eta[:, m.place]
    return bool(np.any(own) if isinstance(own, np.ndarray) else own.nnz)


def _sorted(items: list[_Memoryless]) -> list[list[_Memoryless]]:
    """Strongly connected groups, each after those it needs."""
    if not items:
        return []
    needs = np.zeros((len(items), len(items)))
    for i, m in enumerate(items):
        A = m.A_eta
        columns = np.abs(A).sum(axis=0) if isinstance(A, np.ndarray) else abs(A).sum(axis=0)
        for j, other in enumerate(items):
            needs[i, j] = np.any(columns[other.place])
    count, label = sp.csgraph.connected_components(sp.csr_array(needs), connection="strong")
    waiting = {g: {label[j] for i, j in np.argwhere(needs) if label[i] == g} - {g} for g in
               range(count)}  # fmt: skip
    order: list[list[_Memoryless]] = []
    done: set[int] = set()
    while len(done) < count:
        ready = [g for g in range(count) if g not in done and waiting[g] <= done]
        for g in ready:
            order.append([m for m, k in zip(items, label, strict=True) if k == g])
            done.add(g)
    return order
