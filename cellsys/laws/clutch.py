"""Mean-field motor clutch: bond strength n and mean stretch S of one membrane node.

    n'    = k_on s(z) (1 - n) - k_off n           s(z) = 1/(1 + exp((z - h_b)/width))
    k_off = k_off0 (1 + (|f|/((n + 0.02) F_b))^2) f = k_b S
    S'    = n (v_matrix - v_cell + v_m e_r) - k_off S

A clutch that carries more than its own stretch, such as the reaction r of a protrusion, has
f = k_b S + r. Smooth kinetics of this project, for many bonds per node [notes: mechanics, clutch].
"""

from __future__ import annotations

import numpy as np

from cellsys.laws.arrays import Values

_FLOOR = 0.02  # keeps the load per bond finite as n -> 0


def binding_rate(z: Values, k_on: float, height: float, width: float) -> Values:
    """k_on s(z), 1/s, at height z (um) above the substrate; elementwise."""
    return k_on / (1.0 + np.exp(np.minimum((z - height) / width, 60.0)))


def unbinding_rate(n: Values, load: Values, k_off0: float, f_b: float) -> Values:
    """k_off, 1/s, for bond strength n and load |f| (pN); elementwise."""
    ratio = load / ((n + _FLOOR) * f_b)
    return k_off0 * (1.0 + ratio * ratio)


def reinforced_rate(k_off0: float, stiffness: Values, alpha: float, k_half: float) -> Values:
    """Unloaded unbinding of a clutch on a matrix of a local stiffness k; elementwise.

    k_off0 (1 + alpha k_half/(k + k_half)): bonds live 1 + alpha times shorter where the matrix
    gives way, and as long as `k_off0` says where it is stiff [notes: mechanics, clutch]. k and
    k_half in one unit.
    """
    return k_off0 * (1.0 + alpha * k_half / (stiffness + k_half))
