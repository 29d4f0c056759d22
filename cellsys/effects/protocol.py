"""The effect protocol: parameters that describe an effect, elements that act.

An *effect* is a frozen dataclass of parameters (unit, bounds, source in the field's metadata).
Building it gives *elements*: bond-graph elements attached to a junction array (the nodes of a
cell, of the matrix, or of an array that the effect brings along). An element's port is nodal:
eta_e is its force (n_nodes, 3), pN, so its block of W_eta is I/C and constant, whatever its inner
geometry does. Internal states have their rates as further blocks of eta.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeVar

import numpy as np
import scipy.sparse as sp

from cellsys.effects.commands import Commands
from cellsys.errors import ParameterError, SceneError
from cellsys.geometry.disc import Disc
from cellsys.geometry.membrane import Membrane
from cellsys.geometry.network import FibreNetwork
from cellsys.system import Block, Event
from cellsys.units import quantity

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

E = TypeVar("E", bound="Effect")


def parameter(
    default: str | float,
    unit: str = "1",
    *,
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
    choices: Sequence[str] | None = None,
    source: str = "",
    about: str = "",
    once: str = "",
    elsewhere: Mapping[str, str | None] | None = None,
    refused: Mapping[str, Mapping[str, str]] | None = None,
) -> Any:
    """A dataclass field with unit, bounds, source and meaning in its metadata.

    `default` is a quantity string ("500 pN/um"), one of the ``choices``, or a bool. Scene files
    may also call the parameter by the name it had `once`. `elsewhere` are the defaults in scene
    files with other kinds of matrix, by kind; None: the parameter has no meaning there. `refused`
    are choices that have none, by kind, each with the reason.
    """
    plain = choices is not None or isinstance(default, bool)
    value = default if plain else quantity(default, unit, name="default")
    return field(
        default=value,
        metadata={
            "unit": unit,
            "above": above,
            "least": least,
            "most": most,
            "choices": tuple(choices) if choices is not None else None,
            "flag": isinstance(default, bool),
            "source": source,
            "about": about,
            "once": once,
            "refused": {kind: dict(choice) for kind, choice in (refused or {}).items()},
            "elsewhere": {
                kind: None if other is None else quantity(other, unit, name="elsewhere")
                for kind, other in (elsewhere or {}).items()
            },
        },
    )


def check_parameters(effect: DataclassInstance) -> None:
    """Compare every field with its bounds; ParameterError names the value and the bound."""
    owner = getattr(effect, "name", type(effect).__name__)
    for item in dataclasses.fields(effect):
        meta, value = item.metadata, getattr(effect, item.name)
        if "unit" not in meta:
            continue
        label = f"{owner}.{item.name}"
        if meta["choices"] is not None:
            if value not in meta["choices"]:
                raise ParameterError(
                    f"{label} must be one of {', '.join(meta['choices'])}, got {value!r}"
                )
            continue
        if meta["flag"]:
            if not isinstance(value, bool):
                raise ParameterError(f"{label} must be true or false, got {value!r}")
            continue
        unit = "" if meta["unit"] == "1" else f" {meta['unit']}"
        if isinstance(value, bool) or not isinstance(value, (int, float, np.floating)):
            raise ParameterError(
                f"{label} must be a number in{unit or ' plain units'}, got {value!r}"
            )
        if not np.isfinite(value):
            raise ParameterError(f"{label} must be finite, got {value!r}")
        for word, bound, wrong in (
            (">", meta["above"], meta["above"] is not None and not value > meta["above"]),
            (">=", meta["least"], meta["least"] is not None and value < meta["least"]),
            ("<=", meta["most"], meta["most"] is not None and value > meta["most"]),
        ):
            if wrong:
                raise ParameterError(f"{label} must be {word} {bound:g}{unit}, got {value!r}")


@dataclass(frozen=True)
class Effect:
    """Base of all effects: parameters only.

    Class attributes
    ----------------
    name : str
        Key in a scene file.
    needs : tuple of str
        Other effects without which this one has no meaning; "a|b" asks for one of the two.
    excludes : mapping of str to str
        Effects that contradict this one, each with the rule it would break.
    not_on : mapping of str to str
        Kinds of matrix on which the effect has no meaning, each with the reason.
    acts_on : {"cell", "matrix", "cells", "scene"}
        Whether elements are built per cell, once for the matrix, once for all cells, or once
        for all node arrays after everything else.
    replaces : tuple of str
        Constants that this effect takes over; "drag.cortex" is the only one.
    active : bool
        Whether it can feed energy into the nodes. A passive one only stores and dissipates it.
    steers : bool
        Whether the cell needs a polarity.
    """

    name: ClassVar[str] = ""
    needs: ClassVar[tuple[str, ...]] = ()
    excludes: ClassVar[Mapping[str, str]] = MappingProxyType({})
    not_on: ClassVar[Mapping[str, str]] = MappingProxyType({})
    acts_on: ClassVar[str] = "cell"
    replaces: ClassVar[tuple[str, ...]] = ()
    active: ClassVar[bool] = False
    steers: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_parameters(self)

    @property
    def outside_work(self) -> str:
        """Who takes up the forces that this effect leaves unbalanced; "" when it balances them.

        What a balanced effect gives one node array it takes from the same array or from another:
        its efforts, of ports and of inputs, sum to zero over all arrays of places.
        """
        return ""

    @property
    def requires(self) -> tuple[str, ...]:
        """`needs` with what these parameters ask for besides."""
        return self.needs

    def refusal(self, kind: str) -> str | None:
        """Why these parameters have no meaning on a kind of matrix; None where they have one."""
        if kind in self.not_on:
            return self.not_on[kind]
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            if value in item.metadata.get("refused", {}).get(kind, ()):
                return f"{item.name} = {value!r} {item.metadata['refused'][kind][value]}"
            if value != item.default and item.metadata.get("elsewhere", {}).get(kind, 0) is None:
                return f"{item.name} is set and means nothing there; leave it out"
        return None

    def arrays(self, site: Site) -> tuple[JunctionArray, ...]:
        """Node arrays that this effect adds at one site."""
        return ()

    def elements(self, site: Site) -> tuple[Element, ...]:
        """The bond-graph elements of this effect at one site."""
        return ()


@dataclass(frozen=True, kw_only=True)
class Site:
    """Where an effect is built: a cell (or None) on a matrix (or None).

    `body`, `network` and `disc` are the cell, the matrix and a flat matrix of a site that must
    have them. `cells` and `arrays` hold all bodies and node arrays of the scene, `built` the
    elements that stand already: the matrix before the cells, the cells one after the other.
    """

    cell: CellBody | None
    matrix: FibreNetwork | None
    commands: Commands | None
    effects: dict[str, Effect]
    cells: tuple[CellBody, ...] = ()
    arrays: tuple[JunctionArray, ...] = ()
    built: tuple[Element, ...] = ()

    @property
    def body(self) -> CellBody:
        """The site's cell; SceneError where there is none."""
        if self.cell is None:
            raise SceneError("this effect is built at a cell; give it acts_on = 'cell'")
        return self.cell

    @property
    def network(self) -> FibreNetwork:
        """The site's matrix; SceneError where there is none."""
        if self.matrix is None:
            raise SceneError("this effect needs a matrix; add [matrix] to the scene")
        return self.matrix

    @property
    def disc(self) -> Disc:
        """The site's matrix, a flat one; SceneError where there is none."""
        if not isinstance(self.network, Disc):
            raise SceneError(
                f"this effect needs a flat matrix under the cells, and the scene has a "
                f"{type(self.network).__name__}; leave the effect out"
            )
        return self.network

    @property
    def commanded(self) -> Commands:
        """Commands of the site's cell; empty ones where nothing is commanded."""
        return Commands() if self.commands is None else self.commands

    def find(self, kind: type[E]) -> E | None:
        """The effect of this class, if the site has one."""
        return next((e for e in self.effects.values() if isinstance(e, kind)), None)


