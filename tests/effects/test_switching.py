"""Bell clusters as a whole: binding and rupture between steps, events, what is exactly zero."""

import numpy as np
import pytest

from cellsys.effects.adhesion import FocalAdhesion
from cellsys.effects.switching import RUPTURE
from cellsys.errors import ParameterError
from cellsys.integrate import LinearlyImplicit, simulate
from tests.mechanics.scenes import disturbed, element, force, small, switching

NUMBER, LENGTH, PARTNER = "cell1.bond_number", "cell1.bond_length", "cell1.bond_partner"


def view(system, x, name):
    return system.states.view(x, name)


@pytest.fixture(scope="module")
def run():
    """100 s with quick turnover, so that there are ruptures as well."""
    fast = {
        "kinetics": "switching",
        "bind_rate": "1 1/s",
        "bond_force": "2 pN",
        "loss_rate": "0.05 1/s",
    }
    system = small(focal_adhesion=fast)
    return system, simulate(system, LinearlyImplicit(step=0.5), np.arange(0.0, 101.0, 0.5), seed=3)


def test_a_new_cell_holds_nothing():
    system = switching()
    assert np.all(view(system, system.x0, PARTNER) == -1)
    assert not view(system, system.x0, NUMBER).any()
    assert not force(system, element(system, "cell1.focal_adhesion"), system.x0)["cell1"].any()


def test_events_tell_the_same_story_as_the_states(run):
    _, trajectory = run
    names = [e.name for e in trajectory.events]
    assert set(names) == {"bind", "rupture"}
    held = trajectory.block(PARTNER)
    alive = {}
    times = [e.time for e in trajectory.events]
    assert times == sorted(times)
    k = 0
    for i, t in enumerate(trajectory.t):
        while k < len(names) and times[k] < t:
            cell, _, node, *_, matrix = trajectory.events[k].detail.split()
            assert cell == "cell1"
            if names[k] == "bind":
                assert node not in alive
                alive[node] = matrix
            else:
                assert alive.pop(node) == matrix
            k += 1
        bound = np.flatnonzero(held[i] >= 0)
        assert {str(n): str(int(held[i, n])) for n in bound} == alive
        assert len(set(alive.values())) == len(alive)  # at most one membrane node per matrix node


def test_bonds_stay_in_their_bounds(run):
    _, trajectory = run
    number, length = trajectory.block(NUMBER), trajectory.block(LENGTH)
    held = trajectory.block(PARTNER) >= 0
    assert np.all(number[held] > 0)
    assert number.max() <= 50.0
    # Rupture waits for the next step, so a sample may show a cluster below 0.5.
    assert np.quantile(number[held], 0.5) > RUPTURE
    assert length[held].min() >= 0.03
    assert length.max() <= 1.2 + 1e-9
    for values in (number, length):
        assert not values[~held].any()


def test_rest_lengths_only_shrink(run):
    _, trajectory = run
    held, length = trajectory.block(PARTNER), trajectory.block(LENGTH)
    same = (held[1:] == held[:-1]) & (held[1:] >= 0)
    change = np.diff(length, axis=0)[same]
    # A node may rupture and bind the same partner between two samples: a new, longer bond.
    reborn = {(e.time, e.detail) for e in trajectory.events if e.name == "bind"}
    assert (change > 0).sum() <= len(reborn)
    assert change.min() >= -0.01 * 0.5 - 1e-12  # v_m dt


def test_no_binding_out_of_reach_or_at_the_rim():
    system = switching()
    x = disturbed(system, 0)
    rng = np.random.default_rng(0)
    for name, value in ((NUMBER, 0.0), (LENGTH, 0.0), (PARTNER, -1.0)):
        view(system, x, name)[:] = value
    high = x.copy()
    view(system, high, "cell1.position")[:, 2] += 5.0
    assert system.between_steps(0.0, high, 10.0, rng)[1] == ()
    outside = x.copy()
    view(system, outside, "cell1.position")[:, 0] += 17.0
    after, events = system.between_steps(0.0, outside, 10.0, rng)
    bound = view(system, after, PARTNER) >= 0
    r = np.hypot(*view(system, after, "cell1.position")[bound, :2].T)
    assert bound.sum() == len(events)
    assert np.all(r <= 0.9 * 17.0)


