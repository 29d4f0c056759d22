"""Steering: lamellipodium, polarity, stiffness sensing; and external loads on the matrix."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, cast

import numpy as np

from cellsys.errors import SceneError
from cellsys.laws.lamellipodium import protrusion
from cellsys.laws.polarity import exact_step, rate
from cellsys.laws.sensing import stiffest_direction, stress_direction
from cellsys.mechanics.commands import Commands, History
from cellsys.mechanics.effects.matrix import MATRIX, FibreElement
from cellsys.mechanics.effects.protocol import (
    CellBody,
    Configuration,
    Effect,
    Element,
    Port,
    Site,
    parameter,
)
from cellsys.mechanics.geometry.disc import Disc
from cellsys.system import Block


@dataclass(frozen=True, kw_only=True)
class Lamellipodium(Effect):
    """Protrusion of the leading sector, an exogenous force [thesis 4.4, eq. 68-70]."""

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
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.full > self.edge:
            raise SceneError(
                "lamellipodium.full must be > lamellipodium.edge, got "
                f"full = {self.full:g} and edge = {self.edge:g}"
            )

    def elements(self, site: Site) -> tuple[Element, ...]:
        return (LamellipodiumElement(self, site.body, site.commanded),)


class LamellipodiumElement(Element):
    """Source of effort Se on the membrane array; enters u, not eta."""

    def __init__(self, effect: Lamellipodium, cell: CellBody, commands: Commands) -> None:
        self.effect, self.commands, self.cell = effect, commands, cell
        self.name = f"{cell.name}.{effect.name}"
        self.array = cell.name
        self.inputs = (Port(cell.name, self.name),)
        self.commanded = (
            Block(f"{cell.name}.heading", (3,), "1", role="controller", kind="internal"),
            Block(f"{cell.name}.amplitude", (), "1", role="controller", kind="internal"),
        )
        self.polarity = f"{cell.name}.polarity"
        self.bonds = f"{cell.name}.bond_number"

    def amplitude(self, t: float) -> float:
        """Commanded factor on the force at time t."""
        history = self.commands.amplitude
        return 1.0 if history is None else history(t)

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
        )
        bonds = s.internal.get(self.bonds)
        if bonds is not None:
            # Clusters that switch: protrude, bind, then contract [notes: mechanics, lamellipodium].
            out[0][bonds >= 1.0] = 0.0

    def observe(self, s: Configuration) -> dict[str, np.ndarray]:
        return {"amplitude": np.asarray(self.amplitude(s.t))}

    def stop_points(self) -> tuple[float, ...]:
        return self.commands.stop_points()


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


@dataclass(frozen=True)
class StiffnessSensing(Effect):
    """Sensed direction d: where the matrix around the cell is stiffest [thesis eq. 73]."""

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
        about="least |q|/S that turns the cell",
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

    def initial(self, block: Block) -> np.ndarray:
        if self.commands.heading is not None:
            return _heading(self.commands.heading, 0.0)
        return self.cell.polarity

    def sensed(self, s: Configuration) -> np.ndarray:
        """Sensed direction d (3,), |d| = 1; p itself where nothing stands out."""
        p = s.internal[self.name]
        if self.sensing is None or self.fibres is None:
            return p.copy()
        slope, tension = self.fibres.slopes(s)
        disc, center = self.fibres.disc, s.nodes[self.array].mean(axis=0)
        nodes = disc.position + s.nodes[MATRIX]
        if self.sensing.measure == "stress":
            return stress_direction(
                nodes, disc.fibres, tension * disc.length, center, p,
                self.sensing.inner, self.sensing.reach, self.sensing.threshold,
            )  # fmt: skip
        return stiffest_direction(
            nodes, disc.fibres, slope * disc.stiffness, center, p,
            self.sensing.reach, self.sensing.threshold,
        )  # fmt: skip

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
        if self.commands.heading is not None:
            end.internal[self.name][:] = _heading(self.commands.heading, s.t + dt)
            return
        p = s.internal[self.name]
        if self.law is None:
            end.internal[self.name][:] = p
            return
        key = self.name + ".d"
        if key not in s.cache:
            s.cache[key] = self.sensed(s)
        end.internal[self.name][:] = exact_step(p, s.cache[key], self.law.kappa, dt)

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


@dataclass(frozen=True, kw_only=True)
class ExternalLoad(Effect):
    """A force history spread over the surface nodes of a round patch of the matrix.

    `patches` are further loads of the same kind that act together with this one.
    """

    name: ClassVar[str] = "external_load"
    acts_on: ClassVar[str] = "matrix"
    active: ClassVar[bool] = True
    not_on: ClassVar[dict[str, str]] = {"chain": "a chain is loaded by its cells only"}
    force: float = parameter(
        "1000 pN",
        "pN",
        source="scene [notes: matrix, external load and strain]",
        about="total force at factor 1",
    )
    direction: float = parameter(
        "0 deg",
        "rad",
        source="scene [notes: matrix, external load and strain]",
        about="angle in the plane",
    )
    x: float = parameter(
        "0 um",
        "um",
        source="scene [notes: matrix, external load and strain]",
        about="centre of the patch",
    )
    y: float = parameter(
        "0 um",
        "um",
        source="scene [notes: matrix, external load and strain]",
        about="centre of the patch",
    )
    radius: float = parameter(
        "5 um",
        "um",
        above=0.0,
        source="scene [notes: matrix, external load and strain]",
        about="radius of the patch",
    )
    history: History = History((0.0,), (1.0,))
    patches: tuple[ExternalLoad, ...] = ()

    def elements(self, site: Site) -> tuple[Element, ...]:
        return (_LoadElement(self, site.disc),)


class _LoadElement(Element):
    def __init__(self, effect: ExternalLoad, disc: Disc) -> None:
        self.effect = effect
        self.name = f"{MATRIX}.{effect.name}"
        self.inputs = (Port(MATRIX, self.name),)
        self.parts = tuple((p, _pattern(p, disc)) for p in (effect, *effect.patches))

    def force(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        out[0][:] = 0.0
        for patch, pattern in self.parts:
            out[0][:] += patch.history(s.t) * pattern

    def stop_points(self) -> tuple[float, ...]:
        return tuple(t for patch, _ in self.parts for t in patch.history.times)


def _pattern(patch: ExternalLoad, disc: Disc) -> np.ndarray:
    """Nodal forces (n, 3) of one patch at factor 1."""
    xy = disc.position[:, :2] - (patch.x, patch.y)
    weight = np.clip(1.0 - (xy**2).sum(axis=1) / patch.radius**2, 0.0, None)
    weight[disc.clamped] = 0.0
    mask = np.zeros(len(weight))
    mask[disc.surface] = 1.0
    weight *= mask
    if not weight.any():
        raise SceneError(
            f"external_load at ({patch.x:g}, {patch.y:g}) um, radius {patch.radius:g} um, "
            "covers no free matrix node; move it inside the disc or enlarge it"
        )
    unit = np.array([np.cos(patch.direction), np.sin(patch.direction), 0.0])
    return patch.force * (weight / weight.sum())[:, None] * unit
