"""What accuracy costs: error measures, work-precision sweeps, cheapest setting under an error."""

from cellsys.accuracy.axes import (
    CostAxis,
    CostRow,
    coupling_cost,
    kinetics_cost,
    order_cost,
    runs_cost,
)
from cellsys.accuracy.budget import Budget, budget
from cellsys.accuracy.cells import cells_cost
from cellsys.accuracy.measures import MEASURES, measure
from cellsys.accuracy.peers import input_output_response, solve_ivp_peer
from cellsys.accuracy.setups import CostProblem, Setup, by_step, by_tolerance
from cellsys.accuracy.work_precision import WorkPoint, WorkPrecision, work_precision

__all__ = [
    "MEASURES",
    "Budget",
    "CostAxis",
    "CostProblem",
    "CostRow",
    "Setup",
    "WorkPoint",
    "WorkPrecision",
    "budget",
    "by_step",
    "by_tolerance",
    "cells_cost",
    "coupling_cost",
    "input_output_response",
    "kinetics_cost",
    "measure",
    "order_cost",
    "runs_cost",
    "solve_ivp_peer",
    "work_precision",
]
