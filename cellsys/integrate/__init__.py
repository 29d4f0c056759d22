"""Integrator objects and `simulate`: problem, method, data, in that order."""

from cellsys.integrate.explicit import ExplicitEuler, stability_limit
from cellsys.integrate.linearly_implicit import LinearlyImplicit
from cellsys.integrate.scipy_methods import DOP853, LSODA, Radau
from cellsys.integrate.simulate import simulate
from cellsys.integrate.symbolic import CVODES, RungeKutta4

__all__ = [
    "CVODES",
    "DOP853",
    "LSODA",
    "ExplicitEuler",
    "LinearlyImplicit",
    "Radau",
    "RungeKutta4",
    "simulate",
    "stability_limit",
]
