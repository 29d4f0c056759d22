"""Contours from masks and movies: oddities, scales, and the accuracy against a known truth."""

import json

import numpy as np
import pytest

import cellsys as cs
from cellsys.observe import axis_difference_deg, contour_shape
from tests.observe.test_everything import ellipse, outlines


def disc(shape, centre, r):
    y, x = np.indices(shape)
    return (x - centre[0]) ** 2 + (y - centre[1]) ** 2 <= r**2


def movie(dtype=np.uint16):
    """Two discs that pass each other; their labels change places in the last frame."""
    frames = np.zeros((3, 40, 60), dtype)
    for k in range(3):
        one, two = (1, 2) if k < 2 else (2, 1)
        frames[k][disc((40, 60), (15 + 2 * k, 12), 7)] = one
        frames[k][disc((40, 60), (45 - 2 * k, 27), 7)] = two
    return frames


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int64, np.float32, bool])
def test_labels_are_cells_by_overlap(dtype):
    masks = cs.read_masks(movie(dtype), pixel_size=0.5, frame_interval=60.0)
    assert (masks.length_unit, masks.time_unit) == ("um", "s")
    table = cs.observe(masks)
    for cell, x in (("1", 15 + 2 * np.arange(3)), ("2", 45 - 2 * np.arange(3))):
        np.testing.assert_allclose(table.of(cell, "x_um"), 0.5 * x, atol=1e-12)
    # the pixels of the disc, less half a pixel
    pixels = (movie()[0] == 1).sum()
    assert table.of("1", "area_um2")[0] == pytest.approx(0.25 * (pixels - 0.5))
    assert np.allclose(table.of("1", "speed")[:-1], 1.0 / 60.0)
    if dtype is not bool:  # naive: the label, which changed
        kept = cs.observe(cs.read_masks(movie(dtype), identity="labels"))
        assert abs(np.diff(kept.of("1", "x_px"))).max() > 20


def test_odd_masks():
    image = np.zeros((2, 30, 40), np.uint8)
    image[0][disc((30, 40), (10, 10), 6)] = 1
    image[0, 10, 10] = 0  # a hole
    image[0, 25, 35] = 1  # a second part
    image[0][disc((30, 40), (22, 10), 6) & (image[0] == 0)] = 2  # touches the first
    image[0][disc((30, 40), (39, 25), 4) & (image[0] == 0)] = 3  # cut by the edge
    image[1, 5, 5] = 7  # one pixel
    masks = cs.read_masks(image)
    assert masks.source["holes_filled"] == 1
    assert masks.source["pixels_left_out"] == 1
    assert masks.touches_edge.tolist() == [False, False, True, False]
    table = cs.observe(masks)
    assert abs(table.pair("1", "2", "contour_distance")[0]) < 1.0
    assert table.of(masks.cell[3], "area_px2")[0] == 0.5  # a pixel less half of one
    assert cs.read_masks(np.zeros((3, 5, 5), bool)).source["empty_frames"] == 3
    corner = np.eye(2, dtype=np.uint8)[None]  # pixels that meet at a corner are two parts
    assert cs.read_masks(corner).source["pixels_left_out"] == 1


def test_a_cell_that_leaves_and_a_new_one():
    frames = np.zeros((4, 20, 30), np.uint8)
    for k in range(2):
        frames[k][disc((20, 30), (25 + 2 * k, 10), 4)] = 9
    frames[3][disc((20, 30), (6, 10), 4)] = 9
    masks = cs.read_masks(frames)
    assert masks.cell == ("1", "1", "2")
    assert masks.frame.tolist() == [0, 1, 3]
    assert masks.source["empty_frames"] == 1


