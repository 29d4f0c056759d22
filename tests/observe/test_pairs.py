"""Read-outs of pairs on synthetic runs with known answers."""

import dataclasses
import tomllib

import numpy as np
import pytest
import scipy.optimize as so

import cellsys as cs
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.geometry.membrane import sphere
from cellsys.mechanics.contact import touching
from cellsys.observe import (
    alone_scenes,
    attenuation_length,
    edge_gap,
    observe_pair,
    pair_of,
    speed_against_spacing,
    until_contact,
)
from cellsys.scene.ensemble import read_run
from cellsys.system import Block, Layout
from cellsys.trajectory import ErrorEstimate, Trajectory, cell_names
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
        blocks.append(Block("matrix.displacement", u.shape[1:], "um", role="field"))
        parts.append(u.reshape(len(T), -1))
    return Trajectory(t=T, x=np.concatenate(parts, axis=1), states=Layout(blocks))


def approaching(speed, start=30.0):
    x = start / 2 - speed * T
    return np.stack([np.column_stack([-x, 0 * x]), np.column_stack([x, 0 * x])], axis=1)


def test_contact_ends_the_run_with_its_time():
    full = run(approaching(0.3))
    cut = until_contact(full)
    gap = edge_gap(full)
    assert cut.events[-1].name == "contact"
    assert cut.events[-1].detail == "cell1 and cell2"
    # by bisection on the whole path: which facets face each other changes between two samples,
    # so the gap is no straight line there and interpolating it is off by a share of the interval
    shape = sphere(5.0, (0.0, 0.0, 0.0)).position

    def at(t):
        return edge_gap(flat_run(shape, shape + [30.0 - 0.6 * t, 0.0, 0.0]))[0]

    exact = so.brentq(at, 30.0, 40.0, xtol=1e-6)
    assert cut.events[-1].time == pytest.approx(exact, abs=0.02 * 5.0)
    assert cut.t[-1] <= cut.events[-1].time
    assert len(cut) == np.count_nonzero(gap > 0)
    apart = run(approaching(0.01))
    assert until_contact(apart) is apart
    with pytest.raises(ParameterError, match="gap"):
        until_contact(full, np.nan)


def flat_run(*cells, geometry=None):
    """One sample of cells with nodes (n, 3) each."""
    blocks = [Block(f"cell{k + 1}.position", x.shape, "um") for k, x in enumerate(cells)]
    x = np.concatenate([np.ravel(c) for c in cells])[None]
    return Trajectory(t=np.zeros(1), x=x, states=Layout(blocks), geometry=geometry or {})


def slanted(centre, n=189):
    """Half axes 12, 2 and 3 um, the first at 60 degrees in the plane."""
    x = sphere(1.0, (0.0, 0.0, 0.0), n).position * [12.0, 2.0, 3.0]
    c, s = np.cos(np.pi / 3), np.sin(np.pi / 3)
    return x @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [centre, 0.0, 3.0]


def test_edge_gap_is_the_distance_of_the_membranes():
    gap = edge_gap(run(approaching(0.1)))
    # a facet of a sphere of 189 nodes and 5 um lies up to 0.1 um below it
    assert np.all(gap >= 20.0 - 0.2 * T)
    assert np.all(gap <= 20.0 - 0.2 * T + 0.2)
    turned = approaching(0.1) @ np.array([[0.6, 0.8], [-0.8, 0.6]])
    assert np.abs(edge_gap(run(turned)) - gap).max() < 0.2
    # the example: -2.49 along the line of the centres
    two = flat_run(slanted(-5.0, 800), slanted(5.0, 800))
    assert edge_gap(two)[0] == pytest.approx(4.75, abs=0.1)
    assert until_contact(two) is two
    # one cell over another: they are not at contact, whatever is seen from above
    ball = sphere(5.0, (0.0, 0.0, 0.0)).position
    assert edge_gap(flat_run(ball, ball + [3.0, 0, 12.0]))[0] == pytest.approx(2.4, abs=0.2)
    # contours seen from above, at any height
    angle = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    ring = np.column_stack([4 * np.cos(angle), 4 * np.sin(angle), 0 * angle])
    above = flat_run(ring, 0.5 * ring + [9.0, 0, 7.0])
    assert edge_gap(above)[0] == pytest.approx(3.0, abs=1e-3)
    assert edge_gap(flat_run(ring, ring + [7.0, 0, 0]))[0] == pytest.approx(-1.0, abs=2e-3)


