"""Switching: at once, at the ends, grazing, chattering, Zeno, nearer than rounding, shifts."""

import numpy as np
import pytest

from cellsys.errors import IntegrationError
from cellsys.integrate import DOP853, LSODA, Radau, simulate
from cellsys.mechanics.crawler import Chain, Crawler, build_crawlers
from cellsys.system import EventFunction
from tests import naive
from tests.hard.stress import SEED, Case, Choice, Int, Power, Real, hold
from tests.integrate.test_hybrid import Hybrid, ball
from tests.mechanics.small_scenes import tiny_system

METHODS = Choice(DOP853, LSODA, Radau)


def clock(times, method, *, jump=1.0, end=10.0):
    """x' = 1 with events where x passes each time; each reset adds `jump` to a counter."""

    def event(k, at):
        return EventFunction(
            name=f"e{k}",
            guard=lambda t, x: x[0] - at,
            direction=1,
            reset=lambda t, x: x + np.array([0.0, jump]),
        )

    system = Hybrid(
        [event(k, at) for k, at in enumerate(times)],
        states=["x", "n"], x0=[0.0, 0.0], forcing=lambda t, x: np.array([1.0, 0.0]),
    )  # fmt: skip
    return simulate(system, method(rtol=1e-8, atol=1e-10), [0.0, end], auxiliaries=False)


def events_however_close_all_happen(first, gap, count, method):
    """`count` events `gap` apart, down to nothing: each once, in order, at its time."""
    times = first + gap * np.arange(count)
    run = clock(times, method)
    assert run.x[-1, 1] == count
    assert len({e.name for e in run.events}) == count
    found = np.array([e.time for e in run.events])
    assert np.all(np.diff(found) >= 0)
    assert np.abs(np.sort(found) - times).max() < 1e-8


def test_simultaneous_events():
    events_however_close_all_happen(3.0, 0.0, 4, DOP853)
    events_however_close_all_happen(3.0, 1e-17, 3, LSODA)
    # naive: guards looked at after fixed steps, one event a step at the step's end
    assert abs(naive.fixed_step_crossing(3.0, 0.7) - 3.0) > 0.3


@pytest.mark.parametrize("method", [DOP853, LSODA, Radau])
def test_at_the_start_and_at_the_end(method):
    """At t = 0 a crossing guard stands on zero and does not fire twice; at the end it is there."""
    run = clock([5.0], method, end=5.0)
    assert len(run.events) <= 1
    later = clock([5.0], method, end=5.0 + 1e-9)
    assert len(later.events) == 1
    # naive: a clock read every 0.7 s finds the event after the end
    assert naive.fixed_step_crossing(5.0, 0.7) > 5.0 + 1e-9
    at_zero = clock([0.0], method)
    assert len(at_zero.events) <= 1
    assert at_zero.x[-1, 0] == pytest.approx(10.0, abs=1e-7)


def a_grazing_guard_is_seen_or_not_by_its_depth(depth, method):
    """cos t - 1 + depth falls below zero for 2 sqrt(2 depth) s at t = pi-periodic lows."""
    event = EventFunction(name="low", guard=lambda t, x: x[0], direction=-1, reset=None)
    system = Hybrid(
        [event], states=["x", "v"], x0=[2.0 - depth, 0.0], W_x=[[0, 1], [0, 0]],
        forcing=lambda t, x: np.array([0.0, -np.cos(t)]),
    )  # fmt: skip
    run = simulate(system, method(rtol=1e-10, atol=1e-12, max_step=0.05), [0.0, 5.0])
    # x = 1 - depth + cos t
    # It is looked for at some points of every step: a dip longer than a step is always seen, a
    # shorter one may be missed (README), and then nothing is made up.
    if depth > 4e-4 or (depth > 0 and run.events):
        want = np.arccos(depth - 1)
        assert len(run.events) == 1
        # a root of depth 1/2 (t - pi)^2 is known to error/slope
        assert abs(run.events[0].time - want) < 1e-7 / np.sqrt(2 * depth) + 1e-9 / depth
    elif depth <= 0:
        assert not run.events


def test_a_dip_between_two_samples():
    a_grazing_guard_is_seen_or_not_by_its_depth(0.002, DOP853)
    # naive: the guard's sign every 0.5 s
    times = np.arange(0.0, 5.0, 0.5)
    assert naive.sampled_crossings(lambda t: 1 - 0.002 + np.cos(t), times) == 0


def a_bouncing_ball_ends_in_a_word(restitution, method):
    """Zeno: infinitely many bounces before t* = 1 + 2 e/(1 - e): right times, then a refusal."""
    stop = 1 + 2 * restitution / (1 - restitution)
    bounces = ball(restitution=restitution)
    try:
        run = simulate(bounces, method(rtol=1e-9, atol=1e-11, cascade=20), [0.0, 3.0])
    except IntegrationError as refusal:
        said = refusal
        run = None
    if run is None:
        assert "chattering" in str(said)
        assert abs(said.time - stop) < 0.05
    else:
        assert stop > 2.9
        times = np.array([e.time for e in run.events])
        want = np.cumsum([1.0, *(2 * restitution ** np.arange(1, 60))])
        assert np.abs(times - want[: len(times)]).max() < 1e-4