@pytest.mark.parametrize("angle", [0.0, 25.0, 60.0])
def test_masks_measure_what_they_were_drawn_from(angle):
    """Within half a pixel, as the ellipse turns and moves."""
    from cellsys.io.render import coverage

    shape = ellipse(20, 9, angle, (40.3, 35.7), n=200)
    found = cs.read_masks(coverage(shape, (80, 80))[None] > 0.5)
    told, true = contour_shape(found.outline[0]), contour_shape(shape)
    assert np.linalg.norm(told.centroid - true.centroid) < 0.5
    assert axis_difference_deg(told.axis_deg, true.axis_deg) < 1.0
    assert np.sqrt(told.area / np.pi) == pytest.approx(np.sqrt(true.area / np.pi), abs=0.5)


def test_files(tmp_path):
    np.save(tmp_path / "a.npy", movie())
    assert len(cs.read_masks(tmp_path / "a.npy")) == 6
    tifffile = pytest.importorskip("tifffile")
    tifffile.imwrite(tmp_path / "a.tif", movie(), photometric="minisblack")
    (tmp_path / "many").mkdir()
    for k, plane in enumerate(movie()):
        tifffile.imwrite(tmp_path / "many" / f"m{k}.tif", plane)
    for path in (tmp_path / "a.tif", tmp_path / "many"):
        found = cs.read_masks(path)
        assert np.array_equal(found.outline[0], cs.read_masks(movie()).outline[0])
    (tmp_path / "b.tif").write_bytes((tmp_path / "a.tif").read_bytes()[:100])
    with pytest.raises(cs.FileFormatError, match=r"b\.tif"):
        cs.read_masks(tmp_path / "b.tif")


