"""Evaluation of the auxiliaries eta(t, x): storage first, then resistors in their own order.

A set of resistors that need each other's outputs is an algebraic loop, v = law(a + S v). S is
skew where nothing else stands between (the junctions conserve power), so monotone laws have one
solution, and the matrix I - diag(law') S of Newton's method is never singular.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp

from cellsys.bondgraph.elements import GY, TF, CField, Internal, NodalEffort, R, Se, Sf
from cellsys.bondgraph.junctions import is_modulated
from cellsys.bondgraph.outputs import Output, output_sign
from cellsys.bondgraph.quantities import dimension_of, read
from cellsys.bondgraph.structure import Structure
from cellsys.errors import CausalityError, DimensionError, IntegrationError, NotSymbolicError
from cellsys.laws.arrays import is_symbolic
from cellsys.system import Layout, is_sparse

NEWTON_STEPS = 60
_NONE = np.zeros(0)
DENSE = 500  # matrices up to this many rows are kept dense: a product then costs a microsecond


@dataclass(frozen=True, kw_only=True)
class _Memoryless:
    """A resistor or a modulated port: eta[place] = sign law(A_x x + A_eta eta + A_s s)."""

    name: str
    place: slice
    shape: tuple[int, ...]
    apply: Callable[[Any, Mapping[str, Any]], Any]
    A_x: Any
    A_eta: Any
    A_s: Any
    solvable: bool


def apply(matrix: Any, vector: Any) -> Any:
    """Matrix times a numpy vector or a CasADi one."""
    if is_symbolic(vector):
        import casadi as ca

        return ca.DM(sp.csc_matrix(matrix)) @ vector
    return matrix @ vector


def shaped(vector: Any, shape: tuple[int, ...]) -> Any:
    """A piece of a vector as a law sees it: a number, or an array of `shape` (numpy only)."""
    if isinstance(vector, np.ndarray):
        return vector.reshape(shape) if shape else vector[0]
    return vector


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
        self.storage: list[tuple[str, slice, Callable[[Any, Any, Mapping[str, Any]], Any]]] = []
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

    def sources(self, t: Any) -> Any:
        """Values of all sources at time t, (n_inputs,)."""
        if not self.structure.inputs.size:
            return _NONE
        parts = [(value(t) if callable(value) else value, shape) for value, shape in self.given]
        if any(is_symbolic(v) for v, _ in parts):
            import casadi as ca

            return ca.vertcat(*(v if is_symbolic(v) else ca.DM(np.ravel(v)) for v, _ in parts))
        flat = [np.broadcast_to(np.asarray(v, float), shape).ravel() for v, shape in parts]
        return np.concatenate(flat) if flat else np.zeros(0)

    def _value(self, output: Output) -> Any:
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

    def view(self, x: Any) -> Mapping[str, Any]:
        """States by name, each in its block's shape."""
        states: Layout = self.structure.states
        if is_symbolic(x):
            return {b.name: x[states.slice(b.name)] for b in states}
        return {b.name: shaped(x[states.slice(b.name)], b.shape) for b in states}

    def eta(self, t: Any, x: Any, s: Any) -> Any:
        """Auxiliaries at time t, state x and source values s."""
        symbolic = is_symbolic(t, x, s)
        views = self.view(x) if self.looks else {}
        eta: Any = np.zeros(self.size)
        if symbolic:
            import casadi as ca

            eta = ca.SX.zeros(self.size, 1) if not isinstance(x, ca.MX) else ca.MX.zeros(self.size)
        for name, place, law in self.storage:
            _put(eta, name, place, law(t, x, views), symbolic)
        for group, loop in self.order:
            if loop:
                if symbolic:
                    raise NotSymbolicError(
                        "this graph has an algebraic loop through "
                        f"{', '.join(m.name for m in group)}, which is solved by iteration: it "
                        "has no CasADi form; use a numeric integrator"
                    )
                self._solve(group, t, x, s, eta, views)
                continue
            m = group[0]
            if symbolic:
                v = apply(m.A_x, x) + apply(m.A_eta, eta) + apply(m.A_s, s)
            else:
                v = m.A_x @ x + m.A_eta @ eta + m.A_s @ s
            _put(eta, m.name, m.place, m.apply(shaped(v, m.shape), views), symbolic)
        return eta

    def _direct(self, o: Output, element: Any) -> Callable[[Any, Any, Mapping[str, Any]], Any]:
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
            return lambda t, x, s: element.law(*(s[n] for n in names))[which]
        piece = states.slice(self.structure.state_of[port.name])
        if element.law is None:
            return lambda t, x, s: o.constant * x[piece]
        return lambda t, x, s: element.law(shaped(x[piece], o.shape))

    def _memoryless(self, o: Output, place: slice) -> _Memoryless:
        structure = self.structure
        graph = structure.graph
        port = graph.ports[o.index]
        element = port.element
        sign = output_sign(port, o.quantity)
        seen = port.name
        solvable = True
        if is_modulated(element):
            a, b = graph.two_port_sides(element)
            seen = b.name if port == a else a.name
            direct = (
                o.quantity == "e"
                if not isinstance(element, TF)
                else ((port == a) == (o.quantity == "e"))
            )
            ratio = element.ratio
            law = (lambda v, s: ratio(s) * v) if direct else (lambda v, s: v / ratio(s))
        elif o.constant is not None:
            factor = sign * (o.constant.reshape(o.shape) if o.shape else float(o.constant[0]))

            def law(v: Any, s: Any) -> Any:
                return factor * v
        else:
            function = None
            if isinstance(element, R):
                function = element.law if o.quantity == "e" else element.inverse
                solvable = element.monotone
            if function is None:
                raise CausalityError(f"{element.name!r} has no law for what it is asked")

            def law(v: Any, s: Any) -> Any:
                return sign * function(v)

        rows = structure.inner[seen]
        A = [rows @ Y for Y in (structure.Y_x, structure.Y_eta, structure.Y_s)]
        if max(structure.states.size, self.size) <= DENSE:
            A = [a.toarray() for a in A]
        return _Memoryless(
            name=o.name,
            place=place,
            shape=o.shape,
            apply=law,
            A_x=A[0],
            A_eta=A[1],
            A_s=A[2],
            solvable=solvable,
        )

    def _solve(
        self, group: list[_Memoryless], t: Any, x: Any, s: Any, eta: np.ndarray, views: Any
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
                    np.ravel(m.apply(shaped(w[a:b], m.shape), views))
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
                time=float(t),
                state_norm=float(np.linalg.norm(x)),
                step=float(np.linalg.norm(residual)),
            )
        eta[index] = v