@dataclass(frozen=True)
class CellBody:
    """One cell: its name, membrane and initial polarity (unit vector)."""

    name: str
    membrane: Membrane
    polarity: np.ndarray


class JunctionArray(NamedTuple):
    """Nodes that share a junction: name, position block (n, 3), start (n, 3), drag (n, 3).

    Drag in pN s/um; inf holds a node in place.
    """

    name: str
    block: Block
    start: np.ndarray
    drag: np.ndarray


class Held(NamedTuple):
    """Nodes (bool mask) of an array whose motion an element prescribes (a flow source Sf)."""

    array: str
    nodes: np.ndarray


class Port(NamedTuple):
    """A nodal port: element forces on junction array `array`, stored as eta block `block`.

    Elements that name the same block share it: each adds to what is there.
    """

    array: str
    block: str


class Stiffness(NamedTuple):
    """An over-estimate of -dF/dx on one array.

    `matrix()` gives (n, n), acting alike on each coordinate in `axes`, or (3 n, 3 n) when `axes`
    is empty: coordinates coupled. It is called only when `key` has changed; key None always has.
    """

    array: str
    axes: tuple[int, ...]
    matrix: Callable[[], sp.csc_array]
    key: object


class Configuration:
    """Views into one state vector: node arrays, internal states, time."""

    __slots__ = ("cache", "internal", "nodes", "t")

    def __init__(self, t: float, nodes: dict, internal: dict) -> None:
        self.t, self.nodes, self.internal = t, nodes, internal
        self.cache: dict[str, Any] = {}


