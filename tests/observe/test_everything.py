"""One table of read-outs: closed forms, invariance, and the same meaning for run and contours."""

import dataclasses

import numpy as np
import pytest

import cellsys as cs
from cellsys.observe import axis_difference_deg, contour_shape, directionality_deg, top_view
from tests.good_arguments import run

N = 2000  # corners: an ellipse's area is off by 2/3 (pi/N)^2, 2e-6


def ellipse(a, b, angle=0.0, centre=(0.0, 0.0), n=N):
    s = 2 * np.pi * np.arange(n) / n
    c, d = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return np.array([[c, -d], [d, c]]).dot([a * np.cos(s), b * np.sin(s)]).T + centre


def outlines(frames, names="ab", dt=10.0, **more):
    """Contours of cells a, b, ... from one tuple of polygons per frame."""
    cells, frame, shapes = [], [], []
    for k, polygons in enumerate(frames):
        for name, polygon in zip(names, polygons, strict=False):
            cells.append(name)
            frame.append(k)
            shapes.append(polygon)
    at = np.array(frame)
    return cs.CellOutlines(cell=tuple(cells), frame=at, t=dt * at, outline=tuple(shapes), **more)


@pytest.mark.parametrize("angle", [0.0, 30.0, 90.0, 135.0, 179.0])
@pytest.mark.parametrize("way", [1, -1])
def test_an_ellipse(angle, way):
    shape = contour_shape(ellipse(8.0, 3.0, angle, (1e3, -2e3))[::way])
    assert shape.area == pytest.approx(np.pi * 24.0, rel=3e-6)
    assert shape.aspect_ratio == pytest.approx(8.0 / 3.0, rel=1e-9)
    np.testing.assert_allclose(shape.centroid, [1e3, -2e3], rtol=1e-12)
    assert axis_difference_deg(shape.axis_deg, angle) < 1e-7
    # Ramanujan's second formula is good to 1e-7 here
    h = (5.0 / 11.0) ** 2
    length = np.pi * 11.0 * (1 + 3 * h / (10 + np.sqrt(4 - 3 * h)))
    assert shape.perimeter == pytest.approx(length, rel=3e-6)


def test_corners_that_crowd_on_one_side_do_not_shift_the_centroid():
    """Naive: the mean of the corners, and their covariance."""
    s = 2 * np.pi * (np.arange(3000) / 3000) ** 2
    p = np.column_stack([6.0 * np.cos(s), 2.0 * np.sin(s)])
    shape = contour_shape(p)
    assert np.linalg.norm(shape.centroid) < 0.01
    assert np.linalg.norm(p.mean(axis=0)) > 1.0
    assert shape.aspect_ratio == pytest.approx(3.0, rel=0.01)


def test_a_round_contour_has_no_axis_and_a_line_no_area():
    assert np.isnan(contour_shape(ellipse(5.0, 5.0, n=64)).axis_deg)
    with pytest.raises(cs.DataError, match="no area"):
        contour_shape([[0, 0], [1, 1], [2, 2]])


@pytest.mark.parametrize(
    ("distance", "r", "expected"),
    [
        (10.0, 3.0, 3.0),  # apart
        (7.0, 3.0, 0.0),  # tangent
        (5.0, 3.0, -2.0),  # overlapping
        (0.5, 1.0, -1.0),  # nested: the smaller lies whole under the larger, by its radius or more
    ],
)
def test_contour_and_centroid_distance_of_circles(distance, r, expected):
    both = (ellipse(4.0, 4.0, n=400), ellipse(r, r, centre=(distance, 0.0), n=400))
    table = cs.observe(outlines([both]))
    assert table.pair("a", "b", "centroid_distance")[0] == pytest.approx(distance, abs=1e-9)
    found = table.pair("a", "b", "contour_distance")[0]
    if expected >= 0:
        assert found == pytest.approx(expected, abs=1e-3)  # of the polygons: r (1 - cos(pi/400))
    elif r > 1:
        assert found == pytest.approx(expected, abs=2e-2)  # depths are found to 1e-3 of the extent
    else:
        assert found <= expected + 0.02


def moved(polygons, angle=0.0, shift=(0.0, 0.0)):
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return tuple(p @ np.array([[c, s], [-s, c]]) + shift for p in polygons)


