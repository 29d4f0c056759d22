"""Read-outs of pairs on synthetic runs with known answers."""

import dataclasses
import tomllib

import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.mechanics.geometry.membrane import sphere
from cellsys.observe import (
    alone_scenes,
    attenuation_length,
    edge_gap,
    observe_pair,
    speed_against_spacing,
    until_contact,
)
from cellsys.scene.ensemble import read_run
from cellsys.system import Block, Layout
from cellsys.trajectory import Trajectory
from tests.study.scenes import TINY

T = np.arange(0.0, 50.0, 5.0)


def rest(n=41, half=40.0):
    axis = np.linspace(-half, half, n)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    return np.column_stack([grid, np.zeros(len(grid))])


def run(centres, u=None, radius=5.0):
    """Spheres that move as `centres` (T, cells, 2) say, over a matrix displaced by u (T, N, 3)."""
    shape = np.asarray(sphere(radius, (0.0, 0.0, radius)).position)
    centres = np.asarray(centres, float)
    K = centres.shape[1]
    blocks = [Block(f"cell{k + 1}.position", shape.shape, "um") for k in range(K)]
    parts = []
    for k in range(K):
        moved = np.repeat(shape[None], len(T), axis=0)
        moved[:, :, :2] += centres[:, k, None]
        parts.append(moved.reshape(len(T), -1))
    if u is not None:
        blocks.append(Block("matrix.displacement", u.shape[1:], "um", "field"))
        parts.append(u.reshape(len(T), -1))
    return Trajectory(T, np.concatenate(parts, axis=1), Layout(blocks))


def approaching(speed, start=30.0):
    x = start / 2 - speed * T
    return np.stack([np.column_stack([-x, 0 * x]), np.column_stack([x, 0 * x])], axis=1)


def test_edge_gap_of_spheres():
    gap = edge_gap(run(approaching(0.1)))
    # nodes of a triangulated sphere need not lie on the line of the centres
    assert np.abs(gap - (30.0 - 0.2 * T - 10.0)).max() < 0.15
    turned = approaching(0.1) @ np.array([[0.6, 0.8], [-0.8, 0.6]])
    assert np.abs(edge_gap(run(turned)) - gap).max() < 0.3


def test_contact_ends_the_run_with_its_time():
    full = run(approaching(0.3))
    cut = until_contact(full)
    gap = edge_gap(full)
    assert cut.events[-1].name == "contact"
    assert cut.events[-1].detail == "cell1 and cell2"
    # straight motion: the interpolated time is exact, gap(0) / closing speed
    assert cut.events[-1].time == pytest.approx(gap[0] / 0.6, rel=1e-9)
    assert cut.t[-1] <= cut.events[-1].time
    assert len(cut) == np.count_nonzero(gap > 0)
    apart = run(approaching(0.01))
    assert until_contact(apart) is apart
    with pytest.raises(ParameterError, match="gap"):
        until_contact(full, np.nan)


def test_pair_is_read_beside_its_controls():
    X = rest()
    still = approaching(0.0, 40.0)
    between = (np.abs(X[:, 0]) < 19) & (np.abs(X[:, 1]) < 4)
    u = np.zeros((len(T), len(X), 3))
    u[:, between, 0] = 3e-3 * T[:, None]
    u[:, ~between, 1] = 1e-3 * T[:, None]
    pair = run(still, u)
    alone = [run(still[:, :1], 0.5 * u), run(still[:, 1:], 0.3 * u)]
    read = observe_pair(pair, alone, X)
    assert np.allclose(read.gap_speed, 3.0)  # nm/s, by construction
    assert np.allclose(read.periphery_speed, 1.0)
    assert np.allclose(read.gap_alone, 0.4 * 3.0)
    assert np.allclose(read.periphery_alone, 0.4)
    assert np.allclose(read.normalised_gap, 1.0)
    assert "one cell alone" in str(read)
    closer = dataclasses.replace(read, gap=0.5 * read.gap, gap_speed=2 * read.gap_speed)
    rows = speed_against_spacing([read, closer])
    assert np.all(np.diff(rows[:, 0]) > 0)
    assert np.allclose(rows[:, 1], [6.0, 3.0])
    with pytest.raises(DataError, match="one-cell controls"):
        observe_pair(pair, [], X)
    with pytest.raises(DimensionError, match="one matrix"):
        observe_pair(pair, alone, X[:-1])


