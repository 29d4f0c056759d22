"""Commands that bring cells to a target: on the reduced loop, and on the full-order model."""

import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import DimensionError, ParameterError
from tests.cell import runs
from tests.loop.systems import make
from tests.population.test_equivariant_cells import PAIR, cells
from tests.population.test_equivariant_cells import model as equivariant
from tests.population.test_integrators import disc

FREE = {"amplitude": (0.2, 2.0), "turning": 0.1}


def loop(seed=3):
    return cs.closed_loop(equivariant(seed=seed))


def driven(found, m):
    """The model itself under the commands, a step at a time."""
    t = 0.5 * (found.times[1:] + found.times[:-1])
    a, h = (np.interp(t, found.t, v[:, 0]) for v in (found.amplitude, found.heading))
    z0 = m.z_start.copy()
    z0[-2:] = found.places[0, 0]
    return m.simulate_commands(z0, a, h)[:, -2:]


def test_a_place_and_a_heading_in_reach():
    one = loop()
    far = cs.steer(one, cs.Target(place=[1e3, 0.0]), horizon=300.0, **FREE)
    reach = np.linalg.norm(far.places[-1] - far.places[0])
    assert far.verdict == "will not reach"
    aim = np.array([0.2, -0.4]) * reach
    target = cs.Target(place=aim, heading=1.0, within=0.01 * reach)
    found = cs.steer(one, target, horizon=300.0, **FREE)
    assert found.miss.place < 1e-2 * target.within
    assert found.miss.heading < 1e-6
    assert found.verdict == "may reach"  # the model has no bands
    known = driven(found, one.model)
    # The same places from the model's own roll-out.
    assert np.abs(known - found.places[:, 0]).max() < 1e-9 * reach
    assert found.amplitude.min() >= 0.2 - 1e-6
    assert found.amplitude.max() <= 2.0 + 1e-6
    assert np.abs(np.diff(found.heading[:, 0])).max() <= 0.1 * 20.0 + 1e-6
    told = found.commands[0]
    assert told.heading(300.0) == found.heading[-1, 0]
    plain = cs.steer(one, target, ["heading"], horizon=300.0, **FREE)
    assert np.abs(plain.amplitude - 1.0).max() < 1e-6
    moved = cs.steer(
        one, cs.Target(place=aim + 50.0, within=0.01 * reach), horizon=300.0,
        start=[50.0, 50.0], **FREE,
    )  # fmt: skip
    assert np.abs(moved.places[0, 0] - 50.0).max() < 1e-9
    assert moved.miss.place < 1e-2 * target.within


def test_an_obstacle_is_gone_around():
    one = loop()
    far = cs.steer(one, cs.Target(place=[1e3, 0.0]), horizon=300.0, **FREE)
    reach = float(far.places[-1, 0, 0] - far.places[0, 0, 0])
    target = cs.Target(place=[0.5 * reach, 0.0], within=0.02 * reach)
    straight = cs.steer(one, target, horizon=300.0, **FREE)
    x, y = straight.places[6, 0].tolist()  # naive: the straight way goes through it
    spot = cs.Obstacle(center=(x, y), radius=0.05 * reach)
    found = cs.steer(one, target, horizon=300.0, avoid=[spot], **FREE)
    assert found.miss.place < target.within
    assert found.clear > -0.3 * spot.radius  # looked at 15 times along the way


@pytest.mark.slow
def test_two_cells_to_a_gap():
    pair = cells(equivariant(vertices=1, field=disc()), disc(), PAIR)
    apart = np.linalg.norm(PAIR[1] - PAIR[0])
    line = (PAIR[1] - PAIR[0]) / apart
    ways = [cs.steer(pair, cs.Target(gap=g), horizon=200.0, pieces=4, **FREE) for g in (1e-3, 1e3)]
    ends = [float(line @ (w.places[-1, 1] - w.places[-1, 0])) for w in ways]
    gap = 0.5 * (ends[0] + ends[1])
    found = cs.steer(pair, cs.Target(gap=gap, within=0.01), horizon=200.0, pieces=4, **FREE)
    assert abs(found.miss.gap) < 1e-3
    with pytest.raises(DimensionError, match="target: place is of 1"):
        cs.steer(pair, cs.Target(place=[0.0, 0.0]), horizon=200.0, pieces=4)


def test_a_plain_model_with_a_map_to_its_place():
    one = make(names=("cell1.amplitude", "cell1.cos", "cell1.sin"), seed=2)
    place = np.zeros((2, 1 + one.order))
    place[0, 1], place[1, 2] = 1.0, 1.0
    far = cs.steer(one, cs.Target(place=[50.0, 0.0]), horizon=150.0, place=place, **FREE)
    target = cs.Target(place=0.5 * (far.places[0, 0] + far.places[-1, 0]), within=0.02)
    found = cs.steer(one, target, horizon=150.0, place=place, **FREE)
    assert found.miss.place < 0.02
    with pytest.raises(ParameterError, match="give place="):
        cs.steer(one, target, horizon=150.0)


@pytest.mark.slow
def test_on_the_full_order_model_the_miss_is_told(tmp_path):
    one = cs.closed_loop(runs.model())
    target = cs.Target(place=[0.1, 0.1], heading=1.0)
    found = cs.steer(
        one, target, horizon=60.0, pieces=3, turning=0.02, scene=runs.scene(), folder=str(tmp_path)
    )
    full = found.full
    assert full.run.t[-1] == 60.0
    # Placed on the grid of nodes, and the cell's own shape: within half a micrometre.
    assert np.abs(full.places[0] - found.places[0]).max() < 0.5
    off = np.linalg.norm(full.places[-1, 0] - target.place[0])
    assert abs(full.miss.place - off) < 1e-12
    assert full.miss.heading < 1e-6  # a commanded heading is kept
    assert "full order" in str(found)
    assert found.scene(runs.scene()).duration == 60.0


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"inputs": ["external_strain", "amplitude"]}, "edge of the matrix"),
        ({"inputs": ["amplitude"]}, "inputs must be"),
        ({"horizon": -1.0}, "horizon"),
        ({"horizon": 310.0}, "whole number of steps"),
        ({"amplitude": (2.0, 1.0)}, "amplitude"),
        ({"turning": -1.0}, "turning"),
    ],
)
def test_refusals(more, words):
    with pytest.raises(ParameterError, match=words):
        cs.steer(loop(), cs.Target(place=[1.0, 0.0]), **{"horizon": 300.0, **more})


def test_targets_and_obstacles_are_checked():
    for call, words in (
        (lambda: cs.Target(), "place, heading or gap"),
        (lambda: cs.Target(gap=-1.0), "gap"),
        (lambda: cs.Obstacle(center=(0.0, 0.0), radius=0.0), "radius"),
    ):
        with pytest.raises(ParameterError, match=words):
            call()
    with pytest.raises(DimensionError, match="place"):
        cs.Target(place=[1.0, 2.0, 3.0])
    with pytest.raises(DimensionError, match="start"):
        cs.steer(loop(), cs.Target(place=[1.0, 0.0]), horizon=300.0, start=[1.0])
