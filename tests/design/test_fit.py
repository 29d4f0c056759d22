"""Parameters from recordings: recovered with honest intervals, or refused."""

import dataclasses

import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import DataError, DimensionError, ParameterError, RankError
from tests.loop.systems import heading, make
from tests.population.systems import model
from tests.population.test_equivariant_cells import model as equivariant

T = 5.0 * np.arange(61)
METHOD = cs.DOP853(rtol=1e-9, atol=1e-9)


def turning(kappa=1 / 60, m=4, **more):
    """A loop whose heading swings by 100 degrees towards a direction that hardly moves."""
    loop = make(m=m, kappa=kappa, **more)
    K_d = 0.05 * loop.sensor.K_d
    K_d[:2, 0] = 1.0, 0.2
    return dataclasses.replace(loop, sensor=cs.StiffnessSensor(K_d=K_d), p0=heading(2.0))


def angles(loop, t=T):
    p = loop.simulate(t, METHOD).p
    return np.arctan2(p[..., 1], p[..., 0])


def noisy(truth, noise, seed, t=T, **more):
    rng = np.random.default_rng(seed)
    return cs.Recording(t=t, headings=truth + noise * rng.standard_normal(truth.shape), **more)


def test_exact_headings_give_the_parameters_back():
    truth = turning(0.02)
    found = cs.fit(turning(0.012), truth.simulate(T, METHOD))
    assert abs(found["kappa"] - 0.02) < 1e-6 * 0.02  # steps of the fit, of order 4, and of the run
    assert abs(found["heading_0"] - 2.0) < 1e-6
    assert found.rank == 2
    assert abs(found.loop.controller.kappa - found["kappa"]) == 0.0
    again = angles(found.loop)
    assert np.abs(again - angles(truth)).max() < 1e-5


def test_intervals_profile_and_residuals():
    truth = angles(turning(0.02))
    found = cs.fit(turning(), noisy(truth, 0.05, 1))
    low, high = found.interval("kappa")
    assert low < 0.02 < high
    assert 0.04 < found.noise < 0.06
    assert found.adequate
    profile = found.profiles["kappa"]
    # The problem is close to linear: the profile's interval is that of the standard error.
    assert abs(profile.low - low) < 0.1 * (high - low)
    assert abs(profile.high - high) < 0.1 * (high - low)
    known = cs.fit(turning(), noisy(truth, 0.05, 1, heading_noise=0.05), profile=False)
    assert known.spread > 0.01
    assert not known.profiles
    small = cs.fit(turning(), noisy(truth, 0.05, 1, heading_noise=0.02), profile=False)
    assert small.spread < 1e-6  # naive: noise is what was said
    assert not small.adequate
    slow = truth + 0.3 * np.sin(T / 40.0)[:, None]
    bent = cs.fit(turning(), noisy(slow, 0.02, 1), profile=False)
    assert bent.whiteness < 1e-6
    assert "FAIL" in str(bent)


def test_pieces_find_their_way_and_missing_samples_are_left_out():
    truth = angles(turning(0.05))
    data = noisy(truth, 0.05, 2)
    one, many = (cs.fit(turning(0.002), data, pieces=k, profile=False) for k in (1, 4))
    assert abs(one["kappa"] - many["kappa"]) < 1e-4 * one["kappa"]
    assert many.spent["pieces"] == 4
    assert cs.fit(turning(0.002), data, profile=False).spent["pieces"] == 4  # starts too far off
    holed = np.array(data.headings)
    holed[5:20] = np.nan
    some = cs.fit(turning(), cs.Recording(t=T, headings=holed), profile=False)
    assert some.samples == len(T) - 15
    low, high = some.interval("kappa", 0.999)
    assert low < 0.05 < high


def test_two_parameters_and_places():
    loop = turning(0.02, normalise=False, gain=4.0)
    place = np.zeros((2, 1 + loop.order))
    place[0, 1], place[1, 2] = 3.0, 3.0
    z = loop.simulate(T, METHOD).x[:, : loop.order]
    seen = place[:, 0] + z @ place[:, 1:].T
    rng = np.random.default_rng(3)
    both = cs.Recording(
        t=T,
        headings=angles(loop)[:, 0] + 0.02 * rng.standard_normal(len(T)),
        positions=seen + 0.02 * rng.standard_normal(seen.shape),
        heading_noise=0.02,
        position_noise=0.02,
    )
    start = dataclasses.replace(loop, controller=cs.PolarityLaw(0.03))
    found = cs.fit(start, both, ["kappa", "sensor.gain"], place=place, profile=False)
    for name, true in (("kappa", 0.02), ("sensor.gain", 1.0)):
        low, high = found.interval(name, 0.999)
        assert low < true < high
    alone = cs.fit(start, cs.Recording(t=T, positions=both.positions), place=place, profile=False)
    low, high = alone.interval("kappa", 0.999)
    assert low < 0.02 < high
    with pytest.raises(ParameterError, match="place="):
        cs.fit(start, both)
    with pytest.raises(ParameterError, match="must both be given"):
        dataclasses.replace(both, position_noise=None)


