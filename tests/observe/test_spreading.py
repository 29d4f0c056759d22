"""Read-outs of a run: node speeds, contact radius, magnitudes."""

import numpy as np
import pytest

from cellsys.errors import DataError
from cellsys.observe import contact_radius, node_speed, summary_of_run
from cellsys.system import Block, Layout
from cellsys.trajectory import Trajectory


def run_of(x, u=None, t=None):
    """A trajectory of one cell (T, n, 3) over a matrix displaced by u (T, N, 3)."""
    blocks, parts = [Block("cell1.position", x.shape[1:], "um", "component", "position")], [x]
    if u is not None:
        blocks.append(Block("matrix.displacement", u.shape[1:], "um", "field", "position"))
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