def test_the_table_turns_and_moves_with_the_picture():
    rng = np.random.default_rng(1)
    frames = [
        (ellipse(6, 3, 20 + 5 * k, (0.3 * k, 0.1 * k), n=60),
         ellipse(5, 2, 100 + 3 * k, (16 - 0.2 * k, 2.0), n=60))
        for k in range(4)
    ]  # fmt: skip
    frames = [tuple(p + 0.05 * rng.standard_normal(p.shape) for p in pair) for pair in frames]
    here = cs.observe(outlines(frames))
    there = cs.observe(outlines([moved(pair, 77.0, (40.0, -9.0)) for pair in frames]))
    same = [n for n in here.cells if n not in ("cell", "x_um", "y_um") and "deg" not in n]
    for name in same:
        np.testing.assert_allclose(there.cells[name], here.cells[name], rtol=1e-9, atol=1e-9)
    for name in [n for n in here.pairs if n not in ("first", "second")]:
        np.testing.assert_allclose(there.pairs[name], here.pairs[name], rtol=1e-9, atol=1e-7)
    off = (there.cells["directionality_deg"] - here.cells["directionality_deg"] - 77.0) % 360.0
    assert np.nanmax(np.minimum(off, 360.0 - off)) < 1e-7
    axes = axis_difference_deg(
        there.cells["elongation_axis_deg"], here.cells["elongation_axis_deg"] + 77.0
    )
    assert axes.max() < 1e-7


@pytest.mark.parametrize(
    ("axis", "movement", "mean"),
    [(0.0, 40.0, 20.0), (170.0, 0.0, -5.0), (10.0, 180.0, -175.0), (80.0, -120.0, -110.0),
     (np.nan, 3.0, np.nan)],
)  # fmt: skip
def test_directionality_is_the_mean_of_an_axis_and_a_direction(axis, movement, mean):
    np.testing.assert_allclose(directionality_deg(axis, movement), mean, atol=1e-9)


def test_two_cells_that_walk_towards_each_other():
    frames = [
        (ellipse(6, 3, 0.0, (1.0 * k, 0.0)), ellipse(6, 3, 0.0, (30 - 1.0 * k, 0.0)))
        for k in range(5)
    ]
    table = cs.observe(outlines(frames))
    assert np.allclose(table.of("a", "movement_direction_deg")[:-1], 0.0, atol=1e-6)
    assert np.isnan(table.of("a", "movement_direction_deg")[-1])
    assert np.allclose(table.of("a", "speed_um_s")[:-1], 0.1)
    for name in ("first_to_second", "second_to_first"):
        assert np.nanmax(table.pair("a", "b", name)) < 1e-6
    np.testing.assert_allclose(table.pair("a", "b", "contour_distance"), 18 - 2.0 * np.arange(5),
                               atol=1e-4)  # fmt: skip
    assert table.motion["persistence_ratio"] == pytest.approx([1.0, 1.0])
    np.testing.assert_allclose(table.msd.msd, (0.1 * table.msd.lag) ** 2, rtol=1e-9)


def spots(paths, dt=1.0, **more):
    rows = [(k, f, *p) for k, path in enumerate(paths) for f, p in enumerate(path)]
    table = np.array(rows, dtype=float)
    links = [(i, i + 1) for i in range(len(rows) - 1) if rows[i][0] == rows[i + 1][0]]
    place = np.column_stack([table[:, 2:4], np.zeros(len(rows))])
    return cs.Tracks(frame=table[:, 1], t=dt * table[:, 1], place=place, track=table[:, 0],
                     links=np.array(links), **more)  # fmt: skip


def test_squares_of_a_diffusing_cell_lie_within_their_error_bars():
    """2 d D lag; of 60 cells the mean at each lag is within four of its standard errors."""
    rng = np.random.default_rng(5)
    steps = rng.standard_normal((60, 200, 2))
    many = cs.observe(spots(np.cumsum(steps, axis=1))).msd
    np.testing.assert_array_less(np.abs(many.msd - 2.0 * many.lag)[:20], 4 * many.error[:20])
    assert np.all(many.error[:20] > 0)
    alone = [cs.observe(spots(np.cumsum(s, axis=0)[None])).msd for s in steps[:30]]
    # the spread of single cells is what each one's own error says
    spread = np.std([a.msd[4] for a in alone], ddof=1)
    assert np.mean([a.error[4] for a in alone]) == pytest.approx(spread, rel=0.35)


