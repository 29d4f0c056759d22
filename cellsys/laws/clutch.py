"""Mean-field motor clutch: bond strength n and mean stretch S of one membrane node.

    n'    = k_on s(z) (1 - n) - k_off n           s(z) = 1/(1 + exp((z - h_b)/width))
    k_off = k_off0 (1 + (|f|/((n + 0.02) F_b))^2) f = k_b S
    S'    = n (v_matrix - v_cell + v_m e_r) - k_off S

Smooth kinetics of this project, for many bonds per node [notes: mechanics, clutch].
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
