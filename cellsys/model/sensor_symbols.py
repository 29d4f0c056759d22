"""Sensors on CasADi expressions: the same directions, with derivatives."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cellsys.model.network_sensor import LocalSensor
from cellsys.model.sensor import StiffnessSensor
from cellsys.model.stiffness_map import StiffnessMap

if TYPE_CHECKING:
    import casadi as ca


def raw_symbols(sensor: StiffnessSensor, z: ca.MX, K_d: ca.MX, gain: ca.MX) -> ca.MX:
    """`sensor.raw` (3, 1) of z (m, 1), with K_d as given and all but its intercept times `gain`.

    A `LocalSensor` sums over the nodes of its map, as a whole vector.
    """
    import casadi as ca

    more = ca.mtimes(K_d[:, 1:], z)
    if isinstance(sensor, LocalSensor):
        place, m = z[-2:], z.numel()
        at_rest = ca.MX.zeros(2, 1)
        if sensor.K_s.any() or sensor.a:
            at_rest = _moment(sensor.map, place)
        if sensor.K_s.any():
            known = at_rest if sensor.map.contrasts else unit_symbols(at_rest)
            more = more + ca.mtimes(ca.DM(sensor.K_s), known)
        if sensor.K_t.any():
            M = ca.DM(sensor.M)
            q = M[:, 0] + ca.mtimes(M[:, 1 : m + 1], z) + sensor.a * at_rest
            more = more + ca.mtimes(ca.DM(sensor.K_t), unit_symbols(q))
        if sensor.K_q.any():
            x, y = place[0], place[1]
            more = more + ca.mtimes(ca.DM(sensor.K_q), ca.vertcat(x * x, x * y, y * y))
    return K_d[:, 0] + gain * more


def unit_symbols(v: ca.MX) -> ca.MX:
    """v/|v|; zero stays zero."""
    import casadi as ca

    return v / ca.sqrt(ca.dot(v, v) + 1e-300)


def _moment(known: StiffnessMap, place: ca.MX) -> ca.MX:
    """`StiffnessMap.moment` (2, 1)."""
    import casadi as ca

    x, y = (ca.DM(known.nodes[:, i]) - place[i] for i in range(2))
    rho = ca.sqrt(x * x + y * y + 1e-12)
    q = ca.fmin(ca.fmax(rho - (known.reach - 1.0), 0.0), 1.0)
    window, stiffness = 1.0 - q * q * (3.0 - 2.0 * q), ca.DM(known.stiffness)
    weight = window * stiffness
    if known.contrasts:
        total, whole = ca.sum1(window), ca.sum1(weight)
        there = ca.logic_and(total > 0, whole > 0)
        above = window * (stiffness - whole / ca.if_else(there, total, 1.0)) / rho
        found = ca.vertcat(ca.dot(above, x), ca.dot(above, y)) / ca.if_else(there, whole, 1.0)
        return ca.if_else(there, found, ca.MX.zeros(2, 1))
    moment = ca.vertcat(ca.dot(weight, x / rho), ca.dot(weight, y / rho))
    large = ca.dot(moment, moment) > (1e-12 * ca.sum1(ca.fabs(weight))) ** 2
    return ca.if_else(large, moment, ca.MX.zeros(2, 1))