def _dense(matrix: Any) -> np.ndarray:
    return matrix.toarray() if is_sparse(matrix) else matrix


def _unowned(name: str) -> Callable[[Any, Any, Mapping[str, Any]], Any]:
    def missing(t: Any, x: Any, s: Mapping[str, Any]) -> Any:
        raise CausalityError(f"{name!r} was given without a law: its owner evaluates eta")

    return missing


def _put(eta: Any, name: str, place: slice, value: Any, symbolic: bool) -> None:
    """Store a law's value; DimensionError names the law whose value does not fit."""
    if symbolic:
        eta[place] = value
        return
    try:
        eta[place] = value.ravel() if isinstance(value, np.ndarray) else value
    except ValueError:
        raise DimensionError(
            f"the law of {name!r} must return {place.stop - place.start} value(s), "
            f"got shape {np.shape(value)}"
        ) from None


def _is_loop(group: list[_Memoryless]) -> bool:
    if len(group) > 1:
        return True
    m = group[0]
    own = m.A_eta[:, m.place]
    return bool(own.nnz if is_sparse(own) else np.any(own))


def _sorted(items: list[_Memoryless]) -> list[list[_Memoryless]]:
    """Strongly connected groups, each after those it needs."""
    if not items:
        return []
    needs = np.zeros((len(items), len(items)))
    for i, m in enumerate(items):
        columns = np.abs(m.A_eta).sum(axis=0)
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
