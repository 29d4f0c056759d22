"""Read-outs of a run: node speeds, contact radius, crawl, heights, headings, magnitudes."""

import dataclasses
import tomllib

import numpy as np
import pytest

import cellsys as cs
from cellsys.errors import DataError
from cellsys.observe import (
    centre_height,
    contact_radius,
    crawl_distance,
    heading_change_deg,
    heading_deg,
    heading_error_deg,
    node_speed,
    read_out_errors,
    read_outs,
    summary_of_run,
)
from cellsys.system import Block, Layout
from cellsys.trajectory import ErrorEstimate, Trajectory
from tests.study.scenes import tiny


def run_of(x, u=None, t=None):
    """A trajectory of one cell (T, n, 3) over a matrix displaced by u (T, N, 3)."""
    blocks, parts = (
        [Block("cell1.position", x.shape[1:], "um", role="component", kind="position")],
        [x],
    )
    if u is not None:
        blocks.append(
            Block("matrix.displacement", u.shape[1:], "um", role="field", kind="position")
        )
        parts.append(u)
    flat = np.concatenate([p.reshape(len(x), -1) for p in parts], axis=1)
    return Trajectory(t=np.arange(len(x)) * 2.0 if t is None else t, x=flat, states=Layout(blocks))


def test_speed_of_a_steady_motion():
    shape = np.random.default_rng(0).standard_normal((7, 3))
    t = np.array([0.0, 1.0, 4.0, 4.5])
    x = shape + t[:, None, None] * np.array([0.3, 0.0, 0.4])
    speed = node_speed(run_of(x, t=t), "cell1.position")
    assert speed.shape == (3, 7)
    assert np.abs(speed - 0.5).max() < 1e-14 * 10
    with pytest.raises(DataError, match="two samples"):
        node_speed(run_of(x[:1], t=t[:1]), "cell1.position")


def test_contact_radius_counts_low_nodes_only():
    low = [[3.0, 0, 0.2], [-3.0, 0, 0.2], [0, 5.0, 0.9]]
    x = np.array([*low, [0, -5.0, 5.0], [9.0, 0, 8.0], [-9, 0, 8.0]])
    assert abs(contact_radius(x) - 5.0) < 1e-14
    assert abs(contact_radius(x + [100.0, -40.0, 0.0]) - 5.0) < 1e-12
    assert contact_radius(x + [0, 0, 2.0]) == 0.0


def test_summary_of_known_motions():
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = np.column_stack([4 * np.cos(angle), 4 * np.sin(angle), 0.1 + 0 * angle])
    cell = np.concatenate([ring, [[0, 0, 6.0]]])
    T = 6
    x = cell + np.arange(T)[:, None, None] * np.array([0.02, 0.0, 0.0])
    rng = np.random.default_rng(1)
    rest = np.column_stack([rng.uniform(-30, 30, (400, 2)), np.zeros(400)])
    near = np.hypot(rest[:, 0], rest[:, 1]) < 3.0
    u = np.zeros((T, 400, 3))
    u[:, near, 1] = 0.01 * np.arange(T)[:, None]
    found = summary_of_run(run_of(x, u), rest)
    assert abs(found["crawl_um"] - 0.1) < 1e-12
    assert abs(found["membrane_speed_mean_nm_s"] - 10.0) < 1e-9
    assert abs(found["contact_radius_start_um"] - 4.0) < 0.01
    assert abs(found["height_end_um"] - 5.9) < 1e-12
    assert abs(found["matrix_displacement_max_um"] - 0.05) < 1e-14
    assert found["matrix_speed_mean_rim_nm_s"] == 0.0
    assert 0.0 < found["matrix_speed_p99_under_cell_nm_s"] <= 5.0 + 1e-9
    alone = summary_of_run(run_of(x))
    assert "matrix_displacement_max_um" not in alone
    assert alone["crawl_um"] == found["crawl_um"]


def test_a_cell_that_touches_nothing_has_plain_numbers_too():
    x = np.random.default_rng(0).standard_normal((3, 10, 3)) + [0, 0, 50.0]
    u, rest = np.zeros((3, 20, 3)), np.random.default_rng(1).uniform(-20, 20, (20, 3))
    found = summary_of_run(run_of(x, u), rest)
    assert found["contact_radius_end_um"] == 0.0
    assert all(np.isfinite(v) for v in found.values())
    far = summary_of_run(run_of(x + [500.0, 0, 0], u), rest)
    assert all(np.isfinite(v) for v in far.values())


def test_a_cell_that_sinks_does_not_crawl():
    """Without a lamellipodium it only spreads; the straight path of its centre is a fall."""
    still = tiny(replace={'lamellipodium = { force = "600 pN" }\n': ""})
    run = cs.run_scene(cs.Scene.parse(tomllib.loads(still)))
    x = run.block("cell1.position")
    naive = float(np.linalg.norm(x[-1].mean(axis=0) - x[0].mean(axis=0)))
    found = summary_of_run(run)
    assert naive > 0.2
    assert found["crawl_um"] < 0.05 * naive
    fell = found["centre_height_start_um"] - found["centre_height_end_um"]
    assert np.hypot(found["crawl_um"], fell) == pytest.approx(naive)
    # the one definition, wherever it is read
    assert read_outs(run)["crawl_um"] == found["crawl_um"] == crawl_distance(x)
    assert read_outs(run)["centre_height_end_um"] == found["centre_height_end_um"]


