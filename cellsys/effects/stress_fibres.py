"""Stress fibres: contractile bundles from bound membrane nodes to the nucleus, or to the middle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.effects.bond_laws import ClusterLaw
from cellsys.effects.protocol import (
    CellBody,
    Configuration,
    Effect,
    Element,
    Port,
    Site,
    Stiffness,
    parameter,
)
from cellsys.effects.tangent import diagonal
from cellsys.errors import SceneError


@dataclass(frozen=True)
class StressFibres(Effect):
    """Constant tension T in a fibre from every bound node to an anchor a: E = sum T n_i l_i.

    n_i is the share of closed bonds at membrane node i (0 where nothing is bound, then there is no
    fibre), l_i = sqrt(|x_i - a|^2 + soft^2). The anchor is the mean of the nodes of the nucleus
    when the cell has one, else of the membrane, and takes up the reaction in equal shares.
    """

    name: ClassVar[str] = "stress_fibres"
    needs: ClassVar[tuple[str, ...]] = ("focal_adhesion|stochastic_adhesion",)
    active: ClassVar[bool] = True
    not_on: ClassVar[dict[str, str]] = {
        "chain": "a crawler has no fibres inside; stiffness of [[cells]] draws it together"
    }
    tension: float = parameter(
        "50 pN", "pN", least=0.0,
        source="chosen here [notes: mechanics, stress fibres]",
        about="pull of a fibre with all bonds closed",
    )  # fmt: skip
    soft: float = parameter(
        "0.5 um",
        "um",
        above=0.0,
        source="chosen here [notes: mechanics, stress fibres]",
        about="below this length it fades",
    )

    def elements(self, site: Site) -> tuple[Element, ...]:
        adhesion = site.find(ClusterLaw)
        if adhesion is None:
            raise SceneError("stress_fibres needs focal_adhesion or stochastic_adhesion; add one")
        nuclear = any(a.name == f"{site.body.name}.nucleus" for a in site.arrays)
        return (_StressFibreElement(self, site.body, adhesion.bonds, nuclear),)


class _StressFibreElement(Element):
    def __init__(self, effect: StressFibres, cell: CellBody, bonds: float, nuclear: bool) -> None:
        self.effect, self.array, self.bonds = effect, cell.name, bonds
        self.name = f"{cell.name}.{effect.name}"
        self.anchor = f"{cell.name}.nucleus" if nuclear else cell.name
        self.ports = (Port(cell.name, self.name),)
        if nuclear:
            self.ports += (Port(self.anchor, f"{self.name}.nucleus"),)

    def bound(self, s: Configuration) -> np.ndarray:
        """Share of closed bonds at every membrane node (n,)."""
        strength = s.internal.get(f"{self.array}.bond_strength")
        if strength is not None:
            return strength
        return s.internal[f"{self.array}.bond_number"] / self.bonds

    def _lengths(self, s: Configuration) -> tuple[np.ndarray, np.ndarray]:
        offset = s.nodes[self.array] - s.nodes[self.anchor].mean(axis=0)
        return offset, np.sqrt((offset**2).sum(axis=1) + self.effect.soft**2)

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        offset, length = self._lengths(s)
        pull = (self.effect.tension * self.bound(s) / length)[:, None] * offset
        out[0][:] -= pull
        out[-1][:] += pull.sum(axis=0) / len(out[-1])

    def energy(self, s: Configuration) -> float:
        """At the present bonds: T n_i (l_i - soft)."""
        _, length = self._lengths(s)
        return self.effect.tension * float(self.bound(s) @ (length - self.effect.soft))

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        """h_i |d_i - mean d|^2 <= 2 h_i |d_i|^2 + 2 h_i sum |d_j|^2 / N with h_i = T n_i / l_i."""
        _, length = self._lengths(s)
        # Bonds close while the matrix is kept: the same margin as the clutch's own.
        h = self.effect.tension * np.minimum(self.bound(s) + 0.2, 1.0) / length
        own, shared = 2.0 * h, 2.0 * h.sum() / len(s.nodes[self.anchor])
        if self.anchor == self.array:
            return (Stiffness(self.array, (0, 1, 2), lambda: diagonal(own + shared), None),)
        nucleus = np.full(len(s.nodes[self.anchor]), shared)
        return (
            Stiffness(self.array, (0, 1, 2), lambda: diagonal(own), None),
            Stiffness(self.anchor, (0, 1, 2), lambda: diagonal(nucleus), None),
        )