def test_what_is_no_mask_is_refused(tmp_path):
    np.save(tmp_path / "o.npy", np.array([{}, None], dtype=object), allow_pickle=True)
    with pytest.raises(cs.FileFormatError, match="never read"):
        cs.read_masks(tmp_path / "o.npy")
    huge = np.lib.format.header_data_from_array_1_0(np.zeros(1, np.uint8)) | {
        "shape": (100_000, 100_000, 100)
    }
    with (tmp_path / "h.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, huge)
    with pytest.raises(cs.FileFormatError, match="100000 x 100000 x 100"):
        cs.read_masks(tmp_path / "h.npy")
    for bad, words in (
        (np.full((2, 4, 4), 0.5), "no labels"), (np.full((2, 4, 4), -1), "label -1"),
        (np.zeros((2, 2, 4, 4, 1)), "one channel"), (np.full((1, 4, 4), 5_000_000), "1e6"),
    ):  # fmt: skip
        with pytest.raises((cs.DataError, cs.DimensionError), match=words):
            cs.read_masks(bad)
    with pytest.raises(cs.ParameterError, match="pixel_size"):
        cs.read_masks(movie(), pixel_size=0.0)
    with pytest.raises(cs.ParameterError, match="identity"):
        cs.read_masks(movie(), identity="name")
    empty = tmp_path / "e"
    empty.mkdir()
    with pytest.raises(cs.FileFormatError, match=r"holds no \.tif"):
        cs.read_masks(empty)


def test_polygons(tmp_path):
    pytest.importorskip("shapely")
    ring = [[0, 0], [4, 0], [4, 2], [0, 2], [0, 0]]
    feature = {"type": "Feature", "properties": {"cell": "A", "frame": 3},
               "geometry": {"type": "Polygon", "coordinates": [ring]}}  # fmt: skip
    (tmp_path / "a.geojson").write_text(json.dumps({"features": [feature]}))
    (tmp_path / "a.csv").write_text('cell,frame,wkt\nA,3,"POLYGON ((0 0, 4 0, 4 2, 0 2, 0 0))"\n')
    for name in ("a.geojson", "a.csv"):
        table = cs.observe(cs.read_masks(tmp_path / name, pixel_size=2.0))
        assert table.of("A", "area_um2")[0] == 32.0
        assert table.of("A", "aspect_ratio")[0] == pytest.approx(2.0)
        assert table.of("A", "elongation_axis_deg")[0] == pytest.approx(0.0)
    bow = "POLYGON ((0 0, 4 2, 4 0, 0 2, 0 0))"
    for text, words in ((bow, "cross"), ("POINT (1 1)", "a polygon"), ("POLY", "line 2")):
        (tmp_path / "b.csv").write_text(f'cell,frame,wkt\nA,3,"{text}"\n')
        with pytest.raises(cs.FileFormatError, match=words):
            cs.read_masks(tmp_path / "b.csv")


def drawn(T=4):
    frames = [
        (ellipse(9, 5, 20 + 5 * k, (0.5 * k, 0.2 * k), n=200),
         ellipse(8, 5, 110 - 4 * k, (22 - 0.4 * k, 1.0), n=200))
        for k in range(T)
    ]  # fmt: skip
    return outlines(frames)


def test_a_rendered_movie_is_measured_as_it_was_drawn():
    """At signal to noise 5: contour distance within 0.5 px, axis within 2 deg; the centroid within
    0.1 px in the root mean square (at this size of cell no estimator does better than 0.05)."""
    pytest.importorskip("skimage")
    made = cs.render_movie(drawn(), pixel_size=0.2, signal_to_noise=5.0)
    found = cs.segment_cells(made.images)
    true, told = cs.observe(made.truth), cs.observe(found)
    for a, b in (("a", "1.1"), ("b", "2.1")):
        off = np.hypot(*(told.of(b, n) - true.of(a, n) for n in ("x_px", "y_px")))
        assert np.sqrt(np.mean(off**2)) < 0.1
        axes = axis_difference_deg(
            told.of(b, "elongation_axis_deg"), true.of(a, "elongation_axis_deg")
        )
        assert axes.max() < 2.0
    gaps = told.pair("1.1", "2.1", "contour_distance") - true.pair("a", "b", "contour_distance")
    assert np.abs(gaps).max() < 0.5


def test_cells_that_touch_are_parted():
    pytest.importorskip("skimage")
    from cellsys.io.render import coverage

    shapes = [ellipse(15, 15, 0, c, n=80) for c in ((25, 30), (52, 30))]
    image = np.clip(sum(coverage(s, (60, 80)) for s in shapes), 0, 1)
    found = cs.segment_cells(1000.0 * np.stack([image, image]))
    assert sorted(set(found.cell)) == ["1", "2"]
    centres = [contour_shape(c).centroid for c in found.outline[:2]]
    np.testing.assert_allclose(sorted(c[0] for c in centres), [25, 52], atol=1.0)


def test_render_is_seeded_and_saved(tmp_path):
    made = cs.render_movie(drawn(2), pixel_size=0.5)
    assert np.array_equal(made.images, cs.render_movie(drawn(2), pixel_size=0.5).images)
    assert not np.array_equal(made.images, cs.render_movie(drawn(2), pixel_size=0.5, seed=1).images)
    assert made.images.dtype == np.uint16
    clean = cs.render_movie(drawn(2), pixel_size=0.5, blur=0.0, signal_to_noise=1e9).images
    # the share of every pixel adds up to the area: exact along x, by eight lines along y
    area = (clean[0, 0].astype(float) - 20000).sum() / 6000
    assert area == pytest.approx(contour_shape(made.truth.outline[0]).area, rel=2e-3)
    tifffile = pytest.importorskip("tifffile")
    back = tifffile.imread(made.save(tmp_path / "a.tif"))
    assert np.array_equal(back, made.images)


def test_bad_movies_are_refused():
    pytest.importorskip("skimage")
    with pytest.raises(cs.DataError, match="frame 1"):
        cs.segment_cells(np.stack([np.eye(20), np.full((20, 20), np.nan)]))
    with pytest.raises(cs.ParameterError, match="threshold"):
        cs.segment_cells(np.ones((1, 9, 9)), threshold="mean")
    assert len(cs.segment_cells(np.ones((2, 30, 30)))) == 0
    with pytest.raises(cs.DataError, match="um and s"):
        cs.render_movie(cs.read_masks(movie()))
