"""A user's own runs: npz and csv files, their names, blocks and mistakes."""

import numpy as np
import pytest

from cellsys.errors import (
    CellsysError,
    DataError,
    DimensionError,
    FileFormatError,
    ParameterError,
    UnusedDataWarning,
)
from cellsys.reduction import LeastSquares, reduce
from cellsys.samples import snapshots


def write_csv(path, x, dt=0.5, header="time,a,b", times=None):
    t = dt * np.arange(len(x)) if times is None else times
    lines = [header, *(",".join(repr(float(v)) for v in row) for row in np.column_stack([t, x]))]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def x():
    return np.random.default_rng(0).standard_normal((20, 2)).cumsum(axis=0)


def test_csv_and_npz_and_arrays_give_the_same_data(tmp_path, x):
    csv = write_csv(tmp_path / "a.csv", x)
    np.savez(tmp_path / "a.npz", x=x, dt=0.5)
    np.savez(tmp_path / "b.npz", x=x, t=0.5 * np.arange(20))
    all_of = [
        snapshots([csv]), snapshots([tmp_path / "a.npz"]), snapshots([str(tmp_path / "b.npz")]),
        snapshots([x], dt=0.5),
    ]  # fmt: skip
    for data in all_of:
        assert data.dt == 0.5
        assert np.array_equal(data.runs[0].x, x)
    assert all_of[0].states.names == ["a", "b"] or list(all_of[0].states.names) == ["a", "b"]
    mixed = snapshots([csv, tmp_path / "a.npz"])
    assert len(mixed.runs) == 2
    model = reduce(mixed, order=2, method=LeastSquares())
    assert model.dt == 0.5


def test_blank_lines_and_a_byte_order_mark_are_fine(tmp_path, x):
    path = write_csv(tmp_path / "a.csv", x)
    path.write_text("\ufeff" + path.read_text() + "\n\n", encoding="utf-8")
    data = snapshots([path])
    assert np.array_equal(data.runs[0].x, x)


@pytest.mark.parametrize(
    "content",
    [
        b"", b"\n", b"time,a\n", b"time,a\n0,1\n", b"time,a\n0,1\n1,x\n2,3\n", b"\xff\xfe\x00\x01",
        b"time,a\n0,1\n1,2,3\n2,3\n", b"time\n0\n1\n2\n", b"PK\x03\x04", b"time,a\n0,1\n0,1\n0,1\n",
        b"time,a\n2,1\n1,1\n0,1\n", b"time,a\nnan,1\nnan,1\nnan,1\n", b"time,a\n0,1\n1,nan\n2,3\n",
        b"time,a\n0,1\n1,2\n5,3\n",
    ],
)  # fmt: skip
def test_bad_csv_files_are_refused(tmp_path, content):
    path = tmp_path / "bad.csv"
    path.write_bytes(content)
    with pytest.raises(CellsysError):
        snapshots([path])


def test_arrays_under_unknown_names_are_not_dropped_without_a_word(tmp_path, x):
    np.savez(tmp_path / "a.npz", x=x, dt=0.5, command=x)
    with pytest.warns(UnusedDataWarning, match=r"not used: 'command'; known names are dt"):
        snapshots([tmp_path / "a.npz"])


@pytest.mark.filterwarnings("ignore::cellsys.errors.UnusedDataWarning")
def test_bad_npz_files_are_refused(tmp_path, x):
    path = tmp_path / "bad.npz"
    np.savez(path, x=x, dt=0.5)
    whole = path.read_bytes()
    for length in (0, 1, 30, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(FileFormatError, match=r"bad\.npz"):
            snapshots([path])
    for position in range(0, len(whole), 11):
        broken = bytearray(whole)
        broken[position] ^= 0xFF
        path.write_bytes(broken)
        try:
            snapshots([path])
        except CellsysError:
            continue
    for arrays, error in (
        ({"y": x, "dt": 0.5}, FileFormatError),
        ({"x": x.astype(object), "dt": 0.5}, FileFormatError),
        ({"x": x[:, 0], "dt": 0.5}, DimensionError),
        ({"x": x, "dt": np.array("fast")}, CellsysError),
        ({"x": x, "dt": np.array([1.0, 2.0])}, CellsysError),
        ({"x": np.array([["a", "b"]] * 9), "dt": 0.5}, CellsysError),
        ({"x": x, "dt": 0.5, "eta": x[:-1], "W_eta": np.full((2, 2), np.nan)}, CellsysError),
        ({"x": x, "dt": 0.5, "W_x": np.eye(3)}, CellsysError),
        ({"x": x, "dt": 0.5, "eta": x}, CellsysError),
        ({"x": x, "dt": 0.5, "eta": x[:-1], "W_eta": np.eye(3)}, CellsysError),
        ({"x": x, "dt": -0.5}, ParameterError),
        ({"x": x, "dt": np.nan}, ParameterError),
        ({"x": x}, ParameterError),
        ({"x": x, "t": np.arange(20.0) ** 2}, DataError),
    ):
        np.savez(path, **arrays)
        with pytest.raises(error):
            reduce(snapshots([path]), order=1, method=LeastSquares())
    np.save(tmp_path / "array.npy", x)
    (tmp_path / "array.npy").rename(path)
    with pytest.raises(FileFormatError):
        snapshots([path])


def test_missing_files_and_other_kinds(tmp_path, x):
    for name in ("absent.csv", "absent.npz"):
        with pytest.raises(FileNotFoundError, match=name):
            snapshots([tmp_path / name])
    with pytest.raises(ParameterError, match=r"neither \.npz nor \.csv"):
        snapshots([tmp_path / "a.txt"])
    for name in ("folder.csv", "folder.npz"):
        (tmp_path / name).mkdir()
        with pytest.raises((CellsysError, OSError)):
            snapshots([tmp_path / name])
    a = write_csv(tmp_path / "a.csv", x)
    b = write_csv(tmp_path / "b.csv", x, dt=0.25)
    with pytest.raises(DataError, match=r"b\.csv is sampled every 0\.25 s"):
        snapshots([a, b])


def test_eta_and_inputs_of_a_file_are_used(tmp_path):
    rng = np.random.default_rng(1)
    T, n = 60, 3
    eta, u = rng.standard_normal((T - 1, 2)), rng.standard_normal((T - 1, n))
    W_x, W_eta = -0.3 * np.eye(n), rng.standard_normal((n, 2))
    x = np.zeros((T, n))
    for k in range(T - 1):
        x[k + 1] = x[k] + 0.1 * (W_x @ x[k] + W_eta @ eta[k] + u[k])
    np.savez(tmp_path / "a.npz", x=x, eta=eta, u=u, W_x=W_x, W_eta=W_eta, dt=0.1)
    blocks = {"field": [2, 0], "component": [1]}
    data = snapshots([tmp_path / "a.npz"], blocks=blocks)
    run = data.runs[0]
    rate = np.diff(run.x, axis=0) / 0.1
    right = run.x[:-1] @ data.W_x.T + run.eta @ data.W_eta.T + run.u
    # columns, rows of the matrices and the input are reordered alike
    assert np.abs(rate - right).max() < 1e-12 * 100
    assert reduce(data, order=3).order == 3
