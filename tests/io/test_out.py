"""What leaves the toolbox is read back by the programs it is written for, and by ourselves."""

import numpy as np
import pytest
import scipy.io

import cellsys as cs
from cellsys.io.trace import Followed
from tests.good_arguments import run
from tests.observe.test_everything import ellipse, outlines


def test_vtk_series_opens_with_its_fields(tmp_path):
    made = run()
    path = cs.write_vtk(made, tmp_path / "a", every=2)
    assert path.name == "run.pvd"
    assert len(list((tmp_path / "a").glob("*.vtu"))) == 2 * 2
    pyvista = pytest.importorskip("pyvista")
    reader = pyvista.get_reader(path)
    assert list(reader.time_values) == [0.0, 10.0]
    cell = pyvista.read(tmp_path / "a" / "cell1_00002.vtu")
    matrix = pyvista.read(tmp_path / "a" / "matrix_00002.vtu")
    # single precision of um
    np.testing.assert_allclose(cell.points, made.block("cell1.position")[2], atol=1e-5)
    np.testing.assert_allclose(
        matrix.point_data["displacement"], made.block("matrix.displacement")[2], atol=1e-5
    )
    pull = cell.point_data["cell1.focal_adhesion"]
    np.testing.assert_allclose(pull, made.auxiliary("cell1.focal_adhesion")[2], rtol=1e-6)
    assert cell.field_data["cell1.focal_adhesion unit"][0] == "pN"
    assert np.array_equal(cell.cells.reshape(-1, 4)[:, 1:], made.geometry["cell1.triangles"])
    assert matrix.n_cells == len(made.geometry["matrix.fibres"])


