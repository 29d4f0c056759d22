"""Steering: lamellipodium, polarity, stiffness sensing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, cast

import numpy as np

from cellsys.effects.commands import Commands, History
from cellsys.effects.matrix import MATRIX, FibreElement
from cellsys.effects.protocol import CellBody, Configuration, Effect, Element, Port, Site, parameter
from cellsys.effects.push import CommandedPush, ProtrusionLaw
from cellsys.errors import SceneError
from cellsys.laws.lamellipodium import protrusion
from cellsys.laws.polarity import exact_step, rate
from cellsys.laws.sensing import (
    contrast,
    fibre_ends,
    graded,
    measure_moment,
    nodal_mean,
    stiffest_direction,
    stress_direction,
    tensile_virial,
)
from cellsys.system import Block


@dataclass(frozen=True, kw_only=True)
class Lamellipodium(ProtrusionLaw):
    """Protrusion of the leading sector [thesis 4.4, eq. 68-70].

    ``reaction = "none"``: an exogenous force, as in the thesis's tables: nothing takes up what
    pushes the cell, which then drags its matrix forward.
    ``reaction = "clutch"``: a leading node pushes itself off the clutches around it, and they
    carry the reaction into the matrix [notes: mechanics, reaction of the lamellipodium].
    """

    name: ClassVar[str] = "lamellipodium"
    active: ClassVar[bool] = True
    steers: ClassVar[bool] = True
    not_on: ClassVar[dict[str, str]] = {
        "chain": "a crawler has no motor, it is driven by the springs it takes up again"
    }
    force: float = parameter(
        "600 pN",
        "pN",
        least=0.0,
        source="working set [notes: mechanics, lamellipodium]",
        about="force of a leading node",
    )
    height: float = parameter(
        "2.5 um",
        "um",
        above=0.0,
        source="working set [notes: mechanics, lamellipodium]",
        about="height at which it vanishes",
        elsewhere={"gel": None},
    )
    edge: float = parameter(
        "0.1",
        least=-1.0,
        most=1.0,
        source="working set [notes: mechanics, lamellipodium]",
        about="cosine where the sector starts",
    )
    full: float = parameter(
        "0.5",
        least=-1.0,
        most=1.0,
        source="working set [notes: mechanics, lamellipodium]",
        about="cosine of full force",
    )
    downward: float = parameter(
        "0.3",
        least=0.0,
        source="assumed [notes: mechanics, lamellipodium]",
        about="downward part of the direction",
        elsewhere={"gel": None},
    )
    reaction: str = parameter(
        "none",
        choices=("none", "clutch"),
        refused={"gel": {"clutch": "balances couples about the normal of a disc; take 'none'"}},
        source="thesis, table of sources [notes: mechanics, reaction of the lamellipodium]",
        about="what takes up the protrusion's reaction",
    )
    range: float = parameter(
        "6 um",
        "um",
        above=0.0,
        source="chosen here [notes: mechanics, reaction of the lamellipodium]",
        about="how far from a leading node its clutches lie",
    )
    half: float = parameter(
        "0.5",
        above=0.0,
        source="chosen here [notes: mechanics, reaction of the lamellipodium]",
        about="clutches that engage half of the force",
    )

    @property
    def requires(self) -> tuple[str, ...]:
        """The clutches that take up the reaction."""
        return (*self.needs, *(("focal_adhesion",) if self.reaction == "clutch" else ()))

    @property
    def outside_work(self) -> str:
        return "" if self.reaction == "clutch" else "a source: nothing takes up the reaction"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.full > self.edge:
            raise SceneError(
                "lamellipodium.full must be > lamellipodium.edge, got "
                f"full = {self.full:g} and edge = {self.edge:g}"
            )

    def elements(self, site: Site) -> tuple[Element, ...]:
        if self.reaction == "none":
            flat = site.matrix is None or site.matrix.flat
            return (LamellipodiumElement(self, site.body, site.commanded, 2 if flat else 3),)
        from cellsys.effects.protrusion import ProtrusionElement

        return (ProtrusionElement(self, site.body, site.disc, site.commanded),)


class LamellipodiumElement(CommandedPush):
    """Source of effort Se on the membrane array; enters u, not eta."""

    def __init__(
        self, effect: Lamellipodium, cell: CellBody, commands: Commands, axes: int = 2
    ) -> None:
        super().__init__(effect, cell, commands)
        self.axes = axes
        self.inputs = (Port(cell.name, self.name),)
        self.bonds = f"{cell.name}.bond_number"

    def force(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        e = self.effect
        out[0][:] = protrusion(
            s.nodes[self.array],
            s.internal[self.polarity],
            self.amplitude(s.t) * e.force,
            e.height,
            e.edge,
            e.full,
            e.downward,
            self.axes,
        )
        bonds = s.internal.get(self.bonds)
        if bonds is not None:
            # Clusters that switch: protrude, bind, then contract [notes: mechanics, lamellipodium].
            out[0][bonds >= 1.0] = 0.0


@dataclass(frozen=True)
class Polarity(Effect):
    """Polarity law: p turns towards the sensed direction [thesis eq. 72]."""

    name: ClassVar[str] = "polarity"
    needs: ClassVar[tuple[str, ...]] = ("stiffness_sensing",)
    steers: ClassVar[bool] = True
    not_on: ClassVar[dict[str, str]] = {
        "chain": "a crawler keeps the heading that polarity of [[cells]] gives it"
    }
    kappa: float = parameter(
        "1/60 1/s",
        "1/s",
        least=0.0,
        source="thesis, code kk [notes: mechanics, polarity]",
        about="gain",
    )


@dataclass(frozen=True, kw_only=True)
class StiffnessSensing(Effect):
    """Sensed cue d: where the matrix around the cell is stiffest [thesis eq. 73].

    |d| in [0, 1) says how far the contrast stands out of the network's noise; ``unit = true`` is
    the literal direction of length 1 (`cellsys.laws.sensing` has both).
    """

    name: ClassVar[str] = "stiffness_sensing"
    needs: ClassVar[tuple[str, ...]] = ("matrix_elasticity",)
    steers: ClassVar[bool] = True
    not_on: ClassVar[dict[str, str]] = {
        "chain": "in one dimension there is no stiffest direction to look for"
    }
    measure: str = parameter(
        "stiffness",
        choices=("stiffness", "stress"),
        source="working set [notes: mechanics, sensing]",
        about="nodal tangent stiffness, or tensile stress (the loop then circles for ever)",
    )
    reach: float = parameter(
        "14 um",
        "um",
        above=0.0,
        source="working set [notes: mechanics, sensing]",
        about="sensing range",
    )
    inner: float = parameter(
        "4 um",
        "um",
        least=0.0,
        source="assumed [notes: mechanics, sensing]",
        about="inner radius of the stress shell",
    )
    threshold: float = parameter(
        "0.001",
        least=0.0,
        source="assumed [notes: mechanics, sensing]",
        about="least |q|/S that turns the cell, where unit is true",
    )
    unit: bool = parameter(
        False,
        source="chosen here [notes: mechanics, sensing]",
        about="a direction of length 1 however little stands out, not a graded cue",
    )
    noise: float = parameter(
        "0.05",
        above=0.0,
        source="calibrated here [notes: mechanics, sensing]",
        about="g0: contrast that gives a cue of strength 1/2",
    )


class PolarityElement(Element):
    """State p of one cell: commanded, or turned by the polarity law, or constant."""

    def __init__(
        self,
        cell: CellBody,
        commands: Commands,
        polarity: Polarity | None,
        sensing: StiffnessSensing | None,
        fibres: FibreElement | None,
    ) -> None:
        self.cell, self.commands = cell, commands
        self.law, self.sensing, self.fibres = polarity, sensing, fibres
        self.name = f"{cell.name}.polarity"
        self.array = cell.name
        self.internal = (Block(self.name, (3,), "1", role="controller", kind="internal"),)
        self.axes = 2 if fibres is None or fibres.disc.flat else 3
        self._ends = np.ones(0)
        if sensing is not None and fibres is not None and not sensing.unit:
            self._ends = fibre_ends(len(fibres.disc.position), fibres.disc.fibres)

    def initial(self, block: Block) -> np.ndarray:
        if self.commands.heading is not None:
            return _heading(self.commands.heading, 0.0)
        return self.cell.polarity

    def sensed(self, s: Configuration) -> np.ndarray:
        """Sensed cue d (3,), |d| < 1; of a unit direction p itself where nothing stands out."""
        p = s.internal[self.name]
        if self.sensing is None or self.fibres is None:
            return p.copy()
        if not self.sensing.unit:
            d = np.zeros(3)
            d[: self.axes] = graded(self.contrast(s), self.sensing.noise)
            return d
        slope, tension = self.fibres.slopes(s)
        disc, center = self.fibres.disc, s.nodes[self.array].mean(axis=0)
        nodes = disc.position + s.nodes[MATRIX]
        if self.sensing.measure == "stress":
            return stress_direction(
                nodes, disc.fibres, tension * disc.length, center, p,
                self.sensing.inner, self.sensing.reach, self.sensing.threshold, self.axes,
            )  # fmt: skip
        return stiffest_direction(
            nodes, disc.fibres, slope * disc.stiffness, center, p,
            self.sensing.reach, self.sensing.threshold, self.axes,
        )  # fmt: skip

    def contrast(self, s: Configuration) -> np.ndarray:
        """g (axes,) of the stiffness per fibre, or of the tensile stress in its shell."""
        sensing, fibres = self.sensing, self.fibres
        if sensing is None or fibres is None:
            raise SceneError(f"{self.array} senses nothing: add stiffness_sensing to the scene")
        disc, center = fibres.disc, s.nodes[self.array].mean(axis=0)
        nodes = disc.position + s.nodes[MATRIX]
        if sensing.measure == "stiffness":
            measure = nodal_mean(disc.fibres, fibres.unbuckled(s), self._ends)
            return contrast(nodes, measure, center, sensing.reach, self.axes)
        _, tension = fibres.slopes(s)
        virial = tensile_virial(len(nodes), disc.fibres, tension * disc.length)
        q, total = measure_moment(nodes, virial, center, sensing.inner, sensing.reach, self.axes)
        return q / total if total > 0.0 else np.zeros(self.axes)

    def describe(self) -> dict[str, np.ndarray]:
        if self.sensing is None or self.fibres is None or self.sensing.unit:
            return {}
        disc = self.fibres.disc
        return {
            "sensing.noise": np.array(self.sensing.noise),
            "matrix.fibre_stiffness": nodal_mean(disc.fibres, disc.stiffness, self._ends),
        }

    def observe(self, s: Configuration) -> dict[str, np.ndarray]:
        return {"p": s.internal[self.name].copy(), "d": self.sensed(s)}

    def rates(self, s: Configuration, v: dict[str, np.ndarray], out: tuple) -> None:
        if self.commands.heading is not None:
            h = 1e-3
            ahead = _heading(self.commands.heading, s.t + h)
            out[0][:] = (ahead - _heading(self.commands.heading, s.t)) / h
        elif self.law is not None:
            out[0][:] = rate(s.internal[self.name], self.sensed(s), self.law.kappa)

    def advance(self, s: Configuration, end: Configuration, dt: float) -> None:
        self._turn(s, s, end, dt)

    def advance_by_middle(
        self, s: Configuration, middle: Configuration, end: Configuration, dt: float
    ) -> None:
        self._turn(s, middle, end, dt)

    def _turn(self, s: Configuration, at: Configuration, end: Configuration, dt: float) -> None:
        """The polarity of `end`, by the cue at `at`."""
        if self.commands.heading is not None:
            end.internal[self.name][:] = _heading(self.commands.heading, s.t + dt)
            return
        p = s.internal[self.name]
        if self.law is None:
            end.internal[self.name][:] = p
            return
        key = f"{self.name}.turned in {dt!r}"
        if key not in at.cache:  # every correction of a step asks again
            at.cache[key] = exact_step(p, self.sensed(at), self.law.kappa, dt)
        end.internal[self.name][:] = at.cache[key]

    def stop_points(self) -> tuple[float, ...]:
        return self.commands.stop_points()


def polarity_element(site: Site) -> PolarityElement:
    """The polarity of the site's cell, which all effects that steer it share."""
    fibres = next((e for e in site.built if isinstance(e, FibreElement)), None)
    if fibres is not None and "stiffness_sensing" in site.effects:
        fibres.is_read = True
    return PolarityElement(
        site.body,
        site.commanded,
        # By name, not by class: a build without the law has no such class.
        cast("Polarity | None", site.effects.get("polarity")),
        cast("StiffnessSensing | None", site.effects.get("stiffness_sensing")),
        fibres,
    )


def _heading(history: History, t: float) -> np.ndarray:
    angle = history(t)
    return np.array([np.cos(angle), np.sin(angle), 0.0])
