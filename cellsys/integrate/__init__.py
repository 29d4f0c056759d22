"""Integrator objects and `simulate`: problem, method, data, in that order."""

from cellsys.integrate.explicit import ExplicitEuler, stability_limit
from cellsys.integrate.linearly_implicit import LinearlyImplicit
from cellsys.integrate.simulate import simulate
from cellsys.integrate.symbolic import CVODES, RungeKutta4

__all__ = [
    "CVODES",
    "ExplicitEuler",
    "LinearlyImplicit",
    "RungeKutta4",
    "simulate",
    "stability_limit",
]
