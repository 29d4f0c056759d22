"""Reduction: bases, reductors, comparison, choice and certainty."""

from cellsys.reduction.basis import Basis, ExactSVD, RandomisedSVD, fit_basis
from cellsys.reduction.certainty import pole_certainty
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
    candidates,
    learning_curve,
    select_model,
)
from cellsys.renamed import old_names
from cellsys.spectra.certainty import PoleCertainty

__getattr__ = old_names(__name__)

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
    "candidates",
    "compare_reductors",
    "fit_basis",
    "learning_curve",
    "pole_certainty",
    "reduce",
    "reduce_orders",
    "select_model",
]
