"""Reduction: bases, reductors, comparison, choice and certainty."""

import warnings
from typing import Any

from cellsys.reduction.basis import Basis, ExactSVD, RandomisedSVD, fit_basis
from cellsys.reduction.certainty import PoleCertainty, pole_certainty
from cellsys.reduction.comparison import ComparedModel, Comparison, compare_reductors
from cellsys.reduction.contractive import Contractive
from cellsys.reduction.jacobian import Jacobian
from cellsys.reduction.least_squares import LeastSquares
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

_MOVED = (
    "Card", "CellsOnField", "Clock", "Contraction", "Equivariant", "EquivariantModel",
    "ErrorBands", "FieldPassivity", "Flag", "Forecast", "FullField", "GalerkinField",
    "LatentModel", "PolarPort", "RunData", "Snapshots", "StiffnessSensor", "TrainedRange",
    "ValidityMonitor", "assess", "contraction", "fit_sensor", "full_field", "realisation_floor",
    "snapshots", "with_matrix",
)  # fmt: skip


def __getattr__(name: str) -> Any:
    """Names that stood here up to version 0.2; they are found in `cellsys` itself."""
    if name in _MOVED:
        warnings.warn(
            f"cellsys.reduction.{name} is now cellsys.{name}", DeprecationWarning, stacklevel=2
        )
        import cellsys

        return getattr(cellsys, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = [
    "PCR",
    "TPWL",
    "Basis",
    "ComparedModel",
    "Comparison",
    "Contractive",
    "ExactSVD",
    "Jacobian",
    "LearningCurve",
    "LeastSquares",
    "PiecewiseModel",
    "PoleCertainty",
    "RandomisedSVD",
    "Ridge",
    "Selection",
    "compare_reductors",
    "fit_basis",
    "grid",
    "learning_curve",
    "pole_certainty",
    "reduce",
    "reduce_orders",
    "select_model",
]