def test_vtk_fields_are_chosen_by_name(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    cs.write_vtk(run(), tmp_path / "a", fields=["displacement"], every=3)
    assert pyvista.read(tmp_path / "a" / "cell1_00000.vtu").point_data.keys() == ["displacement"]
    with pytest.raises(cs.UnknownNameError, match=r"cell1\.focal_adhesion"):
        cs.write_vtk(run(), tmp_path / "b", fields=["force"])
    with pytest.raises(cs.DataError, match="neither a membrane"):
        cs.write_vtk(cs.Trajectory(t=[0, 1], x=np.ones((2, 1)), states=cs.Layout(["x"])), tmp_path)


def test_a_mesh_series_is_read_as_snapshots(tmp_path):
    pytest.importorskip("pyvista")
    path = cs.write_vtk(run(), tmp_path / "a", fields=["displacement"])
    data = cs.read_mesh_series(path)
    assert data.dt == 5.0
    assert [b.name for b in data.states] == ["position", "displacement"]
    x = np.asarray(data.runs[0].x)[:, :567].reshape(-1, 189, 3)
    np.testing.assert_allclose(x, run().block("cell1.position"), atol=1e-5)
    files = sorted((tmp_path / "a").glob("matrix_*.vtu"))
    assert cs.read_mesh_series(files, dt=5.0).states.size == 2 * 1200
    with pytest.raises(cs.ParameterError, match="dt is missing"):
        cs.read_mesh_series(files)
    with pytest.raises(cs.ParameterError, match="steps of 5"):
        cs.read_mesh_series(path, dt=2.0)
    with pytest.raises(cs.FileFormatError, match="lacks the point array 'position'"):
        cs.read_mesh_series([*files[:3], tmp_path / "a" / "cell1_00000.vtu"], dt=5.0)
    text = path.read_text()
    path.write_text(text.replace("cell1_00000.vtu", "../../etc/passwd"))
    with pytest.raises(cs.FileFormatError, match="outside its folder"):
        cs.read_mesh_series(path)


def test_xarray_has_names_units_and_provenance(tmp_path):
    xarray = pytest.importorskip("xarray")
    made = run()
    data = made.to_xarray()
    assert data["cell1_position"].dims == ("time", "cell1_node", "xyz")
    assert data["cell1_position"].attrs["units"] == "um"
    assert data["load_cell1_focal_adhesion"].dims == ("interval", "cell1_node", "xyz")
    data.to_netcdf(tmp_path / "a.nc", engine="scipy")
    with xarray.open_dataset(tmp_path / "a.nc", engine="scipy") as back:
        np.testing.assert_array_equal(back["cell1_position"], made.block("cell1.position"))
        np.testing.assert_array_equal(
            back["load_cell1_focal_adhesion"], made.auxiliary("cell1.focal_adhesion")
        )
        assert '"name": "tiny"' in back.attrs["provenance"]


def test_a_movie(tmp_path):
    target = cs.write_movie(run(), tmp_path / "a.gif", every=2, width=200)
    assert target.read_bytes()[:3] == b"GIF"
    with pytest.raises(cs.ParameterError, match="must end"):
        cs.write_movie(run(), tmp_path / "a.avi")


def test_tracks_come_back_with_their_splits(tmp_path):
    tracks = cs.Tracks(
        frame=[0, 1, 2, 2, 4], t=[0, 30, 60, 60, 120], track=[1] * 5,
        place=np.arange(15.0).reshape(5, 3) / 7.0, links=[[0, 1], [1, 2], [1, 3], [3, 4]],
    )  # fmt: skip
    back = cs.read_tracks(cs.write_tracks(tracks, tmp_path / "a.csv"))
    assert (back.length_unit, back.time_unit) == ("um", "s")
    assert np.array_equal(back.place, tracks.place)
    assert [len(v) for v in (back.splits, back.gaps)] == [1, 1]
    assert sorted(map(len, back.cells.values())) == sorted(map(len, tracks.cells.values()))


def test_contours_come_back(tmp_path):
    pytest.importorskip("shapely")
    made = outlines([(ellipse(4, 2, n=12), ellipse(4, 2, 10, (9, 9), n=12))] * 2)
    back = cs.read_masks(cs.write_outlines(made, tmp_path / "a.geojson"))
    assert (back.length_unit, back.time_unit) == ("um", "s")
    assert back.cell == made.cell
    assert all(np.array_equal(a, b) for a, b in zip(back.outline, made.outline, strict=True))
    assert np.array_equal(back.t, made.t)
    with pytest.raises(cs.ParameterError, match="in um already"):
        cs.read_masks(tmp_path / "a.geojson", pixel_size=2.0)


def physicell(folder, k, ids):
    """A snapshot as PhysiCell writes it, by code of its own."""
    table = np.zeros((5, len(ids)))
    table[0], table[1:4], table[4] = ids, np.arange(3)[:, None] + k, 1.0
    scipy.io.savemat(folder / f"output{k:08d}_cells.mat", {"cells": table}, format="4")
    labels = "".join(
        f'<label index="{i}" size="{n}">{name}</label>'
        for i, n, name in ((0, 1, "ID"), (1, 3, "position"), (4, 1, "cell_type"))
    )
    (folder / f"output{k:08d}.xml").write_text(
        f'<MultiCellDS><metadata><current_time units="min">{60.0 * k}</current_time></metadata>'
        '<microenvironment><domain><mesh units="micron"/></domain></microenvironment>'
        f'<custom><simplified_data source="PhysiCell"><labels>{labels}</labels>'
        f"<filename>output{k:08d}_cells.mat</filename></simplified_data></custom></MultiCellDS>"
    )


def test_physicell(tmp_path):
    for k, ids in enumerate([[3, 7], [3, 7, 9], [3, 9]]):
        physicell(tmp_path, k, ids)
    tracks = cs.read_physicell(tmp_path)
    assert (tracks.length_unit, tracks.time_unit) == ("um", "s")
    assert {c: len(r) for c, r in tracks.cells.items()} == {"3": 3, "7": 2, "9": 2}
    assert np.array_equal(tracks.times("9"), [3600.0, 7200.0])
    assert np.array_equal(tracks.path("3")[1], [1.0, 2.0, 3.0])
    text = (tmp_path / "output00000001.xml").read_text()
    (tmp_path / "output00000001.xml").write_text(text.replace("<filename>", "<filename>../"))
    with pytest.raises(cs.FileFormatError, match="outside its folder"):
        cs.read_physicell(tmp_path)
    (tmp_path / "e").mkdir()
    with pytest.raises(cs.FileFormatError, match="holds no output"):
        cs.read_physicell(tmp_path / "e")


def test_a_measured_fibre_field(tmp_path):
    nodes, u = np.random.default_rng(0).normal(size=(2, 6, 3)) * 1e-6
    np.savez(tmp_path / "a.npz", **{"solvers/0/mesh/R": nodes, "solvers/0/mesh/U": u,
                                    "solvers/1/mesh/R": nodes, "solvers/1/mesh/U": 2 * u,
                                    "solvers/0/mesh/f": u, "solvers/1/mesh/f": u})  # fmt: skip
    field = cs.read_fibre_field(tmp_path / "a.npz")
    np.testing.assert_allclose(field.displacement, 1e6 * np.stack([u, 2 * u]))
    np.testing.assert_allclose(field.force[0], 1e12 * u)
    np.savez(tmp_path / "b.npz", R=np.array([{}], dtype=object), U=u)
    with pytest.raises(cs.FileFormatError, match="R hold pickled objects"):
        cs.read_fibre_field(tmp_path / "b.npz")
    np.savez(tmp_path / "c.npz", x=u)
    with pytest.raises(cs.FileFormatError, match="no nodes"):
        cs.read_fibre_field(tmp_path / "c.npz")


def test_a_cell_is_followed_where_its_overlap_is_greatest():
    first, second = np.zeros((2, 9, 20), int)
    first[:, 2:8], first[:, 10:16] = 1, 2
    second[:, 4:10], second[:, 12:18] = 8, 5
    followed = Followed()
    assert followed.frame(first) == {1: 1, 2: 2}
    assert followed.frame(second) == {8: 1, 5: 2}