@pytest.mark.parametrize("seed", range(3))
def test_crawl_is_what_is_left_when_heights_are_thrown_away(seed):
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(6, 9, 3)).cumsum(axis=0)
    flat = x * [1.0, 1.0, 0.0]
    lifted = x + np.array([0.0, 0.0, 1.0]) * rng.normal(size=(6, 9, 1))
    way = complex(*(x[-1] - x[0]).mean(axis=0)[:2])
    for same in (x, flat, lifted, x[[0, 3, 5]], x + [3.0, -4.0, 2.0]):
        assert crawl_distance(same) == pytest.approx(abs(way))
    assert centre_height(x[2]) == pytest.approx(sum(x[2, :, 2]) / 9)


def test_turns_count_in_full():
    """A cell that turns by 450 degrees did not turn by 90, and none jumps at 180."""
    angle = np.radians(np.linspace([170.0, 0.0], [620.0, -200.0], 40))
    p = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    assert heading_change_deg(p) == pytest.approx([450.0, -200.0])
    assert np.abs(np.diff(heading_deg(p), axis=0)).max() < 12.0
    ends = np.degrees(np.arccos(np.einsum("ij,ij->i", p[0], p[-1])))
    assert ends == pytest.approx([90.0, 160.0])  # what was said before
    shape = np.random.default_rng(0).normal(size=(40, 5, 3))
    blocks = [Block(f"cell{k}.position", (5, 3), "um") for k in (1, 2)]
    x = np.concatenate([shape, shape], axis=1).reshape(40, -1)
    run = Trajectory(t=np.arange(40.0), x=x, states=Layout(blocks), p=p)
    assert read_outs(run)["heading_change_deg"] == pytest.approx(325.0)
    # off one another: whole turns are no difference, and it is at most half a turn
    turned = np.exp(1j * np.radians([[30.0, -359.0, 179.0, 721.0], [0.0, 0.0, -179.0, 0.0]]))
    a, b = (np.column_stack([v.real, v.imag, 0 * v.real]) for v in turned)
    assert heading_error_deg(a, b) == pytest.approx([30.0, 1.0, -2.0, 1.0])


def test_read_outs_have_the_errors_of_the_places_they_are_made_of():
    """Nodes shifted at random within their errors move no read-out by more than its own."""
    rng = np.random.default_rng(4)
    x = rng.normal(size=(5, 30, 3)).cumsum(axis=0) * [1.0, 1.0, 0.1] + [0, 0, 1.0]
    u = 0.2 * rng.normal(size=(5, 20, 3)).cumsum(axis=0)
    run = run_of(x, u)
    absolute = np.concatenate([np.full(90, 0.02), np.full(60, 0.003)])
    run = dataclasses.replace(run, estimator=lambda: ErrorEstimate(absolute, absolute, "given"))
    errors, told = read_out_errors(run), read_outs(run)
    assert errors["crawl_um"] == pytest.approx(np.sqrt(3) * 0.02)
    assert errors["matrix_displacement_max_um"] == pytest.approx(np.sqrt(3) * 0.003)
    assert set(errors) <= set(told)
    for _ in range(20):
        shift = absolute * rng.uniform(-1, 1, run.x.shape)
        shift[0] = 0.0  # the start is given
        moved = read_outs(dataclasses.replace(run, x=run.x + shift))
        for name, error in errors.items():
            if name != "contact_radius_end_um":  # which nodes are in contact may change
                assert abs(moved[name] - told[name]) <= error


# What a name ends with: its unit, or the quantity without one.
UNITS = ("_um", "_um2", "_um3", "_deg", "_pN", "_pN_um", "_percent", "_fJ", "_Pa", "cue_strength")


def test_the_matrix_is_read_over_the_run_and_at_the_end():
    u = np.zeros((5, 4, 3))
    u[2, 1] = [0.3, 0.0, 0.4]
    u[-1] = 1e-6
    x = np.random.default_rng(0).standard_normal((5, 7, 3))
    found = read_outs(run_of(x, u))
    assert found["matrix_displacement_max_um"] == pytest.approx(0.5)
    assert found["matrix_displacement_rms_end_um"] == pytest.approx(np.sqrt(3) * 1e-6)
    assert summary_of_run(run_of(x, u), np.eye(4, 3))["matrix_displacement_max_um"] == 0.5
    for name in found:
        assert name.endswith(UNITS)
        # every value at one sample says which; the others are over the run
        assert ("_end_" in name) != name.startswith(("crawl", "matrix_displacement_max"))
