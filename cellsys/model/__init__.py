"""The reduced model: latent equations, file, zero-order hold, card, trained range, sensors."""

from cellsys.model.card import Card
from cellsys.model.contraction import Contraction, contraction
from cellsys.model.latent import LatentModel
from cellsys.model.sensor import StiffnessSensor, fit_sensor
from cellsys.model.trained_range import Flag, TrainedRange

__all__ = [
    "Card",
    "Contraction",
    "Flag",
    "LatentModel",
    "StiffnessSensor",
    "TrainedRange",
    "contraction",
    "fit_sensor",
]
