"""Compiled loops over the fibres; the law itself is `cellsys.laws.fibre.axial`."""

from __future__ import annotations

import numpy as np

from cellsys.laws.fibre import axial
from cellsys.mechanics.compiled import compiled

_axial = compiled(axial)


@compiled
def fibre_forces(rest, u, fibres, length, stiffness, rho, blend, onset, growth, force):
    """Add nodal forces of all fibres to `force` (n, 3), pN.

    rest, u : (n, 3) rest positions and displacements, um.
    """
    for k in range(fibres.shape[0]):
        i, j = fibres[k, 0], fibres[k, 1]
        d0 = rest[j, 0] + u[j, 0] - rest[i, 0] - u[i, 0]
        d1 = rest[j, 1] + u[j, 1] - rest[i, 1] - u[i, 1]
        d2 = rest[j, 2] + u[j, 2] - rest[i, 2] - u[i, 2]
        now = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2 + 1e-12)
        l0 = length[k]
        g, _ = _axial((now - l0) / l0, rho, blend, onset, growth)
        f = stiffness[k] * l0 * g / now
        force[i, 0] += f * d0
        force[i, 1] += f * d1
        force[i, 2] += f * d2
        force[j, 0] -= f * d0
        force[j, 1] -= f * d1
        force[j, 2] -= f * d2


@compiled
def fibre_slopes(rest, u, fibres, length, stiffness, rho, blend, onset, growth, slope, tension):
    """Fill the tangent slope g' (-) and the tension f (pN, positive pulls) of every fibre."""
    for k in range(fibres.shape[0]):
        i, j = fibres[k, 0], fibres[k, 1]
        d0 = rest[j, 0] + u[j, 0] - rest[i, 0] - u[i, 0]
        d1 = rest[j, 1] + u[j, 1] - rest[i, 1] - u[i, 1]
        d2 = rest[j, 2] + u[j, 2] - rest[i, 2] - u[i, 2]
        now = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2 + 1e-12)
        g, s = _axial((now - length[k]) / length[k], rho, blend, onset, growth)
        slope[k] = s
        tension[k] = stiffness[k] * length[k] * g
