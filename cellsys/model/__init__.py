"""The reduced model: latent equations, file, zero-order hold, card, trained range, sensors."""

from cellsys.model.affine import AffineModel
from cellsys.model.card import Card
from cellsys.model.contraction import Contraction, contraction
from cellsys.model.latent import LatentModel, basis_of
from cellsys.model.sensor import StiffnessSensor, fit_sensor
from cellsys.model.trained_range import Flag, TrainedRange

__all__ = [
    "AffineModel",
    "Card",
    "Contraction",
    "Flag",
    "LatentModel",
    "StiffnessSensor",
    "TrainedRange",
    "basis_of",
    "contraction",
    "fit_sensor",
]
