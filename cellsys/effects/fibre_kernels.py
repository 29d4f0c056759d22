"""Compiled loops over the fibres; the law itself is `cellsys.laws.fibre.axial`."""

from __future__ import annotations

import numpy as np

from cellsys.compiled import compiled
from cellsys.laws.fibre import axial, axial_energy

_axial = compiled(vector=True, inline=True)(axial)
_axial_energy = compiled(vector=True, inline=True)(axial_energy)
_PIECE = 256  # fibres at a time: their differences stay in the first cache


@compiled(vector=True)
def fibre_forces(rest, u, fibres, length, stiffness, rho, blend, onset, growth, force):
    """Add nodal forces of all fibres to `force` (n, 3), pN.

    rest, u : (n, 3) rest positions and displacements, um. The law, with its roots and divisions,
    runs over pieces of the list in a loop of its own, without indirect addresses.
    """
    now = rest + u
    d0, d1, d2, f = np.empty(_PIECE), np.empty(_PIECE), np.empty(_PIECE), np.empty(_PIECE)
    for begin in range(0, fibres.shape[0], _PIECE):
        ends = fibres[begin : begin + _PIECE]
        l0, k = length[begin : begin + _PIECE], stiffness[begin : begin + _PIECE]
        for c in range(len(ends)):
            # Unsigned: no test for an index that counts from the end.
            i, j = np.uintp(ends[c, 0]), np.uintp(ends[c, 1])
            d0[c] = now[j, 0] - now[i, 0]
            d1[c] = now[j, 1] - now[i, 1]
            d2[c] = now[j, 2] - now[i, 2]
        for c in range(len(ends)):
            reach = np.sqrt(d0[c] * d0[c] + d1[c] * d1[c] + d2[c] * d2[c] + 1e-12)
            g, _ = _axial((reach - l0[c]) / l0[c], rho, blend, onset, growth)
            f[c] = k[c] * l0[c] * g / reach
        for c in range(len(ends)):
            i, j = np.uintp(ends[c, 0]), np.uintp(ends[c, 1])
            f0, f1, f2 = f[c] * d0[c], f[c] * d1[c], f[c] * d2[c]
            force[i, 0] += f0
            force[i, 1] += f1
            force[i, 2] += f2
            force[j, 0] -= f0
            force[j, 1] -= f1
            force[j, 2] -= f2


@compiled(vector=True)
def fibre_slopes(rest, u, fibres, length, stiffness, rho, blend, onset, growth, slope, tension):
    """Fill the tangent slope g' (-) and the tension f (pN, positive pulls) of every fibre."""
    now = rest + u
    squared = np.empty(_PIECE)
    for begin in range(0, fibres.shape[0], _PIECE):
        ends = fibres[begin : begin + _PIECE]
        l0, k = length[begin : begin + _PIECE], stiffness[begin : begin + _PIECE]
        slopes, pull = slope[begin : begin + _PIECE], tension[begin : begin + _PIECE]
        for c in range(len(ends)):
            i, j = np.uintp(ends[c, 0]), np.uintp(ends[c, 1])
            d0, d1, d2 = now[j, 0] - now[i, 0], now[j, 1] - now[i, 1], now[j, 2] - now[i, 2]
            squared[c] = d0 * d0 + d1 * d1 + d2 * d2 + 1e-12
        for c in range(len(ends)):
            g, slopes[c] = _axial((np.sqrt(squared[c]) - l0[c]) / l0[c], rho, blend, onset, growth)
            pull[c] = k[c] * l0[c] * g


@compiled(vector=True)
def fibre_energy(rest, u, fibres, length, stiffness, rho, blend, onset, growth):
    """Sum of k l0^2 G(strain) over all fibres, pN um."""
    now = rest + u
    total = 0.0
    squared = np.empty(_PIECE)
    for begin in range(0, fibres.shape[0], _PIECE):
        ends = fibres[begin : begin + _PIECE]
        l0, k = length[begin : begin + _PIECE], stiffness[begin : begin + _PIECE]
        for c in range(len(ends)):
            i, j = np.uintp(ends[c, 0]), np.uintp(ends[c, 1])
            d0, d1, d2 = now[j, 0] - now[i, 0], now[j, 1] - now[i, 1], now[j, 2] - now[i, 2]
            squared[c] = d0 * d0 + d1 * d1 + d2 * d2 + 1e-12
        for c in range(len(ends)):
            e = np.sqrt(squared[c]) / l0[c] - 1.0
            total += k[c] * l0[c] * l0[c] * _axial_energy(e, rho, blend, onset, growth)
    return total
