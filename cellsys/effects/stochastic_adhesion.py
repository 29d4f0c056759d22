"""Stochastic adhesion: clusters whose bonds close and open one by one, seeded per cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.effects.bond_laws import ClusterLaw
from cellsys.effects.protocol import Configuration, Element, Site, parameter
from cellsys.effects.streams import stream
from cellsys.effects.switching import SwitchingElement
from cellsys.errors import SceneError
from cellsys.laws.bell import bell_off_rate
from cellsys.system import Event


@dataclass(frozen=True, kw_only=True)
class StochasticAdhesion(ClusterLaw):
    """Bell clusters with whole bonds: in a step dt at a load f per bond

        gains  ~ Binomial(n_max - n, 1 - exp(-k_on dt))
        losses ~ Binomial(n, 1 - exp(-k_off dt)),   k_off = k_0 exp(f/f_b)

    A cluster without a bond is gone. Every cell draws from a stream of its own, given by the
    run's seed and the cell's name: a further cell changes no number of this one
    [notes: mechanics, stochastic adhesion].
    """

    name: ClassVar[str] = "stochastic_adhesion"
    needs: ClassVar[tuple[str, ...]] = ("matrix_elasticity",)
    excludes: ClassVar[dict[str, str]] = {
        "focal_adhesion": "a membrane node holds one kind of bond"
    }
    active: ClassVar[bool] = True
    not_on: ClassVar[dict[str, str]] = {
        "chain": "its adhesions are adhesion_lead and adhesion_trail of [[cells]]",
        "gel": "its clusters bind to the top of a flat matrix; use focal_adhesion",
    }
    bonds: float = parameter(
        "50",
        least=1.0,
        source="assumed [notes: mechanics, stochastic adhesion]",
        about="most bonds of a cluster",
    )
    bond_stiffness: float = parameter(
        "40 pN/um",
        "pN/um",
        above=0.0,
        source="working set [notes: mechanics, stochastic adhesion]",
        about="kappa_LR",
    )
    rest_length: float = parameter(
        "0.03 um",
        "um",
        least=0.0,
        source="assumed [notes: mechanics, stochastic adhesion]",
        about="least bond length",
    )
    bind_distance: float = parameter(
        "1.2 um",
        "um",
        above=0.0,
        source="assumed [notes: mechanics, stochastic adhesion]",
        about="greatest length at binding",
    )
    bind_rate: float = parameter(
        "0.1 1/s",
        "1/s",
        least=0.0,
        source="calibrated here [notes: mechanics, stochastic adhesion]",
        about="k_new",
    )
    gain_rate: float = parameter(
        "0.5 1/s",
        "1/s",
        least=0.0,
        source="assumed [notes: mechanics, stochastic adhesion]",
        about="bonds closing",
    )
    loss_rate: float = parameter(
        "0.01 1/s",
        "1/s",
        least=0.0,
        source="assumed [notes: mechanics, stochastic adhesion]",
        about="unloaded bonds opening",
    )
    bond_force: float = parameter(
        "4 pN",
        "pN",
        above=0.0,
        source="calibrated here [notes: mechanics, stochastic adhesion]",
        about="f_b",
    )
    contraction_speed: float = parameter(
        "0.01 um/s",
        "um/s",
        least=0.0,
        source="assumed [notes: mechanics, stochastic adhesion]",
        about="myosin, unloaded",
    )
    stall_force: float = parameter(
        "30 pN",
        "pN",
        above=0.0,
        source="calibrated here [notes: mechanics, stochastic adhesion]",
        about="myosin stall",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.bonds != round(self.bonds):
            raise SceneError(
                f"stochastic_adhesion.bonds must be a whole number of bonds, got {self.bonds!r}"
            )

    def elements(self, site: Site) -> tuple[Element, ...]:
        if site.matrix is None:
            raise SceneError("stochastic_adhesion needs a matrix; add [matrix] to the scene")
        return (_StochasticElement(self, site.body, site.disc),)


class _StochasticElement(SwitchingElement):
    """Clusters of one cell; between two steps bond numbers stay as they are."""

    def rates(self, s: Configuration, v: dict[str, np.ndarray], out: tuple) -> None:
        super().rates(s, v, out)
        out[0][:] = 0.0

    def advance(self, s: Configuration, end: Configuration, dt: float) -> None:
        super().advance(s, end, dt)
        end.internal[self.number][:] = s.internal[self.number]

    def between_steps(
        self, s: Configuration, dt: float, rng: np.random.Generator
    ) -> tuple[Event, ...]:
        e, own = self.effect, stream(rng, self.name, s.t, dt)
        bound, _, load = self._bonds(s)
        number = s.internal[self.number]
        closed = number[bound].astype(np.int64)
        opening = -np.expm1(-bell_off_rate(load, e.loss_rate, e.bond_force) * dt)
        # One number per membrane node, bound or not: see `SwitchingElement.between_steps`.
        gains, losses = np.zeros(len(number), np.int64), np.zeros(len(number))
        gains[bound], losses[bound] = round(e.bonds) - closed, opening
        gained = own.binomial(gains, -np.expm1(-e.gain_rate * dt))
        lost = own.binomial(number.astype(np.int64), losses)
        number[bound] = closed + gained[bound] - lost[bound]
        return super().between_steps(s, dt, own)
