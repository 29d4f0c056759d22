"""The loop and the sensor as printed, beside what is fitted instead."""

import dataclasses

import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import DimensionError, NotSymbolicError, ParameterError
from tests.loop.systems import heading
from tests.population.systems import model

DEGREES = np.radians(np.arange(360))
METHOD = cs.DOP853(rtol=1e-6, atol=1e-8)


def table(lookup="interpolate"):
    """Two nodes whose patterns are harmonics of the heading."""
    rng = np.random.default_rng(0)
    waves = np.array([f(k * DEGREES) for k in (1, 2) for f in (np.cos, np.sin)])
    M = rng.standard_normal((6, 4))
    return M, cs.MPol(M @ waves, lookup)


def both(lookup, angle=2.0):
    """The literal loop, and the fitted form that has the same inputs exactly."""
    M, pol = table(lookup)
    one = model(m=4, steered=True)
    loop = cs.literal_loop(one, pol, force=6.0, drag=10.0, p0=heading(angle))
    same = dataclasses.replace(one, B=one.V_x[:6].T @ M * 0.6)
    return loop, cs.closed_loop(same, p0=heading(angle))


def test_the_push_is_the_projected_table():
    loop, _ = both("nearest")
    u = loop.input_map.table[:, 57] * 6.0 / 10.0
    known = loop.model.V_x[:6].T @ u
    np.testing.assert_allclose(loop.push(heading(np.radians(57.2))), known, atol=1e-15)


def test_lookups_and_what_they_cost():
    t, miss = np.linspace(0.0, 60.0, 13), {}
    for lookup in ("interpolate", "nearest", "arctan"):
        loop, smooth = both(lookup)
        known = smooth.simulate(t, cs.DOP853(rtol=1e-9, atol=1e-10))
        run = loop.simulate(t, METHOD)
        miss[lookup] = np.abs(run.x - known.x).max()
    # Linear between degrees: (pi/180)^2/8 of the second derivative; nearest: half a degree.
    assert miss["interpolate"] < 1e-3
    assert miss["interpolate"] < miss["nearest"]
    p = heading(-1.0)
    printed, signed = (both(kind, -1.0)[0].push(p) for kind in ("arctan", "nearest"))
    above = both("nearest", 1.0)[0].push(heading(1.0))
    np.testing.assert_array_equal(printed, above)  # as printed: no sign
    assert np.abs(printed - signed).max() > 0.1 * np.abs(signed).max()


def test_refusals():
    loop, _ = both("interpolate")
    with pytest.raises(NotSymbolicError, match="harmonics"):
        loop.simulate([0.0, 1.0], cs.CVODES(rtol=1e-6, atol=1e-6))
    _, pol = table()
    one = model(m=4, steered=True)
    with pytest.raises(ParameterError, match="drag"):
        cs.literal_loop(one, pol, force=1.0, drag=0.0)
    with pytest.raises(DimensionError, match="rows"):
        cs.literal_loop(one, pol, force=1.0, drag=1.0, rows=np.arange(5))
    with pytest.raises(ParameterError, match="no sensor"):
        cs.literal_loop(dataclasses.replace(one, sensor=None), pol, force=1.0, drag=1.0)
    with pytest.raises(ParameterError, match="'arctan'"):
        cs.MPol(pol.table, "round")


def test_the_sensor_on_forces_and_centre_is_one_on_z():
    rng = np.random.default_rng(1)
    m = 5
    P_F, P_c = (v @ v.T for v in (rng.standard_normal((m, 3)), rng.standard_normal((m, 1))))
    K = rng.standard_normal((3, 2 * m))
    latent = [rng.standard_normal((30, m)) for _ in range(3)]
    d = [1.0 + z @ np.vstack([P_F, P_c]).T @ K.T for z in latent]
    found = cs.fit_sensor(latent, d, literal=True, maps=(P_F, P_c))
    # Exactly representable by the printed regressors, rank 4 of 10.
    np.testing.assert_allclose(found.raw(latent[0]), d[0], atol=1e-10)
    free = [z[:, :1] * np.ones(3) for z in latent]
    blind = cs.fit_sensor(latent, free, literal=True, maps=(P_c, P_c))
    full = cs.fit_sensor(latent, free, ridges=(0.0,))
    assert np.abs(full.raw(latent[0]) - free[0]).max() < 1e-10
    assert np.abs(blind.raw(latent[0]) - free[0]).max() > 0.1  # what the regressors leave out
    with pytest.raises(ParameterError, match="go together"):
        cs.fit_sensor(latent, d, literal=True)
    with pytest.raises(DimensionError, match="maps"):
        cs.fit_sensor(latent, d, literal=True, maps=(P_F[:2], P_c))
