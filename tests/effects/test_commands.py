"""Prescribed histories: heading and amplitude in a run, knots as stop points, parameter bounds."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellsys.effects.adhesion import FocalAdhesion
from cellsys.effects.commands import Commands, History
from cellsys.effects.steering import Lamellipodium
from cellsys.errors import ParameterError
from cellsys.integrate import LinearlyImplicit, simulate
from cellsys.laws.bell import bond_number_step
from cellsys.scene import Scene, build
from cellsys.scene.registry import EFFECTS
from tests.mechanics.scenes import table


@given(
    st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=6, unique=True),
    st.data(),
)
def test_a_history_meets_its_knots_and_stays_between_them(times, data):
    times = sorted(times)
    values = data.draw(
        st.lists(st.floats(-10, 10), min_size=len(times), max_size=len(times)), label="values"
    )
    history = History(tuple(times), tuple(values))
    for t, v in zip(times, values, strict=True):
        assert history(t) == v
    assert history(times[0] - 1.0) == values[0]
    assert history(times[-1] + 1.0) == values[-1]
    between = history(0.5 * (times[0] + times[-1]))
    assert min(values) <= between <= max(values)


@pytest.mark.parametrize(
    ("times", "values", "words"),
    [
        ((), (), "at least one"),
        ((0.0, 1.0), (1.0,), "as many values"),
        ((1.0, 1.0), (0.0, 0.0), "increase"),
        ((0.0, float("nan")), (0.0, 0.0), "finite"),
        ((0.0,), (float("inf"),), "finite"),
    ],
)
def test_bad_histories_are_refused(times, values, words):
    with pytest.raises(ParameterError, match=words):
        History(times, values)


def test_knots_are_stop_points():
    commands = Commands(History((0.0, 7.3), (0.0, 1.0)), History((2.0, 9.0), (1.0, 0.0)))
    assert sorted(commands.stop_points()) == [0.0, 2.0, 7.3, 9.0]


def test_a_commanded_cell_points_where_it_is_told():
    """Heading at every sample to rounding, whatever the sensor says; amplitude scales the force."""
    spec = table()
    spec["commands"] = {
        "heading": {"times": ["0 s", "7.3 s", "20 s"], "values": ["0 deg", "80 deg", "-40 deg"]},
        "amplitude": {"times": ["0 s", "20 s"], "values": [1, 0]},
    }
    system = build(Scene.parse(spec))
    assert {0.0, 7.3, 20.0} <= set(system.stop_points())
    t = np.arange(0.0, 21.0, 2.0)
    run = simulate(system, LinearlyImplicit(step=0.5), t)
    angle = np.radians(np.interp(t, [0, 7.3, 20], [0, 80, -40]))
    expected = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    assert np.abs(run.p[:, 0] - expected).max() < 1e-14
    assert run.amplitude[:, 0] == pytest.approx(1.0 - t / 20.0, abs=1e-14)
    assert np.abs(run.d[:, 0] - run.p[:, 0]).max() > 0.05
    push = np.linalg.norm(run.u, axis=1)
    assert push[-1] < 0.1 * push[0]


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_bound_of_every_parameter_holds(name):
    """One step beyond each bound is refused with the parameter's name; defaults are inside."""
    effect = EFFECTS[name]
    effect()
    for item in dataclasses.fields(effect):
        meta = item.metadata
        if "unit" not in meta:
            continue
        if meta["choices"]:
            wrong = ["", "any", 3]
        elif meta["flag"]:
            wrong = ["", 1, None]
        else:
            wrong = [float("nan"), float("inf"), "5", True, None]
            wrong += [] if meta["above"] is None else [meta["above"]]
            wrong += [] if meta["least"] is None else [np.nextafter(meta["least"], -np.inf)]
            wrong += [] if meta["most"] is None else [np.nextafter(meta["most"], np.inf)]
        for value in wrong:
            with pytest.raises(ParameterError, match=f"{name}.{item.name}"):
                effect(**{item.name: value})


def test_the_sector_has_a_width():
    with pytest.raises(ParameterError, match="full must be >"):
        Lamellipodium(edge=0.5, full=0.5)


def test_a_cluster_of_the_default_kind_fails_at_430_pn():
    """Mean field under a constant load F shared by the bonds: f = F/n, no rest above 430 pN."""
    e = FocalAdhesion()

    def survives(load):
        n = e.bonds
        for _ in range(20_000):
            n = bond_number_step(n, load / n, 0.05, e.gain_rate, e.loss_rate, e.bonds, e.bond_force)
            if n < 0.5:
                return False
        return True

    assert survives(425.0)
    assert not survives(435.0)
    assert e.bonds * e.bond_stiffness == 2000.0


def test_means_are_exact_integrals():
    told = History((2.0, 3.0, 7.0), (1.0, 5.0, -1.0))
    t = np.array([0.0, 1.0, 2.5, 6.0, 6.5, 12.0])
    fine = [np.linspace(a, b, 20001) for a, b in itertools.pairwise(t)]
    wanted = [np.trapezoid([told(s) for s in part], part) / np.ptp(part) for part in fine]
    np.testing.assert_allclose(told.means(t), wanted, rtol=1e-6)
    assert np.array_equal(History((0.0,), (3.0,)).means(t), np.full(5, 3.0))