class Element:
    """A bond-graph element with nodal ports; every method but `efforts` is optional."""

    name: str
    outside: str = ""  # who takes up what its forces leave unbalanced, as `Effect.outside_work`
    ports: tuple[Port, ...] = ()
    inputs: tuple[Port, ...] = ()  # forces that enter u instead of eta
    commanded: tuple[Block, ...] = ()  # what is behind those forces, by name
    holds: tuple[Held, ...] = ()
    internal: tuple[Block, ...] = ()

    def connect(self, built: Sequence[Element]) -> None:
        """Find the elements that this one acts through, once all of a scene are built."""

    def balance(self, s: Configuration, others: Sequence[Element]) -> str:
        """Hold what `others` within the cell pull at the start `s`; the name of that cell.

        A cell that is named then moves to where its forces on itself vanish
        (`cellsys.mechanics.rest`); "" asks for nothing.
        """
        return ""

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        """Write the force of each port (n_nodes, 3), pN, into `out` (already zero)."""

    def force(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        """Write the exogenous force of each input port, pN, into `out` (already zero)."""

    def flows(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        """Write the velocity of the held nodes of each `holds`, um/s, into `out` (n_nodes, 3)."""

    def place(self, t: float) -> tuple[np.ndarray, ...]:
        """Where the held nodes of each `holds` are at time t, (held nodes, 3) um."""
        return ()

    def energy(self, s: Configuration) -> float:
        """Stored energy, pN um, whose negative gradient the efforts are."""
        raise ParameterError(f"{self.name} is not the gradient of an energy; ask those that are")

    def rates(self, s: Configuration, v: dict[str, np.ndarray], out: tuple) -> None:
        """Rates of the internal states, given node velocities v, um/s."""

    def advance(self, s: Configuration, end: Configuration, dt: float) -> None:
        """Fill this element's internal states of `end` after dt, given both geometries."""

    def advance_by_middle(
        self, s: Configuration, middle: Configuration, end: Configuration, dt: float
    ) -> None:
        """Like `advance` to second order, given what is foreseen of half a step on.

        By default Richardson's extrapolation of `advance`: twice what two halves give, less what
        the whole step gives. What switches or jumps stays as both have it.
        """
        self.advance(s, end, dt)
        whole = [end.internal[block.name].copy() for block in self.internal]
        self.advance(s, middle, 0.5 * dt)
        self.advance(middle, end, 0.5 * dt)
        for block, once in zip(self.internal, whole, strict=True):
            found = end.internal[block.name]
            found += found - once

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        """Over-estimates of the tangent; () for a soft element."""
        return ()

    def low_rank(self, s: Configuration) -> tuple[tuple[str, float, np.ndarray], ...]:
        """Stiff directions (array, stiffness pN/um, direction (n, 3))."""
        return ()

    def between_steps(
        self, s: Configuration, dt: float, rng: np.random.Generator
    ) -> tuple[Event, ...]:
        """Discrete changes of the internal states of `s`, in place."""
        return ()

    def observe(self, s: Configuration) -> dict[str, np.ndarray]:
        """Read-outs of one cell stored with each sample: ``p``, ``d`` (3,), ``amplitude``."""
        return {}

    def sensed(self, s: Configuration) -> np.ndarray | None:
        """Direction (3,) that the element senses; None where it senses nothing."""
        return None

    def measure(self, s: Configuration) -> dict[str, np.ndarray]:
        """Nodal measures stored with each sample, such as ``virial`` (n_nodes,)."""
        return {}

    def describe(self) -> dict[str, np.ndarray]:
        """Constants that a run of the scene keeps in its ``geometry``."""
        return {}

    def initial(self, block: Block) -> np.ndarray:
        """Initial value of an internal state; zeros by default."""
        return np.zeros(block.shape)

    def forget(self) -> None:
        """Drop everything kept from earlier looks at the tangent."""

    def stop_points(self) -> tuple[float, ...]:
        """Times (s) at which the law jumps or has a kink."""
        return ()
