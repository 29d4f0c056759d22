"""What accuracy costs: error measures, work-precision sweeps, cheapest setting under an error."""

from cellsys.accuracy.budget import Budget, budget
from cellsys.accuracy.measures import MEASURES, measure
from cellsys.accuracy.peers import input_output_response, solve_ivp_peer
from cellsys.accuracy.setups import CostProblem, Setup, by_step, by_tolerance
from cellsys.accuracy.work_precision import WorkPoint, WorkPrecision, work_precision

__all__ = [
    "MEASURES",
    "Budget",
    "CostProblem",
    "Setup",
    "WorkPoint",
    "WorkPrecision",
    "budget",
    "by_step",
    "by_tolerance",
    "input_output_response",
    "measure",
    "solve_ivp_peer",
    "work_precision",
]
