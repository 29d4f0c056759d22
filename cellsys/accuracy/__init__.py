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
from cellsys.accuracy.check import BudgetCheck, check_budget
from cellsys.accuracy.measures import MEASURES, measure
from cellsys.accuracy.peers import input_output_response, solve_ivp_peer
from cellsys.accuracy.setups import CostProblem, Setup, by_step, by_tolerance
from cellsys.accuracy.starts import (
    full_order_references,
    full_order_setups,
    loop_problems,
    probe_times,
    scene_problems,
)
from cellsys.accuracy.work_precision import WorkPoint, WorkPrecision, work_precision

__all__ = [
    "MEASURES",
    "Budget",
    "BudgetCheck",
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
    "check_budget",
    "coupling_cost",
    "full_order_references",
    "full_order_setups",
    "input_output_response",
    "kinetics_cost",
    "loop_problems",
    "measure",
    "order_cost",
    "probe_times",
    "runs_cost",
    "scene_problems",
    "solve_ivp_peer",
    "work_precision",
]
