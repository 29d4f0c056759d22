"""Matrix: fibres (linear, buckling, stiffening), foundation, external loads, drag."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from cellsys.effects.fibre_kernels import fibre_energy, fibre_forces, fibre_slopes
from cellsys.effects.protocol import (
    Configuration,
    Effect,
    Element,
    Port,
    Site,
    Stiffness,
    parameter,
)
from cellsys.effects.tangent import diagonal
from cellsys.geometry.disc import StiffnessAssembly
from cellsys.geometry.network import FibreNetwork
from cellsys.laws.fibre import NEVER, FibreLaw
from cellsys.laws.sensing import nodal_sum, tensile_virial

MATRIX = "matrix"
_SOFTER = 0.6  # the bound is renewed when the network has become this much softer


@dataclass(frozen=True)
class Drag(Effect):
    """Viscous drag of every node; sets the constant 1/C of W_eta [thesis eq. 63-64].

    `medium` is C_c of the thesis, the drag of the medium on a membrane node. 189 nodes with it
    and the condensed cortex drag 0.38 N s/m; Stokes drag of a sphere of 8 um in water is 1.5e-7
    N s/m, a million times less. The number stands because the thesis's speeds do, and stands for
    all that a node's motion dissipates (membrane, cortex, what bonds that the clutch does not
    have would cost); as a force of the medium it is what leaves a net traction of some percent.
    """

    name: ClassVar[str] = "drag"
    acts_on: ClassVar[str] = "scene"
    not_on: ClassVar[dict[str, str]] = {"chain": "its drags are drag of [matrix] and of [[cells]]"}
    medium: float = parameter(
        "1000 pN s/um",
        "pN s/um",
        above=0.0,
        source="thesis, C_c [notes: mechanics, drag]",
        about="the medium on a membrane node, 1e6 times Stokes",
        once="cell",
    )
    cortex: float = parameter(
        "1000 pN s/um",
        "pN s/um",
        least=0.0,
        source="thesis, C_cort [notes: mechanics, drag]",
        about="cortex, condensed",
    )
    matrix: float = parameter(
        "1000 pN s/um",
        "pN s/um",
        above=0.0,
        source="thesis, C_e [notes: mechanics, drag]",
        about="matrix node",
    )

    @property
    def outside_work(self) -> str:
        return "the medium takes up the drag of every node"


@dataclass(frozen=True, kw_only=True)
class MatrixElasticity(Effect):
    """Central-force fibres, f = k l0 g(strain) along the fibre [thesis 4.3]."""

    name: ClassVar[str] = "matrix_elasticity"
    acts_on: ClassVar[str] = "matrix"
    not_on: ClassVar[dict[str, str]] = {
        "chain": "its springs are stiffness and stiffening of [matrix]"
    }
    law: str = parameter(
        "buckling",
        choices=("linear", "buckling", "stiffening"),
        source="working set [notes: matrix, fibres]",
        about="axial law",
    )
    buckling_ratio: float = parameter(
        "0.3",
        above=0.0,
        most=1.0,
        source="working set [notes: matrix, fibres]",
        about="slope in compression",
        elsewhere={"gel": "0.1"},
    )
    blend: float = parameter(
        "0.002",
        above=0.0,
        source="working set [notes: matrix, fibres]",
        about="strain over which the slope changes",
    )
    onset: float = parameter(
        "0.05",
        above=0.0,
        source="assumed [notes: matrix, fibres]",
        about="strain at which stiffening starts",
    )
    greatest_slope: float = parameter(
        "10", least=1.0, source="assumed [notes: matrix, fibres]", about="slope after stiffening"
    )

    def fibre_law(self) -> FibreLaw:
        """The axial law with this effect's numbers."""
        if self.law == "linear":
            return FibreLaw(1.0, self.blend, NEVER, 0.0)
        onset = NEVER if self.law == "buckling" else self.onset
        return FibreLaw(self.buckling_ratio, self.blend, onset, self.greatest_slope - 1.0)

    def elements(self, site: Site) -> tuple[Element, ...]:
        return (FibreElement(self, site.network),)


