"""The polarity loop on an equivariant cell."""

import numpy as np
import pytest

import cellsys as cs
from tests.cell.refined import reading, refined
from tests.cell.runs import model


def sensor(m, toward=0.5):
    """Reads a constant direction plus a little of charge 1."""
    K = np.zeros((3, 1 + m.order))
    K[:2, 0] = np.cos(toward), np.sin(toward)
    first = m.dynamics.starts()[1]
    K[0, 1 + first], K[1, 1 + first + m.dynamics.blocks[1].size] = 0.02, 0.02
    return cs.StiffnessSensor(K_d=K)


def loop(kappa=1 / 60, heading=2.0):
    m = model()
    p0 = np.array([np.cos(heading), np.sin(heading), 0.0])
    return cs.closed_loop(m, controller=cs.PolarityLaw(kappa), sensor=sensor(m), p0=p0)


def test_heading_turns_to_the_sensed_direction_and_keeps_its_length():
    run = loop().simulate(10.0 * np.arange(61))
    p, d = run.p[:, 0], run.d[:, 0]
    np.testing.assert_allclose(np.linalg.norm(p, axis=1), 1.0, atol=1e-12)
    assert p[-1] @ d[-1] > 0.999
    assert p[0] @ d[0] < 0.2


def test_without_control_it_is_the_commanded_roll_out():
    m = model()
    free = loop(kappa=1e-14)
    run = free.simulate(10.0 * np.arange(16))
    z = m.simulate_commands(free.z0, np.ones(15), np.full(15, 2.0))
    np.testing.assert_allclose(run.x[:, : m.order], z, atol=1e-9)


def test_constant_direction_is_followed_exactly():
    """The law's exact step composes: tan(theta/2) falls as exp(-kappa t)."""
    m = model()
    K = np.zeros((3, 1 + m.order))
    K[0, 0] = 1.0
    p0 = np.array([np.cos(2.0), np.sin(2.0), 0.0])
    run = cs.closed_loop(m, sensor=cs.StiffnessSensor(K_d=K), p0=p0).simulate(10.0 * np.arange(31))
    angle = np.arctan2(run.p[:, 0, 1], run.p[:, 0, 0])
    np.testing.assert_allclose(np.tan(angle / 2), np.tan(1.0) * np.exp(-run.t / 60), rtol=1e-11)


def test_frozen_loop_and_its_margins():
    m = model()
    point = loop().linearize(100.0, slower_than=1 / 150)
    assert np.all(np.isfinite(point.A))
    margins = cs.margins(loop().open_loop(point))
    assert margins.phase_margin > 0
    frozen = loop().frozen(100.0)
    assert frozen.model.input_names == m.input_names


@pytest.mark.parametrize("t", [[0.0, 7.0], [10.0, 20.0], [0.0, 20.0, 10.0]])
def test_times_off_the_grid_are_refused(t):
    with pytest.raises((cs.ParameterError, cs.DataError)):
        loop().simulate(np.array(t))


def test_an_integrator_is_refused_with_the_way_out():
    with pytest.raises(cs.ParameterError, match=r"model\.at"):
        loop().simulate(10.0 * np.arange(3), cs.CVODES(rtol=1e-8, atol=1e-8))


def test_leaving_the_trained_range_is_an_event_of_the_run():
    """The runs lasted 150 s at amplitudes the monitor knows; the naive roll-out says nothing."""
    m = model()
    assert m.monitor is not None
    inside = loop().simulate(10.0 * np.arange(15), amplitude=float(np.mean(m.monitor.amplitude)))
    assert not [e for e in inside.events if "amplitude" in e.detail or "time" in e.detail]
    late = loop().simulate(10.0 * np.arange(31), amplitude=2 * m.monitor.amplitude[1])
    told = {e.name: e for e in late.events}
    assert set(told) == {"outside the trained range"}
    assert any("amplitude (high)" in e.detail and e.time == 0.0 for e in late.events)
    assert any("time since contact" in e.detail and e.time > 150.0 for e in late.events)
    assert late.model_error["cells, held out"] == m.card.held_out["cells"]["model"]
    assert "model's error" in str(late)


def test_frozen_time_family():
    """Members are the loops frozen at their times; the schedule makes them differ."""
    found = loop().margins_along([20.0, 100.0], slower_than=1 / 150)
    assert list(found) == [20.0, 100.0]
    for t, one in found.items():
        point = loop().linearize(t, slower_than=1 / 150)
        own = cs.margins(loop().frozen(t).open_loop(point))
        assert own.phase_margin == pytest.approx(one.phase_margin, rel=1e-9)
    assert found[20.0].phase_margin != pytest.approx(found[100.0].phase_margin, rel=1e-6)
    from cellsys.figures import bode_family

    upper, lower = bode_family(found)
    assert len(upper.lines) == len(lower.lines) == 2


@pytest.mark.parametrize("gain", [0.02, 0.2, 1.0])
@pytest.mark.parametrize("kappa", [1 / 60, 1 / 15])
def test_the_estimate_covers_the_error_of_the_coupling(gain, kappa):
    """Against the same plant with sixteen steps for one: the error itself, not a second guess."""
    coarse, fine = refined(), refined(16)
    p0, t = np.array([np.cos(2.0), np.sin(2.0), 0.0]), 10.0 * np.arange(61)
    law, sensed = cs.PolarityLaw(kappa), reading(coarse, gain)
    run = cs.closed_loop(coarse, controller=law, sensor=sensed, p0=p0).simulate(t)
    exact = cs.closed_loop(fine, controller=law, sensor=sensed, p0=p0).simulate(t)
    error, told = np.abs(run.x - exact.x).max(axis=0), run.error
    n = coarse.order
    for part in (slice(n), slice(n, None)):
        assert error[part].max() <= told.absolute[part].max() <= 20 * error[part].max()
    assert error.max() > 1e-4  # there is an error to be found
    text = str(run)
    assert "integrator's error" in text
    assert "heading in 8 sub-steps" in text