def test_a_sliding_mode_is_called_chattering():
    """x' = -sign(x) and thresholds 1e-9 apart: Filippov's sliding, no end of events."""
    down = EventFunction(
        name="down", guard=lambda t, x: x[0] + 1e-9, direction=-1, reset=lambda t, x: x * [1, -1]
    )
    up = EventFunction(
        name="up", guard=lambda t, x: x[0] - 1e-9, direction=1, reset=lambda t, x: x * [1, -1]
    )
    system = Hybrid(
        [down, up], states=["x", "s"], x0=[0.5, -1.0],
        forcing=lambda t, x: np.array([x[1], 0.0]),
    )  # fmt: skip
    with pytest.raises(IntegrationError, match="chattering") as caught:
        simulate(system, DOP853(rtol=1e-8, atol=1e-10, cascade=30), [0.0, 2.0])
    assert caught.value.time == pytest.approx(0.5, abs=1e-6)
    # naive: fixed steps go on to the end, sign for sign, at the wrong place by a step
    x = naive.sign_steps(0.5, 0.013, 2.0)
    assert 1e-4 < np.abs(x[60:]).max() < 0.02


def test_fixed_steps_miscount_switches_and_root_finding_does_not():
    system = build_crawlers([Crawler()], Chain())
    loose, tight = (
        [e.time for e in simulate(system, DOP853(rtol=r, atol=1e-2 * r), [0.0, 10.0]).events]
        for r in (1e-7, 1e-11)
    )
    assert len(loose) == len(tight) > 4
    assert np.abs(np.array(loose) - tight).max() < 1e-3
    coarse = [t for t, _ in naive.fixed_step_crawler(system, 10.0, 0.02)]
    assert len(coarse) != len(tight) or np.abs(np.array(coarse) - tight).max() > 1e-3


def crawlers_keep_their_switches(grab, rupture, seed):
    """Random thresholds: the same switches at two tolerances, or a reason to stop."""
    rng = np.random.default_rng(seed)
    cell = Crawler(grab=grab, rupture=rupture, drag=float(rng.uniform(0.5, 2.0)))
    runs = [
        simulate(
            build_crawlers([cell], Chain()), DOP853(rtol=r, atol=1e-2 * r), [0.0, 3.0],
            auxiliaries=False,
        )
        for r in (1e-8, 1e-10)
    ]  # fmt: skip
    one, two = ([(e.name) for e in run.events] for run in runs)
    assert one == two
    assert np.abs(runs[0].x[-1] - runs[1].x[-1]).max() < 1e-3 * (1 + np.abs(runs[1].x[-1]).max())


SHIFTS = (0.005, 0.1)


def sensitivity(kinetics, shift, duration=20.0, seeds=(3, 3)):
    """rms distance (um) of the cell's nodes after a shift of the start along x, centroid apart."""
    effects = (
        "membrane_elasticity", "volume", "cortical_tension", "focal_adhesion", "lamellipodium",
        "substrate_contact", "matrix_elasticity", "foundation",
    )  # fmt: skip
    from cellsys.integrate import LinearlyImplicit

    ends = []
    for moved, seed in zip((0.0, shift), seeds, strict=True):
        system = tiny_system(*effects, cells=1, focal_adhesion={"kinetics": kinetics})
        x0 = system.x0.copy()
        nodes = system.states.view(x0, "cell1.position")
        nodes[:, 0] += moved
        run = simulate(
            system, LinearlyImplicit(step=0.5), [0.0, duration], x0, seed=seed, auxiliaries=False
        )
        end = system.states.view(run.x[-1], "cell1.position").copy()
        end[:, 0] -= moved
        ends.append(end)
    return float(np.sqrt(np.mean(np.sum((ends[1] - ends[0]) ** 2, axis=1))))


@pytest.mark.parametrize("kinetics", ["clutch", "switching"])
def test_sensitivity_to_a_shifted_start(kinetics, record_property):
    """A start 5 nm and 100 nm aside: bounded, and reported for both kinetics."""
    found = [sensitivity(kinetics, s) for s in SHIFTS]
    record_property("um", found)
    assert all(np.isfinite(found))
    assert sensitivity(kinetics, 0.0) == 0.0
    assert found[0] < 1.0
    assert found[1] < 2.0
    if kinetics == "switching":
        # naive: a seed of its own for each run, which then differ without any shift
        assert sensitivity(kinetics, 0.0, seeds=naive.own_seed_each(2)) > 1e-3
    if kinetics == "clutch":
        # smooth kinetics: a shift of 5 nm against a matrix of 1 um spacing stays below itself x 10
        assert found[0] < 10 * SHIFTS[0]


CASES = (
    Case(
        "events however close",
        events_however_close_all_happen,
        {"first": Real(0.1, 8), "gap": Power(-18, -1), "count": Int(2, 6), "method": METHODS},
    ),
    Case(
        "grazing",
        a_grazing_guard_is_seen_or_not_by_its_depth,
        {"depth": Power(-9, -0.3), "method": Choice(DOP853, Radau)},
    ),
    Case(
        "Zeno",
        a_bouncing_ball_ends_in_a_word,
        {"restitution": Real(0.05, 0.6), "method": Choice(DOP853, Radau)},
    ),
    Case(
        "crawlers",
        crawlers_keep_their_switches,
        {"grab": Real(0.3, 0.7), "rupture": Real(0.2, 0.6), "seed": SEED},
    ),
)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_random_instances(case):
    hold(case, 3)