class FibreElement(Element):
    """All fibres of the matrix as one C-field."""

    def __init__(self, effect: MatrixElasticity, disc: FibreNetwork) -> None:
        self.disc, self.law = disc, effect.fibre_law()
        self.name = f"{MATRIX}.{effect.name}"
        self.ports = (Port(MATRIX, self.name),)
        self._bounds: tuple[np.ndarray, np.ndarray] | None = None
        self._key = 0
        self._assembly: StiffnessAssembly | None = None
        # Share of each fibre that is left, set by an effect that takes some away.
        self.intact: Callable[[Configuration], np.ndarray] | None = None
        self.is_read = False  # whether a cell reads the nodal measures, which are then stored

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        d = self.disc
        fibre_forces(
            d.position, s.nodes[MATRIX], d.fibres, d.length, d.stiffness, *self.law, out[0]
        )

    def energy(self, s: Configuration) -> float:
        d = self.disc
        return float(
            fibre_energy(d.position, s.nodes[MATRIX], d.fibres, d.length, d.stiffness, *self.law)
        )

    def forget(self) -> None:
        self._bounds = None

    def slopes(self, s: Configuration) -> tuple[np.ndarray, np.ndarray]:
        """Tangent slope g' and tension (pN) of every fibre, by the share of it that is left."""
        slope, tension = self._raw(s)
        if self.intact is None:
            return slope, tension
        key = self.name + ".intact"
        if key not in s.cache:
            s.cache[key] = slope * self.intact(s), tension * self.intact(s)
        return s.cache[key]

    def _raw(self, s: Configuration) -> tuple[np.ndarray, np.ndarray]:
        """Tangent slope g' and tension (pN) of whole fibres."""
        if self.name not in s.cache:
            d, u = self.disc, s.nodes[MATRIX]
            slope, tension = np.empty(len(d.fibres)), np.empty(len(d.fibres))
            fibre_slopes(
                d.position,
                # The loop would be compiled once more for an array that must not be written.
                u if u.flags.writeable else u.copy(),
                d.fibres,
                d.length,
                d.stiffness,
                *self.law,
                slope,
                tension,
            )
            s.cache[self.name] = slope, tension
        return s.cache[self.name]

    def unbuckled(self, s: Configuration) -> np.ndarray:
        """k max(g', 1) of every fibre (m,), pN/um: buckled ones as if they were straight."""
        stiffness = np.maximum(self._raw(s)[0], 1.0) * self.disc.stiffness
        return stiffness if self.intact is None else stiffness * self.intact(s)

    def measure(self, s: Configuration) -> dict[str, np.ndarray]:
        """The nodal measures, where a cell senses; nothing is stored that nobody reads."""
        return self.nodal(s) if self.is_read else {}

    def nodal(self, s: Configuration) -> dict[str, np.ndarray]:
        """Tensile ``virial`` (N,), pN um, and tangent ``stiffness`` (N,), pN/um, at the nodes."""
        d, n = self.disc, len(self.disc.position)
        slope, tension = self.slopes(s)
        return {
            "virial": tensile_virial(n, d.fibres, tension * d.length),
            "stiffness": nodal_sum(n, d.fibres, slope * d.stiffness),
        }

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        d = self.disc
        slope, tension = self.slopes(s)
        # A fibre passes from its buckled to its full slope within a few nm, faster than any look,
        # so 1 bounds every slope that has not stiffened. Tension stiffens a fibre across its
        # axis, which decides for the floppy out-of-plane modes of a thin film.
        along = np.maximum(slope, 1.0) * d.stiffness
        across = np.maximum(tension, 0.0) / d.length
        kept = self._bounds
        if (
            kept is None
            or np.any(along > kept[0])
            or np.any(across > kept[1])
            or along.sum() < _SOFTER * kept[0].sum()
        ):
            kept = self._bounds = (
                np.where(slope > 1.0, 1.2, 1.1) * along,
                2.0 * across + 0.06 * d.stiffness,
            )
            self._key += 1
        x = d.position + s.nodes[MATRIX]
        return (Stiffness(MATRIX, (), lambda: self._bound(x, *kept), self._key),)

    def _bound(self, x: np.ndarray, along: np.ndarray, across: np.ndarray) -> sp.csc_array:
        if self._assembly is None:
            self._assembly = StiffnessAssembly(len(x), self.disc.fibres)
        return self._assembly(x, along, across)


@dataclass(frozen=True)
class Foundation(Effect):
    """Weak vertical spring under every matrix node: the soft support below the film."""

    name: ClassVar[str] = "foundation"
    acts_on: ClassVar[str] = "matrix"
    not_on: ClassVar[dict[str, str]] = {
        "chain": "a chain is held by its two walls only",
        "gel": "there is no support below a gel; its ends hold it",
    }
    spring: float = parameter(
        "500 pN/um",
        "pN/um",
        least=0.0,
        source="working set [notes: matrix, foundation]",
        about="vertical spring of a node",
    )

    @property
    def outside_work(self) -> str:
        return "the support below the film takes up the springs' pull"

    def elements(self, site: Site) -> tuple[Element, ...]:
        return (_FoundationElement(self, site.disc),)


class _FoundationElement(Element):
    def __init__(self, effect: Foundation, disc: FibreNetwork) -> None:
        self.spring, self.disc = effect.spring, disc
        self.outside = effect.outside_work
        self.name = f"{MATRIX}.{effect.name}"
        self.ports = (Port(MATRIX, self.name),)

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        out[0][:, 2] = -self.spring * s.nodes[MATRIX][:, 2]

    def energy(self, s: Configuration) -> float:
        z = s.nodes[MATRIX][:, 2]
        return 0.5 * self.spring * float(z @ z)

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        springs = np.full(len(self.disc.position), self.spring)
        return (Stiffness(MATRIX, (2,), lambda: diagonal(springs), 0),)