def test_binding_probability():
    """1 - exp(-k_new dt) of the nodes in reach: a binomial count within four sigma."""
    system = small(
        focal_adhesion={"kinetics": "switching", "bind_rate": "0.5 1/s", "bind_distance": "2.5 um"}
    )
    x = system.x0.copy()
    view(system, x, "cell1.position")[:, 2] -= 0.5
    cell = view(system, x, "cell1.position")
    surface = system.matrix.position[system.matrix.surface]
    near = np.linalg.norm(cell[:, None] - surface[None], axis=2).min(axis=1) <= 2.5
    reachable = int((near & (np.hypot(*cell[:, :2].T) <= 0.9 * 17.0)).sum())
    rng, n = np.random.default_rng(1), 400
    counts = [len(system.between_steps(0.0, x, 0.2, rng)[1]) for _ in range(n)]
    chance = 1.0 - np.exp(-0.1)
    # Two nodes with one nearest partner: the second one takes its next, if in reach; 5 % slack.
    sigma = np.sqrt(reachable * n * chance * (1 - chance))
    assert abs(sum(counts) - reachable * n * chance) < 4 * sigma + 0.05 * sum(counts)


def test_the_state_handed_in_is_left_alone_and_rupture_clears_everything():
    system = switching()
    x = disturbed(system, 1)
    node = int(np.flatnonzero(view(system, x, PARTNER) >= 0)[0])
    view(system, x, NUMBER)[node] = 0.49
    before = x.copy()
    after, events = system.between_steps(3.0, x, 1e-12, np.random.default_rng(0))
    assert np.array_equal(x, before)
    assert [(e.time, e.name) for e in events] == [(3.0, "rupture")]
    assert f"node {node} " in events[0].detail
    assert view(system, after, PARTNER)[node] == -1
    assert view(system, after, NUMBER)[node] == view(system, after, LENGTH)[node] == 0
    f = force(system, element(system, "cell1.focal_adhesion"), after)["cell1"]
    assert np.all(f[node] == 0.0)


def test_lamellipodium_pushes_unbound_nodes_only():
    system = switching()
    x = disturbed(system, 2)
    number = view(system, x, NUMBER)
    free = number < 1.0
    push = np.abs(system.states.view(system.u(0.0, x), "cell1.position")).sum(axis=1)
    assert not push[~free].any()
    number[:] = 0.0
    alone = np.abs(system.states.view(system.u(0.0, x), "cell1.position")).sum(axis=1)
    assert np.array_equal(push[free], alone[free])
    assert alone[~free].any()


def test_same_seed_same_run_and_another_seed_another(run):
    system, trajectory = run
    again = simulate(system, LinearlyImplicit(step=0.5), np.arange(0.0, 50.5, 0.5), seed=3)
    assert np.array_equal(again.x, trajectory.x[:101])
    assert again.events == tuple(e for e in trajectory.events if e.time < 50.0)
    other = simulate(system, LinearlyImplicit(step=0.5), np.arange(0.0, 11.0, 0.5), seed=4)
    assert not np.array_equal(other.x, trajectory.x[:21])


def test_two_cells_never_share_a_matrix_node():
    from cellsys.scene import Scene, build
    from tests.mechanics.scenes import table

    spec = table(
        focal_adhesion={"kinetics": "switching", "bind_rate": "5 1/s", "bind_distance": "3 um"}
    )
    spec["cells"] = [
        {"position": ["-5 um", "0 um"], "radius": "5 um"},
        {"position": ["5.1 um", "0 um"], "radius": "5 um"},
    ]
    system = build(Scene.parse(spec))
    x = system.x0.copy()
    for cell in ("cell1", "cell2"):
        view(system, x, f"{cell}.position")[:] *= [1.0, 1.0, 0.2]
        view(system, x, f"{cell}.position")[:, 0] *= 0.6
    x, events = system.between_steps(0.0, x, 10.0, np.random.default_rng(0))
    held = np.concatenate([view(system, x, f"{c}.bond_partner") for c in ("cell1", "cell2")])
    held = held[held >= 0]
    assert {e.detail.split()[0] for e in events} == {"cell1", "cell2"}
    assert len(held) == len(set(held)) == len(events)


@pytest.mark.parametrize(
    ("name", "value"),
    [("bonds", 1.0), ("bond_stiffness", -1.0), ("rest_length", -0.1), ("bind_distance", 0.0),
     ("bond_force", float("nan")), ("stall_force", 0.0), ("gain_rate", 0.0), ("kinetics", "bell")],
)  # fmt: skip
def test_parameters_have_bounds(name, value):
    with pytest.raises(ParameterError, match=f"focal_adhesion.{name}"):
        FocalAdhesion(**{name: value})
