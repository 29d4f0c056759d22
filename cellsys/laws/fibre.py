"""Axial law of a matrix fibre: buckling in compression, linear, stiffening in tension.

With strain e = (l - l0)/l0 the force is f = k l0 g(e),

    g(e)  = rho e + (1 - rho) (e + sqrt(e^2 + w^2) - w)/2 + s(e)
    s(e)  = 0                                 e <  e_s
          = (e - e_s)^2/(2 e_s)               until the slope has grown by `growth`, then linear

rho = 1 and e_s = NEVER is the linear law. The slope at rest is (1 + rho)/2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellsys.laws.arrays import Values

NEVER = 1e30  # a strain no fibre reaches: finite, so that 0/onset stays 0


class FibreLaw(NamedTuple):
    """Numbers of the law: rho, blend w, onset e_s, and by how much stiffening raises the slope."""

    rho: float
    blend: float
    onset: float
    growth: float


def axial(
    e: Values, rho: float, blend: float, onset: float, growth: float
) -> tuple[Values, Values]:
    """(g, dg/de) at strain e; elementwise, dimensionless."""
    root = np.sqrt(e * e + blend * blend)
    over = np.maximum(e - onset, 0.0)
    inner = np.minimum(over, growth * onset)
    g = rho * e + 0.5 * (1.0 - rho) * (e + root - blend)
    g = g + 0.5 * inner * inner / onset + growth * (over - inner)
    slope = rho + 0.5 * (1.0 - rho) * (1.0 + e / root) + inner / onset
    return g, slope


def axial_energy(e: Values, rho: float, blend: float, onset: float, growth: float) -> Values:
    """Integral of g from 0 to e; elementwise, dimensionless."""
    root = np.sqrt(e * e + blend * blend)
    over = np.maximum(e - onset, 0.0)
    inner = np.minimum(over, growth * onset)
    past = over - inner
    value = 0.5 * (e * root + blend * blend * np.arcsinh(e / blend))
    value = 0.5 * rho * e * e + 0.5 * (1.0 - rho) * (0.5 * e * e + value - blend * e)
    value = value + inner * inner * inner / (6.0 * onset)
    return value + 0.5 * inner * inner / onset * past + 0.5 * growth * past * past
