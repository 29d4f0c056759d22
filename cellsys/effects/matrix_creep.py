"""Matrix creep: a Maxwell branch beside every fibre, or a Kelvin element in line with it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from cellsys.compiled import compiled
from cellsys.effects.matrix import MATRIX, FibreElement
from cellsys.effects.protocol import (
    Configuration,
    Effect,
    Element,
    Port,
    Site,
    Stiffness,
    parameter,
)
from cellsys.geometry.disc import StiffnessAssembly
from cellsys.laws.fibre import axial, axial_energy
from cellsys.system import Block


@compiled
def fibre_lengths(rest, u, fibres, length):
    """Fill the present length of every fibre, um."""
    for k in range(fibres.shape[0]):
        i, j = fibres[k, 0], fibres[k, 1]
        d0 = rest[j, 0] + u[j, 0] - rest[i, 0] - u[i, 0]
        d1 = rest[j, 1] + u[j, 1] - rest[i, 1] - u[i, 1]
        d2 = rest[j, 2] + u[j, 2] - rest[i, 2] - u[i, 2]
        length[k] = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2 + 1e-12)


@compiled
def pull_along(rest, u, fibres, length, tension, force):
    """Add the forces of fibres of given length and tension (pN, positive pulls)."""
    for k in range(fibres.shape[0]):
        i, j, f = fibres[k, 0], fibres[k, 1], tension[k] / length[k]
        for c in range(3):
            pull = f * (rest[j, c] + u[j, c] - rest[i, c] - u[i, c])
            force[i, c] += pull
            force[j, c] -= pull


@dataclass(frozen=True)
class MatrixCreep(Effect):
    """Viscoelastic fibres of axial stiffness k: one internal length per fibre.

    ``branch = "maxwell"``: a spring q k and a dashpot beside the fibre, e = l - l0:
    f = q k (e - a), a' = (e - a)/tau. The fibre itself stays as the equilibrium spring.
    ``branch = "kelvin"``: a spring k/q with a dashpot beside it, in line with the fibre:
    f(l - r) in place of f(l), r' = (f(l - r) q/k - r)/tau; the port holds f(l - r) - f(l).
    Both are passive: dE/dt = -(power of the dashpots).
    """

    name: ClassVar[str] = "matrix_creep"
    acts_on: ClassVar[str] = "matrix"
    needs: ClassVar[tuple[str, ...]] = ("matrix_elasticity",)
    not_on: ClassVar[dict[str, str]] = {"chain": "the springs of a chain are elastic"}
    branch: str = parameter(
        "maxwell",
        choices=("maxwell", "kelvin"),
        source="standard linear solid [notes: matrix, matrix creep]",
        about="branch",
    )
    ratio: float = parameter(
        "0.5", least=0.0, source="chosen here [notes: matrix, matrix creep]",
        about="q: branch over fibre stiffness (maxwell), fibre over branch (kelvin)",
    )  # fmt: skip
    time: float = parameter(
        "100 s",
        "s",
        above=0.0,
        source="chosen here [notes: matrix, matrix creep]",
        about="relaxation time tau",
    )

    def elements(self, site: Site) -> tuple[Element, ...]:
        fibres = next(e for e in site.built if isinstance(e, FibreElement))
        kind = _MaxwellElement if self.branch == "maxwell" else _KelvinElement
        return (kind(self, fibres),)


class _CreepElement(Element, ABC):
    def __init__(self, effect: MatrixCreep, fibres: FibreElement) -> None:
        self.effect, self.disc, self.law = effect, fibres.disc, fibres.law
        self.name = f"{MATRIX}.{effect.name}"
        self.ports = (Port(MATRIX, self.name),)
        self.state = f"{MATRIX}.creep"
        self.internal = (
            Block(self.state, (len(self.disc.fibres),), "um", role="field", kind="internal"),
        )
        self._bounds: tuple[np.ndarray, np.ndarray] | None = None
        self._key = 0
        self._assembly: StiffnessAssembly | None = None

    def lengths(self, s: Configuration) -> np.ndarray:
        """Present lengths of the fibres, um."""
        if self.name not in s.cache:
            d, now = self.disc, np.empty(len(self.disc.fibres))
            fibre_lengths(d.position, s.nodes[MATRIX], d.fibres, now)
            s.cache[self.name] = now
        return s.cache[self.name]

    @abstractmethod
    def tension(self, s: Configuration) -> np.ndarray:
        """Tension that the branch adds to every fibre, pN."""

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        d = self.disc
        pull_along(d.position, s.nodes[MATRIX], d.fibres, self.lengths(s), self.tension(s), out[0])

    def forget(self) -> None:
        self._bounds = None

    @abstractmethod
    def along(self, s: Configuration) -> np.ndarray:
        """Tangent along the fibres that the branch adds at most, pN/um."""

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        along = self.along(s)
        across = np.maximum(self.tension(s), 0.0) / self.lengths(s)
        kept = self._bounds
        if kept is None or np.any(along > kept[0]) or np.any(across > kept[1]):
            # Fibres turn between two looks; a floor across the axis covers it, as in `matrix`.
            kept = self._bounds = 1.1 * along, 2.0 * across + 0.06 * along
            self._key += 1
        if not kept[0].any() and not kept[1].any():
            return ()
        x = self.disc.position + s.nodes[MATRIX]
        return (Stiffness(MATRIX, (), lambda: self._bound(x, *kept), self._key),)

    def _bound(self, x: np.ndarray, along: np.ndarray, across: np.ndarray) -> sp.csc_array:
        if self._assembly is None:
            self._assembly = StiffnessAssembly(len(x), self.disc.fibres)
        return self._assembly(x, along, across)


class _MaxwellElement(_CreepElement):
    def _stretch(self, s: Configuration) -> np.ndarray:
        return self.lengths(s) - self.disc.length - s.internal[self.state]

    def tension(self, s: Configuration) -> np.ndarray:
        return self.effect.ratio * self.disc.stiffness * self._stretch(s)

    def energy(self, s: Configuration) -> float:
        """Energy of the branch springs; the dashpots dissipate f^2 tau/(q k)."""
        return 0.5 * float(self.tension(s) @ self._stretch(s))

    def rates(self, s: Configuration, v: dict[str, np.ndarray], out: tuple) -> None:
        out[0][:] = self._stretch(s) / self.effect.time

    def advance(self, s: Configuration, end: Configuration, dt: float) -> None:
        past, now = s.internal[self.state], self.lengths(end) - self.disc.length
        end.internal[self.state][:] = now + (past - now) * np.exp(-dt / self.effect.time)

    def along(self, s: Configuration) -> np.ndarray:
        return self.effect.ratio * self.disc.stiffness


class _KelvinElement(_CreepElement):
    def _strains(self, s: Configuration) -> tuple[np.ndarray, np.ndarray]:
        length, now = self.disc.length, self.lengths(s)
        return now / length - 1.0, (now - s.internal[self.state]) / length - 1.0

    def tension(self, s: Configuration) -> np.ndarray:
        d = self.disc
        whole, part = self._strains(s)
        return d.stiffness * d.length * (axial(part, *self.law)[0] - axial(whole, *self.law)[0])

    def energy(self, s: Configuration) -> float:
        """Energy of fibre and branch in line, less that of the fibre alone."""
        d, q = self.disc, self.effect.ratio
        whole, part = self._strains(s)
        fibre = axial_energy(part, *self.law) - axial_energy(whole, *self.law)
        branch = 0.0 if q == 0.0 else 0.5 / q * s.internal[self.state] ** 2
        return float((d.stiffness * d.length**2) @ fibre + (d.stiffness * branch).sum())

    def _rate(self, strain: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        g, slope = axial(strain, *self.law)
        q, tau = self.effect.ratio, self.effect.time
        return (q * self.disc.length * g - r) / tau, -(1.0 + q * slope) / tau

    def rates(self, s: Configuration, v: dict[str, np.ndarray], out: tuple) -> None:
        out[0][:] = self._rate(self._strains(s)[1], s.internal[self.state])[0]

    def advance(self, s: Configuration, end: Configuration, dt: float) -> None:
        # Exponential Euler at the new length: exact for a linear fibre.
        r = s.internal[self.state]
        rate, slope = self._rate((self.lengths(end) - r) / self.disc.length - 1.0, r)
        end.internal[self.state][:] = r + rate * np.expm1(slope * dt) / slope

    def along(self, s: Configuration) -> np.ndarray:
        """A shorter fibre is no stiffer than the bound of `matrix`, unless its law stiffens."""
        whole, part = self._strains(s)
        above = np.maximum(axial(part, *self.law)[1], 1.0) - np.maximum(
            axial(whole, *self.law)[1], 1.0
        )
        return np.maximum(above, 0.0) * self.disc.stiffness
