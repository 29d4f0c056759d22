"""`JunctionGraph`: elements by name, joined by name; what a graph is before its equations."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, TypeGuard, TypeVar

import numpy as np
import scipy.sparse as sp

from cellsys.arguments import checked
from cellsys.bondgraph.elements import (
    GY,
    JUNCTIONS,
    TF,
    TWO_PORTS,
    BondElement,
    CField,
    Internal,
    One,
    Ratio,
    Zero,
)
from cellsys.bondgraph.quantities import DOMAINS
from cellsys.errors import CausalityError, ParameterError
from cellsys.system import is_sparse

_T = TypeVar("_T")


@checked
class Bond(NamedTuple):
    """A power bond; positive power flows from tail to head."""

    name: str
    tail: str
    tail_port: str
    head: str
    head_port: str

    @property
    def ends(self) -> tuple[tuple[str, str], tuple[str, str]]:
        """((element, port), (element, port)) of tail and head."""
        return (self.tail, self.tail_port), (self.head, self.head_port)


class BondPort(NamedTuple):
    """An element's end of a bond; `sign` is +1 where the bond points into the element."""

    element: BondElement
    port: str
    bond: int
    sign: int

    @property
    def name(self) -> str:
        """``element`` or ``element.port``."""
        return f"{self.element.name}.{self.port}" if self.port else self.element.name