def test_attenuation_length_of_an_exponential():
    X = rest(81)
    centres = np.zeros((len(T), 1, 2))
    r = np.hypot(X[:, 0], X[:, 1])
    u = np.zeros((len(T), len(X), 3))
    u[:, :, 0] = 0.3 * np.exp(-r / 9.0)
    found = attenuation_length(run(centres, u), X)
    # rings of 2 um: rms over a ring is not the value at its middle, by (width/length)^2/24
    assert found.length == pytest.approx(9.0, rel=0.03)
    assert found.residual < 0.05
    grows = np.zeros_like(u)
    grows[:, :, 0] = np.exp(r / 9.0)
    with pytest.raises(DataError, match="does not fall"):
        attenuation_length(run(centres, grows), X)
    with pytest.raises(DataError, match="rings"):
        attenuation_length(run(centres, np.zeros_like(u)), X)
    with pytest.raises(DataError, match="a cell farther from the rim"):
        attenuation_length(run(centres + 48.0, u), X)


def test_controls_of_a_scene():
    table = tomllib.loads(TINY)
    table["cells"] = [
        {"position": ["-8 um", "0 um"], "radius": "5 um", "polarity": "10 deg"},
        {"position": ["8 um", "0 um"], "radius": "5 um"},
    ]
    scene = cs.Scene.parse(table)
    controls = alone_scenes(scene)
    assert [c.cells for c in controls] == [(scene.cells[0],), (scene.cells[1],)]
    assert all(c.seed == scene.seed for c in controls)
    # the same matrix, node for node
    a, b = cs.build(scene).matrix, cs.build(controls[1]).matrix
    assert np.array_equal(a.position, b.position)
    with pytest.raises(ParameterError, match="two cells"):
        alone_scenes(controls[0])


@pytest.mark.parametrize("name", ["two_cells", "two_cells_far", "two_cells_facing", "ten_cells"])
def test_shipped_scenes(name):
    from pathlib import Path

    scene = cs.load_scene(Path(__file__).parents[2] / "examples" / f"{name}.toml")
    places = np.array([c.position for c in scene.cells])
    off = np.linalg.norm(places[:, None] - places[None], axis=2)
    gap = off[np.triu_indices(len(places), 1)] - 16.0
    if name == "ten_cells":
        assert len(places) == 10
        assert gap.min() >= 8.0
        assert scene.sample == 10.0
        assert scene.matrix.diameter == pytest.approx(184.0)
    else:
        assert gap == pytest.approx([30.0 if name.endswith("far") else 10.0])
        assert scene.matrix.diameter == pytest.approx(120.0)


def facing(until="contact"):
    table = tomllib.loads(TINY)
    table["cells"] = [
        {"position": ["-5.3 um", "0 um"], "radius": "5 um", "polarity": "0 deg"},
        {"position": ["5.3 um", "0 um"], "radius": "5 um", "polarity": "180 deg"},
    ]
    table |= {"duration": "400 s", "sample": "2 s", "until": until}
    return cs.Scene.parse({k: v for k, v in table.items() if v is not None})


def test_a_scene_ends_where_its_cells_touch(tmp_path):
    scene = facing()
    run = cs.run_scene(scene)
    whole = cs.run_scene(facing(None))
    assert run.events[-1].name == "contact"
    assert run.t[-1] < run.events[-1].time < scene.duration
    # the same run, only shorter, and not computed to the end
    assert np.array_equal(run.x, whole.x[: len(run)])
    assert run.events[-1] == until_contact(whole).events[-1]
    assert run.statistics["steps"] < 0.9 * whole.statistics["steps"]
    assert run.statistics["samples"] == len(run) + 1
    cached = cs.run_scene(scene, tmp_path)
    again = cs.run_scene(scene, tmp_path)
    for found in (cached, again, read_run(tmp_path / scene.fingerprint()[:20])):
        assert np.array_equal(found.x, run.x)
        assert np.array_equal(found.eta, run.eta)
        assert found.events == run.events
        assert found.label == scene.name


def test_until_contact_is_checked():
    assert facing(None).fingerprint() != facing().fingerprint()
    assert "until" not in facing(None).canonical()
    assert all(c.until is None for c in alone_scenes(facing()))
    with pytest.raises(cs.SceneError, match="until"):
        facing("tired")
    lone = facing()
    with pytest.raises(cs.SceneError, match="at least two cells, got 1"):
        cs.Scene.parse(tomllib.loads(TINY) | {"until": "contact"})
    with pytest.raises(cs.SceneError, match="until must be"):
        dataclasses.replace(lone, until="tired")
    system, never = cs.build(lone), lambda t, x: False
    euler = cs.LinearlyImplicit(step=0.5)
    assert len(cs.simulate(system, euler, [0.0], until=never)) == 1
    assert len(cs.simulate(system, euler, [0.0, 1.0, 2.0], until=never)) == 3
    assert len(cs.simulate(system, euler, [0.0, 1.0, 2.0], until=lambda t, x: t > 0.5)) == 2
    with pytest.raises(ParameterError, match="cannot end it on a condition"):
        cs.simulate(
            cs.build(lone), cs.DOP853(rtol=1e-3, atol=1e-6), lone.times, until=lambda t, x: True
        )