def test_every_cell_has_its_kappa():
    cells = cs.couple(
        model(m=3, steered=True), 2, headings=[0.0, 1.5], controller=cs.PolarityLaw(0.02)
    )
    truth = cells.simulate(T, METHOD).p
    data = cs.Recording(t=T, headings=np.arctan2(truth[..., 1], truth[..., 0]))
    found = cs.fit(cells, data, per_cell=True, profile=False)
    assert found.names == ("cell1_kappa", "cell2_kappa", "cell1_heading_0", "cell2_heading_0")
    np.testing.assert_allclose(found.estimates[:2], 0.02, rtol=2e-2)  # steps leave 2 mrad
    assert found.loop is None
    with pytest.raises(DimensionError, match="cells"):
        cs.fit(cells, cs.Recording(t=T, headings=truth[:, 0, 0]))


def test_a_scheduled_loop():
    m = equivariant(seed=3)
    K_d = 0.02 * m.sensor.K_d
    K_d[:2, 0] = 1.0, 0.2
    sensor = cs.StiffnessSensor(K_d=K_d)
    t = m.dt * np.arange(31)

    def made(kappa):
        law = cs.PolarityLaw(kappa)
        return cs.closed_loop(m, controller=law, sensor=sensor, p0=heading(2.0))

    run = made(0.02).simulate(t)
    found = cs.fit(made(0.01), run, profile=False)
    assert abs(found["kappa"] - 0.02) < 1e-7  # the same step
    with pytest.raises(ParameterError, match="multiple of the loop's step"):
        cs.fit(made(0.01), cs.Recording(t=0.7 * t, headings=run.p[:, 0, 0]))


def test_what_the_data_do_not_excite_is_refused():
    loop = turning()
    still = dataclasses.replace(loop, p0=heading(np.arctan2(0.2, 1.0)))
    flat = noisy(angles(still), 0.05, 4)
    with pytest.raises(RankError, match=r"kappa: rank 1 of 2, condition"):
        cs.fit(still, flat)
    data = noisy(angles(loop), 0.05, 4)
    bare = loop.sensor.K_d.copy()
    bare[:, 1:] = 0.0
    blind = dataclasses.replace(loop, sensor=cs.StiffnessSensor(K_d=bare))
    with pytest.raises(RankError, match=r"sensor.gain"):
        cs.fit(blind, data, ["kappa", "sensor.gain"])
    for call, error, words in (
        (lambda: cs.fit(loop, data, ["speed"]), ParameterError, "parameters"),
        (lambda: cs.fit(loop, data, []), ParameterError, "parameters"),
        (lambda: cs.fit(loop, data, ["K_d[9,9]"]), ParameterError, "parameters"),
        (lambda: cs.fit(loop, data, level=2.0), ParameterError, "level"),
        (lambda: cs.fit(loop, data, pieces=7), ParameterError, "pieces"),
        (lambda: cs.Recording(t=T), DataError, "headings or positions"),
        (lambda: cs.Recording(t=T**2, headings=T), DataError, "evenly"),
        (lambda: cs.Recording(t=T, headings=T[:5]), DimensionError, "headings"),
        (lambda: cs.Recording(t=T, headings=np.full(61, np.nan)), DataError, "less than 3"),
        (lambda: cs.Recording(t=T, headings=T, heading_noise=0.0), ParameterError, "noise"),
    ):
        with pytest.raises(error, match=words):
            call()


@pytest.mark.slow
def test_intervals_cover_what_they_say():
    truth, loop, inside = angles(turning(0.02)), turning(0.015), 0
    for seed in range(100):
        found = cs.fit(loop, noisy(truth, 0.1, 100 + seed), profile=False)
        low, high = found.interval("kappa")
        inside += low <= 0.02 <= high
    # 95 expected, 2.2 is one standard deviation of the count.
    assert 88 <= inside <= 100
    print(inside)
