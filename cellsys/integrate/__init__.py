"""Integrator objects and `simulate`: problem, method, data, in that order."""

from cellsys.integrate.bdf2 import BDF2
from cellsys.integrate.explicit import ExplicitEuler, stability_limit
from cellsys.integrate.exponential import Exponential
from cellsys.integrate.linearly_implicit import LinearlyImplicit
from cellsys.integrate.parameter_sensitivities import (
    ParametricSystem,
    Sensitivities,
    end_gradient,
    parameter_sensitivities,
    pole_sensitivities,
)
from cellsys.integrate.rkc import RKC
from cellsys.integrate.scipy_methods import DOP853, LSODA, Radau
from cellsys.integrate.simulate import simulate
from cellsys.integrate.splitting import Splitting
from cellsys.integrate.step_runs import StepRun
from cellsys.integrate.stepping import Stepper
from cellsys.integrate.symbolic import CVODES, IDAS, Collocation, RungeKutta4
from cellsys.renamed import old_names

__getattr__ = old_names(__name__)

__all__ = [
    "BDF2",
    "CVODES",
    "DOP853",
    "IDAS",
    "LSODA",
    "RKC",
    "Collocation",
    "ExplicitEuler",
    "Exponential",
    "LinearlyImplicit",
    "ParametricSystem",
    "Radau",
    "RungeKutta4",
    "Sensitivities",
    "Splitting",
    "StepRun",
    "Stepper",
    "end_gradient",
    "parameter_sensitivities",
    "pole_sensitivities",
    "simulate",
    "stability_limit",
]
