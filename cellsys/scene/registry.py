"""The effects a scene can name: an explicit list."""

from __future__ import annotations

from cellsys.mechanics.effects.adhesion import FocalAdhesion
from cellsys.mechanics.effects.matrix import Drag, Foundation, MatrixElasticity
from cellsys.mechanics.effects.membrane import (
    CorticalTension,
    MembraneElasticity,
    SubstrateContact,
    Volume,
)
from cellsys.mechanics.effects.protocol import Effect
from cellsys.mechanics.effects.steering import (
    ExternalLoad,
    Lamellipodium,
    Polarity,
    StiffnessSensing,
)

EFFECTS: dict[str, type[Effect]] = {
    effect.name: effect
    for effect in (
        Drag,
        MembraneElasticity,
        Volume,
        CorticalTension,
        FocalAdhesion,
        Lamellipodium,
        SubstrateContact,
        MatrixElasticity,
        Foundation,
        ExternalLoad,
        StiffnessSensing,
        Polarity,
    )
}
