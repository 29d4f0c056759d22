"""Focal adhesion: the smooth motor clutch, or Bell clusters that bind, load and rupture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cellsys.effects.bond_laws import ClusterLaw, ClutchLaw
from cellsys.effects.protocol import Element, Site, parameter
from cellsys.errors import SceneError


@dataclass(frozen=True, kw_only=True)
class FocalAdhesion(ClutchLaw, ClusterLaw):
    """Adhesion of membrane nodes to the matrix surface [thesis 4.3, eq. 61-62].

    ``kinetics = "clutch"``: mean-field motor clutch, smooth [notes: mechanics, clutch].
    ``kinetics = "switching"``: Bell clusters on single matrix nodes [notes: mechanics, clusters].
    Every binding and rupture is a jump: a scene's step of 0.25 s keeps the step residual under 5 %
    (0.5 s is enough for the clutch), and runs that start 5 nm apart differ by some 8 %.
    """

    name: ClassVar[str] = "focal_adhesion"
    needs: ClassVar[tuple[str, ...]] = ("matrix_elasticity",)
    not_on: ClassVar[dict[str, str]] = {
        "chain": "its adhesions are adhesion_lead and adhesion_trail of [[cells]]"
    }
    active: ClassVar[bool] = True
    kinetics: str = parameter(
        "clutch",
        choices=("clutch", "switching"),
        refused={"gel": {"switching": "binds to the top of a flat matrix; take 'clutch'"}},
        source="chosen here [notes: mechanics, clutch]",
        about="bond model",
    )
    # clutch
    stiffness: float = parameter(
        "2000 pN/um",
        "pN/um",
        least=0.0,
        source="working set [notes: mechanics, clutch]",
        about="bond stiffness",
    )
    zipper: float = parameter(
        "500 pN/um",
        "pN/um",
        least=0.0,
        source="working set [notes: mechanics, clutch]",
        about="vertical stiffness",
        elsewhere={"gel": None},
    )
    on_rate: float = parameter(
        "0.1 1/s",
        "1/s",
        least=0.0,
        source="working set [notes: mechanics, clutch]",
        about="binding",
    )
    off_rate: float = parameter(
        "1/80 1/s",
        "1/s",
        above=0.0,
        source="chosen here [notes: mechanics, clutch]",
        about="unloaded unbinding",
        elsewhere={"gel": "1/40 1/s"},
    )
    reinforcement: float = parameter(
        "0",
        least=0.0,
        source="chosen here [notes: mechanics, clutch]",
        about="alpha: how much faster bonds open where the matrix is soft; 0: the same everywhere",
    )
    reinforcement_stiffness: float = parameter(
        "12000 pN/um",
        "pN/um",
        above=0.0,
        source="chosen here [notes: mechanics, clutch]",
        about="k_half: nodal stiffness of the matrix at which half of alpha is left",
    )
    force_scale: float = parameter(
        "600 pN",
        "pN",
        above=0.0,
        source="working set [notes: mechanics, clutch]",
        about="load that doubles k_off",
    )
    retrograde_speed: float = parameter(
        "0.004 um/s",
        "um/s",
        least=0.0,
        source="working set [notes: mechanics, clutch]",
        about="actomyosin pull",
    )
    height: float = parameter(
        "0.9 um",
        "um",
        source="working set [notes: mechanics, clutch]",
        about="binding height",
        elsewhere={"gel": None},
    )
    width: float = parameter(
        "0.2 um",
        "um",
        above=0.0,
        source="working set [notes: mechanics, clutch]",
        about="width of the binding height",
        elsewhere={"gel": None},
    )
    reach: float = parameter(
        "3 um",
        "um",
        above=0.0,
        source="working set [notes: mechanics, clutch]",
        about="radius of the load's weights",
        elsewhere={"gel": "5 um"},
    )
    # switching: a whole cluster has 2000 pN/um and fails at 430 pN. The prototype's 700 pN
    # were reached with F_L on bound nodes too; here it acts on free nodes only.
    # [notes: mechanics, lamellipodium]
    bonds: float = parameter(
        "50",
        above=1.0,
        source="assumed [notes: mechanics, clusters]",
        about="most bonds of a cluster",
    )
    bond_stiffness: float = parameter(
        "40 pN/um",
        "pN/um",
        above=0.0,
        source="working set [notes: mechanics, clusters]",
        about="kappa_LR",
    )
    rest_length: float = parameter(
        "0.03 um",
        "um",
        least=0.0,
        source="assumed [notes: mechanics, clusters]",
        about="least bond length",
    )
    bind_distance: float = parameter(
        "1.2 um",
        "um",
        above=0.0,
        source="assumed [notes: mechanics, clusters]",
        about="greatest length at binding",
    )
    bind_rate: float = parameter(
        "0.1 1/s",
        "1/s",
        least=0.0,
        source="calibrated here [notes: mechanics, clusters]",
        about="k_new",
    )
    gain_rate: float = parameter(
        "0.5 1/s",
        "1/s",
        above=0.0,
        source="assumed [notes: mechanics, clusters]",
        about="bonds closing",
    )
    loss_rate: float = parameter(
        "0.01 1/s",
        "1/s",
        above=0.0,
        source="assumed [notes: mechanics, clusters]",
        about="unloaded bonds opening",
    )
    bond_force: float = parameter(
        "4 pN", "pN", above=0.0, source="calibrated here [notes: mechanics, clusters]", about="f_b"
    )
    contraction_speed: float = parameter(
        "0.01 um/s",
        "um/s",
        least=0.0,
        source="assumed [notes: mechanics, clusters]",
        about="myosin, unloaded",
    )
    stall_force: float = parameter(
        "30 pN",
        "pN",
        above=0.0,
        source="calibrated here [notes: mechanics, clusters]",
        about="myosin stall",
    )

    def elements(self, site: Site) -> tuple[Element, ...]:
        if site.matrix is None:
            raise SceneError("focal_adhesion needs a matrix; add [matrix] to the scene")
        if self.kinetics == "clutch":
            from cellsys.effects.clutch import ClutchElement
            from cellsys.effects.embedded import foothold

            return (ClutchElement(self, site.body, foothold(site, self.reach)),)
        if self.reinforcement > 0.0:
            raise SceneError(
                f"focal_adhesion.reinforcement = {self.reinforcement:g} is a law of the motor "
                "clutch; set kinetics = 'clutch', or leave it out"
            )
        from cellsys.effects.switching import SwitchingElement

        return (SwitchingElement(self, site.body, site.disc),)