@checked
@dataclass(frozen=True, eq=False)
class JunctionGraph:
    """Elements, bonds and the structure that they make (thesis Table 1).

    Parameters and errors are those of `BondGraph`.
    """

    elements: Sequence[BondElement]
    bonds: Sequence[str]
    units: str = field(default="cell", kw_only=True)
    separate: bool = field(default=False, kw_only=True)
    name: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "elements", tuple(self.elements))
        object.__setattr__(self, "bonds", tuple(self.bonds))
        if self.units not in ("cell", "si"):
            raise ParameterError(f"BondGraph.units must be 'cell' or 'si', got {self.units!r}")
        seen: set[str] = set()
        for element in self.elements:
            if element.name in seen:
                raise ParameterError(f"element name {element.name!r} is given twice")
            seen.add(element.name)
            domain = getattr(element, "domain", None)
            if domain is not None and domain not in DOMAINS:
                raise ParameterError(
                    f"junction {element.name!r}: domain must be one of {', '.join(DOMAINS)}, "
                    f"got {domain!r}"
                )
        self._check_ends()
        if not self.separate:
            self._check_connected()
        _ = self.shapes

    @cached_property
    def by_name(self) -> dict[str, BondElement]:
        """Elements by name."""
        return {e.name: e for e in self.elements}

    @cached_property
    def joined(self) -> tuple[Bond, ...]:
        """All bonds, in the order written."""
        out: list[Bond] = []
        names: set[str] = set()
        for text in self.bonds:
            parts = [part.strip() for part in text.split("->")]
            if len(parts) < 2:
                raise ParameterError(f"bond {text!r} needs two ends, as in 'mass -> junction'")
            for tail, head in itertools.pairwise(parts):
                name = f"{tail}->{head}"
                count = 2
                while name in names:
                    name, count = f"{tail}->{head}#{count}", count + 1
                names.add(name)
                out.append(Bond(name, *self._end(tail, "out"), *self._end(head, "in")))
        return tuple(out)

    def _end(self, text: str, side: str) -> tuple[str, str]:
        element, port = self.by_name.get(text), ""
        if element is None and "." in text:
            head, port = text.rsplit(".", 1)
            element = self.by_name.get(head)
            ends = getattr(element, "ends", ())
            if element is not None and port not in ends:
                raise ParameterError(
                    f"{head!r} has no end {port!r}; its ends: {', '.join(ends) or 'none'}"
                )
        if element is None:
            raise ParameterError(f"no element {text!r}; known: {', '.join(self.by_name)}")
        if isinstance(element, Internal):
            raise ParameterError(f"{text!r} is an internal state: no bond ends on it")
        if isinstance(element, CField) and not port:
            raise ParameterError(f"name an end of {text!r}: {', '.join(element.ends)}")
        if isinstance(element, TWO_PORTS):
            port = side
        return element.name, port

    def _check_ends(self) -> None:
        used: dict[tuple[str, str], list[str]] = {}
        for bond in self.joined:
            for end in bond.ends:
                used.setdefault(end, []).append(bond.name)
        for element in self.elements:
            if isinstance(element, JUNCTIONS):
                count = len(used.get((element.name, ""), ()))
                alone = getattr(element, "position", None) is not None
                if count < (1 if alone else 2):
                    raise CausalityError(
                        f"junction {element.name!r} has {count} bond(s): a port is left open; "
                        "a junction joins at least two"
                    )
                continue
            ports = ("in", "out") if isinstance(element, TWO_PORTS) else element.ports
            for port in getattr(element, "ends", ports):
                bonds = used.get((element.name, port), [])
                label = f"{element.name}.{port}" if port else element.name
                if not bonds:
                    raise CausalityError(f"port {label!r} is left open: join it with a bond")
                if len(bonds) > 1:
                    raise CausalityError(
                        f"port {label!r} has {len(bonds)} bonds ({', '.join(bonds)}); "
                        "put a junction between"
                    )

    def _check_connected(self) -> None:
        parts = self.parts()
        if len(parts) > 1:
            listed = "; ".join("{" + ", ".join(p) + "}" for p in parts)
            raise CausalityError(
                f"the graph falls into {len(parts)} disconnected parts: {listed}; "
                "join them, or pass separate=True"
            )

    def parts(self) -> list[list[str]]:
        """Names of the elements of each connected part."""
        names = [e.name for e in self.elements if not isinstance(e, Internal)]
        index = {name: i for i, name in enumerate(names)}
        rows = [index[b.tail] for b in self.joined]
        cols = [index[b.head] for b in self.joined]
        graph = sp.csr_array((np.ones(len(rows)), (rows, cols)), (len(names), len(names)))
        count, label = sp.csgraph.connected_components(graph, directed=False)
        return [[n for n, k in zip(names, label, strict=True) if k == i] for i in range(count)]

    @cached_property
    def junction_bonds(self) -> dict[str, list[tuple[int, int]]]:
        """(bond index, +1 where the bond points into the junction) of every junction."""
        out: dict[str, list[tuple[int, int]]] = {
            e.name: [] for e in self.elements if isinstance(e, JUNCTIONS)
        }
        for i, bond in enumerate(self.joined):
            if bond.tail in out:
                out[bond.tail].append((i, -1))
            if bond.head in out:
                out[bond.head].append((i, 1))
        return out

    @cached_property
    def ports(self) -> tuple[BondPort, ...]:
        """Ports of all elements that are not junctions, in the order of the elements."""
        found: dict[tuple[str, str], tuple[int, int]] = {}
        for i, bond in enumerate(self.joined):
            found[bond.ends[0]], found[bond.ends[1]] = (i, -1), (i, 1)
        out = []
        for element in self.elements:
            if isinstance(element, JUNCTIONS):
                continue
            ports = ("in", "out") if isinstance(element, TWO_PORTS) else element.ports
            for port in getattr(element, "ends", ports):
                out.append(BondPort(element, port, *found[(element.name, port)]))
        return tuple(out)

    @cached_property
    def shapes(self) -> tuple[tuple[int, ...], ...]:
        """Shape of every bond, from the junction it touches (or the far side of a TF, GY)."""
        scalar: tuple[int, ...] = ()
        return tuple(tuple(s) for s in self._spread("shape", lambda j: j.shape, scalar))

    @cached_property
    def domains(self) -> tuple[str | None, ...]:
        """Domain of every bond, or None."""
        return tuple(self._spread("domain", lambda j: j.domain, None))

    def _spread(self, attribute: str, of: Callable[[Zero | One], _T], default: _T) -> list[_T]:
        """An attribute of every bond, from the junctions it touches."""
        out: list[_T] = []
        for bond in self.joined:
            ends = [self.by_name[n] for n in (bond.tail, bond.head)]
            found = [of(end) for end in ends if isinstance(end, (Zero, One))]
            if len(found) == 2 and found[0] != found[1]:
                if attribute == "shape" or None not in found:
                    raise ParameterError(
                        f"bond {bond.name!r} joins junctions of different {attribute}: "
                        f"{found[0]} and {found[1]}; put a TF between"
                    )
                found = [next(v for v in found if v is not None)]
            out.append(found[0] if found else default)
        return out

    def two_port_sides(self, element: BondElement) -> tuple[BondPort, BondPort]:
        """Ports ``in`` and ``out`` of a TF or GY."""
        inner, outer = (p for p in self.ports if p.element is element)
        return inner, outer


def modulation(element: BondElement) -> Ratio | None:
    """The ratio of a TF or GY that depends on the state; None for any other element."""
    ratio = element.ratio if isinstance(element, (TF, GY)) else None
    return ratio if callable(ratio) else None


def is_modulated(element: BondElement) -> TypeGuard[TF | GY]:
    """Whether a TF or GY has a ratio that depends on the state."""
    return modulation(element) is not None


def is_matrix(element: BondElement) -> TypeGuard[TF]:
    """Whether a TF has a constant matrix for its ratio."""
    ratio = element.ratio if isinstance(element, (TF, GY)) else None
    return is_sparse(ratio) or (isinstance(ratio, np.ndarray) and ratio.ndim == 2)


def matrix_of(element: TF) -> sp.csr_array:
    """The constant matrix of a TF."""
    ratio = element.ratio
    if is_sparse(ratio) or isinstance(ratio, np.ndarray):
        return sp.csr_array(ratio)
    raise ParameterError(f"TF {element.name!r} has no matrix for its ratio, got {ratio!r}")
