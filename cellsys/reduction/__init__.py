"""Reduction: snapshots, basis, reductors, the latent model and its card."""

from typing import Any

from cellsys.worth.assessment import assess
from cellsys.reduction.basis import Basis, ExactSVD, RandomisedSVD, fit_basis
from cellsys.model.card import Card
from cellsys.reduction.certainty import PoleCertainty, pole_certainty
from cellsys.reduction.comparison import ComparedModel, Comparison, compare_reductors
from cellsys.model.contraction import Contraction, contraction
from cellsys.reduction.contractive import Contractive
from cellsys.cell.forecast import ErrorBands, Forecast, ValidityMonitor
from cellsys.cell.model import EquivariantModel
from cellsys.cell.on_field import CellsOnField
from cellsys.cell.on_matrix import with_matrix
from cellsys.cell.port import PolarPort
from cellsys.cell.reductor import Equivariant
from cellsys.cell.schedule import Clock
from cellsys.cell.worth import realisation_floor
from cellsys.reduction.jacobian import Jacobian
from cellsys.reduction.least_squares import LeastSquares
from cellsys.model.latent import LatentModel
from cellsys.reduction.pcr import PCR
from cellsys.reduction.piecewise import TPWL, PiecewiseModel
from cellsys.reduction.reduce import reduce, reduce_orders
from cellsys.reduction.ridge import Ridge
from cellsys.reduction.selection import (
    LearningCurve,
    Selection,
    grid,
    learning_curve,
    select_model,
)
from cellsys.model.sensor import StiffnessSensor, fit_sensor
from cellsys.samples.snapshots import RunData, Snapshots, snapshots
from cellsys.model.trained_range import Flag, TrainedRange

_FIELD = ("FullField", "GalerkinField", "full_field")


def __getattr__(name: str) -> Any:
    """Field models are loaded when first used: they bring the mechanics, and numba with it."""
    if name in _FIELD:
        from cellsys import field

        return getattr(field, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = [
    "PCR",
    "TPWL",
    "Basis",
    "Card",
    "CellsOnField",
    "Clock",
    "ComparedModel",
    "Comparison",
    "Contraction",
    "Contractive",
    "Equivariant",
    "EquivariantModel",
    "ErrorBands",
    "ExactSVD",
    "Flag",
    "Forecast",
    "FullField",
    "GalerkinField",
    "Jacobian",
    "LatentModel",
    "LearningCurve",
    "LeastSquares",
    "PiecewiseModel",
    "PolarPort",
    "PoleCertainty",
    "RandomisedSVD",
    "Ridge",
    "RunData",
    "Selection",
    "Snapshots",
    "StiffnessSensor",
    "TrainedRange",
    "ValidityMonitor",
    "assess",
    "compare_reductors",
    "contraction",
    "fit_basis",
    "fit_sensor",
    "full_field",
    "grid",
    "learning_curve",
    "pole_certainty",
    "realisation_floor",
    "reduce",
    "reduce_orders",
    "select_model",
    "snapshots",
    "with_matrix",
]