def test_which_triangles_a_membrane_has():
    start = sphere(5.0, (0.0, 0.0, 0.0))
    dented = start.position * np.where(start.position[:, :1] > 3, 0.6, 1.0)
    pair = dented, start.position + [9.0, 0, 0]
    with pytest.raises(DataError, match=r"cell1: .* lie inside .*'cell1.triangles'"):
        edge_gap(flat_run(*pair))
    given = {f"cell{k}.triangles": start.triangles for k in (1, 2)}
    # the dent faces the other cell: its nodes stand 0.6 as far out
    assert edge_gap(flat_run(*pair, geometry=given))[0] > 9.0 - 5.0 - 3.6
    # of a run that starts as spheres they are those of the start
    states = Layout([Block(f"cell{k}.position", dented.shape, "um") for k in (1, 2)])
    x = np.array([np.ravel([start.position, pair[1]]), np.ravel(pair)])
    found = edge_gap(Trajectory(t=np.arange(2.0), x=x, states=states))
    assert found[1] == edge_gap(flat_run(*pair, geometry=given))[0]
    # built systems say them, and two cells of any run keep theirs
    system = cs.build(facing())
    triangles = system.cells[1].body.membrane.triangles
    np.testing.assert_array_equal(system.geometry()["cell2.triangles"], triangles)
    given["cell3.triangles"] = start.triangles
    three = flat_run(start.position - [20.0, 0, 0], *pair, geometry=given)
    blocks = [*three.states, Block("matrix.displacement", (1, 3), "um", role="field")]
    three = dataclasses.replace(three, x=np.append(three.x, np.zeros((1, 3)), axis=1),
                                states=Layout(blocks))  # fmt: skip
    assert edge_gap(pair_of(three, 1, 2))[0] == edge_gap(three, "cell2", "cell3")[0] == found[1]


def test_a_gap_between_what_is_no_pair_is_refused():
    ball = sphere(5.0, (0.0, 0.0, 0.0)).position
    two = flat_run(ball, ball + [20.0, 0, 0])
    for first, second, kind, words in (
        ("cell1", "cell1", ParameterError, "'cell1' twice"),
        ("cell1", "cell3", DataError, "no cell 'cell3'; it has cell1, cell2"),
    ):
        with pytest.raises(kind, match=words):
            edge_gap(two, first, second)
    with pytest.raises(DataError, match=r"it has cell1$"):
        edge_gap(flat_run(ball))
    mixed = flat_run(ball * [1.0, 1.0, 0.0], ball + [20.0, 0, 0])
    with pytest.raises(DataError, match="cell1 is a contour and cell2 a surface"):
        edge_gap(mixed)


def test_a_nucleus_is_no_cell():
    table = tomllib.loads(TINY)
    table["effects"]["nucleus"] = {"radius": "2 um"}
    scene = dataclasses.replace(facing(), effects=cs.Scene.parse(table).effects, duration=4.0)
    run = cs.run_scene(scene)  # was at contact with its own nucleus
    assert "cell1.nucleus.position" in run.states
    assert cell_names(run.states) == ["cell1", "cell2"]
    assert not run.events or run.events[-1].detail == "cell1 and cell2"
    assert edge_gap(run)[0] == pytest.approx(0.6, abs=0.2)


def test_cells_touch_where_their_membranes_do():
    """Slanted cells 10 um apart do not, and the stepper asks the same."""
    system = cs.build(facing())
    until = touching(system)

    def state(apart):
        x = system.x0.copy()
        for name, centre in (("cell1", -0.5 * apart), ("cell2", 0.5 * apart)):
            x[system.states.slice(f"{name}.position")] = slanted(centre).ravel()
        return x

    def gap(d):
        return edge_gap(flat_run(slanted(0.0), slanted(d)))[0]

    exact = so.brentq(gap, 4.2, 5.0, xtol=1e-4)
    assert exact < 5.0  # along the line of the centres they "touch" at 12.5 um
    for apart, told in ((10.0, False), (exact + 1e-3, False), (exact - 1e-3, True), (4.0, True)):
        assert until(0.0, state(apart)) is told
    assert not until(0.0, system.x0)


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
    # rings within the error of the run are left out, and without three there is no length
    known = dataclasses.replace(run(centres, u), estimator=lambda: ErrorEstimate(
        np.full(3 * (189 + len(X)), 0.3 * np.exp(-15.5 / 9.0)) / np.sqrt(3.0), np.ones(1), "given"
    ))  # fmt: skip
    less = attenuation_length(known, X)
    assert less.radius.max() < 15.5 < found.radius.max()
    assert less.length == pytest.approx(9.0, rel=0.03)
    lost = dataclasses.replace(run(centres, 1e-3 * u), estimator=known.estimator)
    with pytest.raises(DataError, match="move by more than the error of the run at t = 45 s"):
        attenuation_length(lost, X)
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


@pytest.mark.slow
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
