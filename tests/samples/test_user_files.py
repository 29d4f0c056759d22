"""Files of a user as they come: what the header says, odd cells, odd arrays, no files."""

import os
import warnings
import zipfile

import numpy as np
import pytest

from cellsys.errors import CellsysError, DataError, DimensionError, FileFormatError, ParameterError
from cellsys.reduction import LeastSquares, reduce
from cellsys.samples import snapshots
from cellsys.spectra import poles
from tests import naive_files

T = np.arange(40) * 0.5
X = np.exp(-0.2 * T)  # one pole at -0.2 1/s


def written(path, header, columns, between=",", comma=False, encoding="utf-8"):
    rows = [between.join(repr(float(v)) for v in row) for row in np.column_stack(columns)]
    if comma:
        rows = [row.replace(".", ",") for row in rows]
    path.write_text("\n".join([*header, *rows]) + "\n", encoding=encoding)
    return path


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("t", 1.0), ("time", 1.0), ("Time", 1.0), ("t [s]", 1.0), ("t [ms]", 1e-3),
        ("t[ms]", 1e-3), ("time (ms)", 1e-3), ("TIME/min", 60.0), ("time_ms", 1e-3),
        ("t ms", 1e-3), ("t [h]", 3600.0), ("t [\u00b5s]", 1e-6), ("t [\u03bcs]", 1e-6),
        ("t [us]", 1e-6), ("# time [ms]", 1e-3),
    ],
)  # fmt: skip
def test_time_has_the_unit_of_its_header(tmp_path, name, unit):
    path = written(tmp_path / "a.csv", [f"{name},x"], [T / unit, X])
    data = snapshots([path])
    assert data.dt == pytest.approx(0.5, rel=1e-12)  # sums of 40 rounded steps
    assert list(data.states.names) == ["x"]
    found = poles(reduce(data, order=1, method=LeastSquares()).plant())
    # printed with 17 digits: the fit of an exact line loses a few of them
    assert np.asarray(found)[0] == pytest.approx(-0.2, rel=1e-9)


def test_time_is_found_wherever_it_stands(tmp_path):
    path = written(tmp_path / "a.csv", ["x,t [ms],y"], [X, 1e3 * T, X**2])
    data = snapshots([path])
    assert list(data.states.names) == ["x", "y"]
    assert np.array_equal(data.runs[0].x, np.column_stack([X, X**2]))


@pytest.mark.parametrize("head", ["ID,x", "FRAME,x", "T,x", "time point,x", "t_x,x", "index,x"])
def test_another_first_column_is_no_time(tmp_path, head):
    path = written(tmp_path / "a.csv", [head], [np.arange(40.0), X])
    with pytest.raises(ParameterError, match=r"dt is missing.*leave out those that only count"):
        snapshots([path])
    data = snapshots([path], dt=0.5)
    assert (data.dt, list(data.states.names)) == (0.5, head.split(","))
    assert naive_files.first_column_is_time(path)[0] == 1.0  # of a number that only counts


def test_without_a_header_every_row_is_a_sample(tmp_path):
    path = written(tmp_path / "a.csv", [], [X, X**2])
    with pytest.raises(ParameterError, match="dt is missing"):
        snapshots([path])
    assert np.array_equal(snapshots([path], dt=0.5).runs[0].x, np.column_stack([X, X**2]))
    assert len(naive_files.first_column_is_time(path)[1]) == len(X) - 1  # the first one is lost


@pytest.mark.parametrize("between", [";", "\t"])
@pytest.mark.parametrize("comma", [False, True])
def test_semicolons_tabs_and_decimal_commas(tmp_path, between, comma):
    header = [between.join(["t [ms]", "x"])]
    path = written(tmp_path / "a.CSV", header, [1e3 * T, X], between, comma)
    data = snapshots([path])
    assert data.dt == pytest.approx(0.5, rel=1e-12)
    assert np.array_equal(data.runs[0].x[:, 0], X)