def test_a_gap_counts_at_its_own_lag():
    t, x = np.array([0.0, 1.0, 3.0, 4.0]), np.array([0.0, 1.0, 3.0, 4.0])
    found = cs.observe(
        cs.Tracks(frame=t, t=t, place=np.column_stack([x, 0 * x, 0 * x]), track=[0] * 4,
                  links=[[0, 1], [1, 2], [2, 3]])
    )  # fmt: skip
    np.testing.assert_allclose(found.msd.msd, found.msd.lag**2)  # naive: row k + 1 minus row k
    assert np.allclose(found.cells["speed_um_s"][:-1], 1.0)


def test_a_run_is_read_like_its_contours_and_has_forces():
    made = run()
    table = cs.observe(made)
    again = cs.observe(top_view(made))
    for name in again.cells:
        if name != "cell":
            np.testing.assert_array_equal(table.cells[name], again.cells[name])
    told = cs.read_outs(made)
    assert table.of("cell1", "volume_um3")[-1] == pytest.approx(told["volume_end_um3"])
    assert table.of("cell1", "traction_sum_pN")[-2] == pytest.approx(told["traction_sum_pN"])
    assert table.of("cell1", "dipole")[-2] == pytest.approx(told["dipole_pN_um"])
    assert np.isnan(table.of("cell1", "dipole")[-1])
    # a sphere of radius 5 um with 189 nodes starts as a circle
    assert table.of("cell1", "area_um2")[0] == pytest.approx(np.pi * 25.0, rel=0.02)


def test_a_reduced_run_is_read_through_its_model():
    data = cs.snapshots([run()])
    model = cs.reduce(data, order=1, method=cs.PCR())
    z = np.array([model.encode(data.runs[0].x[k], data.runs[0].eta[k]) for k in range(3)])
    latent = cs.Trajectory(t=run().t[:3], x=z, states=cs.Layout([cs.Block("z", (1,))]))
    table = cs.observe(latent, model=model)
    assert table.of("cell1", "area_um2") == pytest.approx(
        cs.observe(run()).of("cell1", "area_um2")[:3], rel=0.1
    )
    with pytest.raises(cs.DataError, match="model=model"):
        cs.observe(latent)


def test_pairs_of_many_cells_are_read_on_request():
    tracks = spots([[(10.0 * k, 0.0), (10.0 * k + 1, 0.0)] for k in range(25)])
    assert not cs.observe(tracks).pairs
    near = cs.observe(tracks, within=15.0).pairs
    assert len(near["first"]) == 24 * 2
    assert np.all(near["centroid_distance_um"] == 10.0)
    with pytest.raises(cs.UnknownNameError, match="no pairs"):
        cs.observe(tracks).pair("0", "1", "centroid_distance")


def test_csv_has_its_units_in_the_header(tmp_path):
    tracks = spots([[(0.0, 0.0), (3.0, 4.0)], [(9.0, 9.0)]], length_unit="px", time_unit="frame")
    table = cs.observe(tracks)
    lines = table.to_csv(tmp_path / "a.csv").read_text().splitlines()
    assert lines[0] == "cell,t [frame],x [px],y [px],movement_direction [deg],speed [px/frame]"
    assert lines[1].startswith("0,0.0,0.0,0.0,53.13")
    assert lines[1].endswith(",5.0")
    assert lines[2].endswith(",,")  # after the last sample nothing is known
    assert lines[3].startswith("1,0.0,9.0,9.0,")
    assert "centroid_distance [px]" in table.to_csv(tmp_path / "b.csv", part="pairs").read_text()
    with pytest.raises(cs.ParameterError, match="part must be"):
        table.to_csv(tmp_path / "c.csv", part="cell")


def test_pandas(tmp_path):
    pandas = pytest.importorskip("pandas")
    frame = run().to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    assert frame.index.names == ["cell", "t_s"]
    assert frame.loc[("cell1", 0.0), "area_um2"] > 0


def test_no_spot_gives_no_row():
    nothing = cs.Tracks(frame=[], t=[], place=np.zeros((0, 3)), track=[], links=[])
    table = cs.observe(nothing)
    assert len(table.cells["cell"]) == 0
    assert "no cell" in str(table)


def test_bad_contours_are_refused():
    good = outlines([(ellipse(3, 2, n=8),)], names="a")
    with pytest.raises(cs.DataError, match="two contours in frame 0"):
        dataclasses.replace(good, cell=("a", "a"), frame=[0, 0], t=[0, 0], outline=good.outline * 2)
    with pytest.raises(cs.DataError, match="three are the least"):
        outlines([(np.eye(2),)], names="a")
