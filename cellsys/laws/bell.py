"""Bell kinetics of a bond cluster: mean bond number n_b and rest length of its bonds.

    dn_b/dt = k_on (n_max - n_b) - k_off n_b ,   k_off = k_0 exp(min(f/f_b, 12))
    dL_r/dt = -v_m max(0, 1 - f/f_st)            L_r >= lambda

f is the load of one bond, pN. Elementwise; numpy or numba [notes: mechanics, clusters].
"""

from __future__ import annotations

import numpy as np

from cellsys.laws.arrays import Values

CAP = 12.0  # greatest f/f_b in the exponent: such a cluster is gone within a millisecond


def bell_off_rate(load: Values, k_0: float, f_b: float) -> Values:
    """k_off, 1/s, of one bond under `load` (pN)."""
    return k_0 * np.exp(np.minimum(load / f_b, CAP))


def bond_number_rate(
    n: Values, load: Values, k_on: float, k_0: float, n_max: float, f_b: float
) -> Values:
    """dn_b/dt, 1/s."""
    return k_on * (n_max - n) - bell_off_rate(load, k_0, f_b) * n


def bond_number_step(
    n: Values, load: Values, dt: float, k_on: float, k_0: float, n_max: float, f_b: float
) -> Values:
    """n_b after dt at constant load: exact exponential, whatever k_off dt."""
    total = k_on + bell_off_rate(load, k_0, f_b)
    rest = k_on * n_max / total
    return rest + (n - rest) * np.exp(-total * dt)


def contraction_rate(load: Values, v_m: float, f_st: float) -> Values:
    """dL_r/dt, um/s: myosin shortens a bond until its load reaches the stall force."""
    return -v_m * np.maximum(0.0, 1.0 - load / f_st)


def contraction_step(
    length: Values, rest: Values, dt: float, stiffness: float, v_m: float, f_st: float, least: float
) -> Values:
    """L_r after dt at constant bond length: exact, floored at `least`.

    The stretch g = length - L_r grows at v_m while slack (g < 0), then relaxes towards
    f_st/stiffness with the rate v_m stiffness/f_st; beyond stall it stays.
    """
    stretch = length - rest
    slack = np.minimum(np.maximum(-stretch, 0.0), v_m * dt)
    stretch = stretch + slack
    left = dt - slack / v_m if v_m > 0.0 else 0.0 * slack
    stall = f_st / stiffness
    short = np.maximum(stall - stretch, 0.0)
    # A bond that is still slack has left = 0, so nothing more happens to it.
    stretch = stretch + short * (1.0 - np.exp(-v_m * left / stall))
    return np.minimum(rest, np.maximum(length - stretch, least))