def test_a_byte_order_mark_and_capital_endings(tmp_path):
    path = written(tmp_path / "a.CSV", ["t,x"], [T, X], encoding="utf-8-sig")
    assert list(snapshots([path]).states.names) == ["x"]
    np.savez(tmp_path / "b.npz", x=X[:, None], dt=0.5)
    (tmp_path / "b.npz").rename(tmp_path / "b.NPZ")
    assert snapshots([tmp_path / "b.NPZ"]).dt == 0.5


def test_both_letters_mu_are_one_name(tmp_path):
    one = written(tmp_path / "a.csv", ["t,x [\u00b5m]"], [T, X])
    other = written(tmp_path / "b.csv", ["t,x [\u03bcm]"], [T, X])
    assert list(snapshots([one, other]).states.names) == ["x [\u00b5m]"]
    third = written(tmp_path / "c.csv", ["t,y"], [T, X])
    with pytest.raises(DataError, match=r"c\.csv and a\.csv have different names of columns"):
        snapshots([one, third])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("t,a,b\n0,1,2\n1,1,2\n2,1,nan\n3,1,2\n", "line 4, column 3 .'b'.*NaN or inf: 'nan'"),
        ("t,a,b\n0,1,2\n\n1,inf,2\n2,1,3\n", "line 4, column 2 .'a'.*NaN or inf: 'inf'"),
        ("t,a,b\n0,1,2\n1,,2\n2,1,3\n", "line 3, column 2 .'a'.*empty"),
        ("t,a,b\n0,1,2\n1,x,2\n2,1,3\n", "line 3, column 2 .'a'.*'x' is not a number"),
        ("t,a,b\n0,1,2\n1,1_0,2\n2,1,3\n", "line 3, column 2 .'a'.*'1_0' is not a number"),
        ("t,a\n0,1\n1,2,3\n2,3\n", "line 3: 3 cells, but 2 in line 1"),
        (",a\n0,1\n1,2\n2,3\n", "column 1 has no name"),
        ("t;a\n0;1,5\n1;1.5\n2;3\n", "line 3: decimal points and decimal commas"),
        ('t,a\n0,"1,5"\n1,2\n2,3\n', "line 2, column 2 .'a'.*'1,5' is not a number"),
        ("t [frames],a\n0,1\n1,2\n2,3\n", r"unit of time in 't \[frames\]' is not known"),
        ("t,time [ms],a\n0,0,1\n1,1,2\n2,2,3\n", "several columns of time"),
        ("t\n0\n1\n2\n", "no other"),
        ("t,a\n0,1\n1,2\n", "2 rows of numbers"),
        ("t,a\n0,1\n1,2\n2,3\n5,4\n6,5\n", "line 4 .*line 5 .*step is 3 s and usually it is 1 s"),
        ("t,a\n0,1\n1,2\n1,3\n2,4\n1,5\n0,5\n", "times must rise, but from line"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_named_with_its_place(tmp_path, content, words):
    path = tmp_path / "bad.csv"
    path.write_text(content)
    with pytest.raises(CellsysError, match=words) as raised:
        snapshots([path])
    assert "bad.csv" in str(raised.value)


def test_other_encodings_are_named(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes("t,x [µm]\n0,1\n1,2\n2,3\n".encode("latin-1"))
    with pytest.raises(FileFormatError, match="line 1: byte 0xb5 is no UTF-8"):
        snapshots([path])
    path.write_bytes("t,x\n0,1\n1,2\n2,3\n".encode("utf-16"))
    with pytest.raises(FileFormatError, match="UTF-16"):
        snapshots([path])


def test_times_and_dt_are_held_against_each_other(tmp_path):
    path = written(tmp_path / "a.csv", ["t [ms],x"], [1e3 * T, X])
    assert snapshots([path], dt=0.5).dt == 0.5
    with pytest.raises(DataError, match=r"sampled every 0\.5 s, but dt= says 500 s"):
        snapshots([path], dt=500.0)
    np.savez(tmp_path / "a.npz", x=X[:, None], dt=0.25, t=T)
    with pytest.raises(DataError, match=r"t is sampled every 0\.5 s, but a\.npz: dt says 0\.25"):
        snapshots([tmp_path / "a.npz"])


x = np.column_stack([X, X**2])


@pytest.mark.parametrize(
    ("arrays", "error", "words"),
    [
        ({"x": x.astype("U8")}, FileFormatError, "'x' holds str"),
        ({"x": x.astype("S8")}, FileFormatError, "'x' holds bytes"),
        ({"x": x.astype("datetime64[s]")}, FileFormatError, "'x' holds datetime64"),
        ({"t": T.astype("datetime64[s]")}, FileFormatError, "'t' holds datetime64"),
        ({"t": T.astype("timedelta64[s]")}, FileFormatError, "'t' holds timedelta64"),
        ({"dt": np.array("0.5")}, FileFormatError, "'dt' holds str"),
        ({"t": T[:-1]}, DimensionError, "t has 39 times for 40 samples"),
        ({"t": T[:, None]}, DimensionError, "'t' must have 1 dimensions"),
        ({"t": np.where(T == 3, np.nan, T)}, DataError, r"t\[6\] is nan"),
        ({"t": T**2}, DataError, "equally spaced, but from sample"),
        ({"dt": np.inf}, ParameterError, "dt must be a finite"),
        ({"eta": x[:-1, 0]}, DimensionError, "'eta' must have 2 dimensions"),
        ({"u": x[:-1, 0]}, DimensionError, "'u' must have 2 dimensions"),
        ({"commands": X[:-1]}, DimensionError, "'commands' must have 2 dimensions"),
        ({"W_x": np.zeros((2, 2, 2))}, DimensionError, "'W_x' must have 2 dimensions"),
        ({"W_eta": np.zeros(2)}, DimensionError, "'W_eta' must have 2 dimensions"),
        ({"x": x[None]}, DimensionError, "'x' must have 2 dimensions"),
    ],
)
def test_odd_arrays_are_named(tmp_path, arrays, error, words):
    path = tmp_path / "bad.npz"
    np.savez(path, **{"x": x, **({} if {"t", "dt"} & set(arrays) else {"dt": 0.5}), **arrays})
    with pytest.raises(error, match=words):
        snapshots([path])


def test_two_entries_of_one_name_are_refused(tmp_path):
    path = tmp_path / "twice.npz"
    np.savez(path, x=x, dt=0.5)
    with warnings.catch_warnings():  # zipfile warns of what is wanted here
        warnings.simplefilter("ignore")
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr("x.npy", archive.read("x.npy"))
    with pytest.raises(FileFormatError, match="'x' twice"):
        snapshots([path])


def test_files_that_say_different_things_of_the_matrix(tmp_path):
    for k in range(2):
        np.savez(tmp_path / f"{k}.npz", x=x, dt=0.5, W_x=k * np.eye(2))
    with pytest.raises(DataError, match=r"1\.npz and 0\.npz have different W_x"):
        snapshots([tmp_path / "0.npz", tmp_path / "1.npz"])


def test_nan_in_an_array_is_named_with_its_place():
    bad = np.zeros((300, 3))
    bad[217, 2] = np.nan
    with pytest.raises(DataError, match="at sample 217, column 2"):
        snapshots([bad], dt=1.0)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
@pytest.mark.parametrize("name", ["pipe.csv", "pipe.npz"])
def test_a_pipe_is_refused_at_once(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(FileFormatError, match="no regular file"):
        snapshots([tmp_path / name])


def test_many_columns_are_read_in_time_that_grows_with_them(tmp_path):
    """64 000 columns: counting each name among all others took minutes."""
    path = tmp_path / "wide.csv"
    names = ",".join(f"x{k}" for k in range(64_000))
    row = ",".join(["1"] * 64_000)
    path.write_text("\n".join([f"t,{names}", *(f"{k},{row}" for k in range(3))]))
    assert snapshots([path]).states.size == 64_000
    path.write_text(path.read_text().replace("x63999", "x0", 1))
    with pytest.raises(ParameterError, match="'x0'"):
        snapshots([path])
