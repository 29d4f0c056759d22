"""Focal adhesion: the smooth motor clutch, or Bell clusters that bind, load and rupture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cellsys.errors import SceneError
from cellsys.mechanics.effects.protocol import Effect, Element, Site, parameter


@dataclass(frozen=True)
class FocalAdhesion(Effect):
    """Adhesion of membrane nodes to the matrix surface [thesis 4.3, eq. 61-62].

    ``kinetics = "clutch"``: mean-field motor clutch, smooth (mechanics.md 2.4b).
    ``kinetics = "switching"``: Bell clusters on single matrix nodes (mechanics.md 2.3-2.4).
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
        "clutch", choices=("clutch", "switching"), source="mechanics 2.3-2.4b", about="bond model"
    )
    # clutch
    stiffness: float = parameter(
        "2000 pN/um", "pN/um", least=0.0, source="mechanics 2.4b k_b", about="bond stiffness"
    )
    zipper: float = parameter(
        "500 pN/um", "pN/um", least=0.0, source="mechanics 2.4b k_ad", about="vertical stiffness"
    )
    on_rate: float = parameter(
        "0.1 1/s", "1/s", least=0.0, source="mechanics 2.4b k_on", about="binding"
    )
    off_rate: float = parameter(
        "1/40 1/s", "1/s", above=0.0, source="mechanics 2.4b k_off0", about="unloaded unbinding"
    )
    force_scale: float = parameter(
        "600 pN", "pN", above=0.0, source="mechanics 2.4b F_b", about="load that doubles k_off"
    )
    retrograde_speed: float = parameter(
        "0.004 um/s", "um/s", least=0.0, source="mechanics 2.4b v_m", about="actomyosin pull"
    )
    height: float = parameter("0.9 um", "um", source="mechanics 2.4b h_b", about="binding height")
    width: float = parameter(
        "0.2 um", "um", above=0.0, source="mechanics 2.4b", about="width of the binding height"
    )
    reach: float = parameter(
        "3 um", "um", above=0.0, source="mechanics 2.4b h", about="radius of the load's weights"
    )
    # switching: a whole cluster has 2000 pN/um and fails at 430 pN. The 700 pN of numerics II.1
    # were reached with F_L on bound nodes too; here it acts on free nodes only (mechanics 2.5).
    bonds: float = parameter(
        "50", above=1.0, source="mechanics 2.3 n_max", about="most bonds of a cluster"
    )
    bond_stiffness: float = parameter(
        "40 pN/um", "pN/um", above=0.0, source="numerics II.1 (2 nN/um in all)", about="kappa_LR"
    )
    rest_length: float = parameter(
        "0.03 um", "um", least=0.0, source="mechanics 2.3 lambda", about="least bond length"
    )
    bind_distance: float = parameter(
        "1.2 um", "um", above=0.0, source="mechanics 2.3 d_bind", about="greatest length at binding"
    )
    bind_rate: float = parameter(
        "0.1 1/s", "1/s", least=0.0, source="cellsys calibration of mechanics 2.4", about="k_new"
    )
    gain_rate: float = parameter(
        "0.5 1/s", "1/s", above=0.0, source="mechanics 2.4 k_on", about="bonds closing"
    )
    loss_rate: float = parameter(
        "0.01 1/s", "1/s", above=0.0, source="mechanics 2.4 k_0", about="unloaded bonds opening"
    )
    bond_force: float = parameter(
        "4 pN", "pN", above=0.0, source="cellsys calibration of mechanics 2.4 f_b", about="f_b"
    )
    contraction_speed: float = parameter(
        "0.01 um/s", "um/s", least=0.0, source="mechanics 2.3 v_m", about="myosin, unloaded"
    )
    stall_force: float = parameter(
        "30 pN", "pN", above=0.0, source="cellsys calibration of 2.3 f_st", about="myosin stall"
    )

    def elements(self, site: Site) -> tuple[Element, ...]:
        if site.matrix is None:
            raise SceneError("focal_adhesion needs a matrix; add [matrix] to the scene")
        if self.kinetics == "clutch":
            from cellsys.mechanics.effects.clutch import ClutchElement

            return (ClutchElement(self, site.cell, site.matrix),)
        from cellsys.mechanics.effects.switching import SwitchingElement

        return (SwitchingElement(self, site.cell, site.matrix),)
