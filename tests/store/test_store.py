"""Files: what goes in comes out; what is truncated, foreign or pickled is refused."""

import json
import pickle
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellsys.errors import FileFormatError, MemoryBudgetError
from cellsys.store import (
    RunReader,
    RunWriter,
    atomic_path,
    fingerprint,
    load_archive,
    save_archive,
    write_json,
)


def saved(folder):
    arrays = {"A": np.arange(6.0).reshape(2, 3), "k": np.array([1, 2]), "empty": np.zeros((0, 3))}
    return save_archive(folder / "m", "model", 3, arrays, {"names": ["a", "b"], "dt": 0.5}), arrays


def test_archives_come_back_as_they_were(tmp_path):
    path, arrays = saved(tmp_path)
    assert path.name == "m.npz"
    found, metadata = load_archive(path, "model", 3)
    assert set(found) == set(arrays)
    for name, value in arrays.items():
        assert np.array_equal(found[name], value)
        assert found[name].dtype == value.dtype
    assert metadata == {"names": ["a", "b"], "dt": 0.5}
    assert [p.name for p in tmp_path.iterdir()] == ["m.npz"]


def test_every_truncation_is_refused(tmp_path):
    path, _ = saved(tmp_path)
    data = path.read_bytes()
    cut = tmp_path / "cut.npz"
    for length in [*range(0, len(data) - 1, 97), len(data) - 1]:
        cut.write_bytes(data[:length])
        with pytest.raises(FileFormatError, match=r"cut\.npz"):
            load_archive(cut, "model", 3)


@settings(max_examples=60, deadline=None)
@given(position=st.integers(0, 10**6), value=st.integers(0, 255))
def test_a_changed_byte_gives_the_data_or_a_refusal(tmp_path_factory, position, value):
    folder = tmp_path_factory.mktemp("byte")
    path, arrays = saved(folder)
    data = bytearray(path.read_bytes())
    data[position % len(data)] = value
    path.write_bytes(bytes(data))
    try:
        found, _ = load_archive(path, "model", 3)
    except FileFormatError:
        return
    # Zip checks every entry by CRC; bytes outside any entry's data do not matter.
    for name, value_of in found.items():
        assert np.array_equal(value_of, arrays[name])


def test_foreign_files_are_refused(tmp_path):
    plain = tmp_path / "plain.npz"
    np.savez(plain, A=np.eye(2))
    with pytest.raises(FileFormatError, match="not written by cellsys"):
        load_archive(plain, "model", 3)
    for name, content in (("text.npz", b"hello"), ("empty.npz", b"")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FileFormatError, match=name):
            load_archive(tmp_path / name, "model", 3)
    single = tmp_path / "array.npz"
    with single.open("wb") as file:
        np.save(file, np.eye(3))
    with pytest.raises(FileFormatError):
        load_archive(single, "model", 3)
    with zipfile.ZipFile(tmp_path / "zip.npz", "w") as archive:
        archive.writestr("readme.txt", "nothing here")
    with pytest.raises(FileFormatError):
        load_archive(tmp_path / "zip.npz", "model", 3)
    with pytest.raises(FileNotFoundError, match="no file"):
        load_archive(tmp_path / "absent.npz", "model", 3)
    with pytest.raises(FileFormatError):
        load_archive(tmp_path, "model", 3)


class _Payload:
    def __reduce__(self):
        return (pytest.fail, ("a pickle was run",))


def test_pickles_are_never_run(tmp_path):
    """A bare pickle, an npz with an object array, and a pickle in place of the header."""
    (tmp_path / "a.npz").write_bytes(pickle.dumps(_Payload()))
    objects = np.array([_Payload()], dtype=object)
    np.savez(tmp_path / "b.npz", A=objects, cellsys=np.array("{}"))
    np.savez(tmp_path / "c.npz", cellsys=objects)
    header = json.dumps({"kind": "model", "version": 3, "metadata": {}})
    np.savez(tmp_path / "d.npz", A=objects, cellsys=np.array(header))
    for name in "abcd":
        with pytest.raises(FileFormatError):
            load_archive(tmp_path / f"{name}.npz", "model", 3)
    with pytest.raises(FileFormatError, match="holds objects"):
        save_archive(tmp_path / "e", "model", 3, {"A": objects}, {})
    assert not (tmp_path / "e.npz").exists()


def test_kind_and_version_are_checked(tmp_path):
    path, _ = saved(tmp_path)
    with pytest.raises(FileFormatError, match="holds a 'model', expected a 'snapshots'"):
        load_archive(path, "snapshots", 3)
    for version in (2, 4):
        with pytest.raises(FileFormatError, match=f"reads {version}"):
            load_archive(path, "model", version)


@pytest.mark.parametrize("header", ["[]", "3", "null", '"x"', "{}", "not json"])
def test_odd_headers_are_refused(tmp_path, header):
    np.savez(tmp_path / "h.npz", cellsys=np.array(header))
    with pytest.raises(FileFormatError):
        load_archive(tmp_path / "h.npz", "model", 3)


def test_a_failed_write_leaves_the_old_file(tmp_path):
    target = tmp_path / "r.json"
    write_json(target, {"a": 1})
    with pytest.raises(ValueError, match="JSON"):
        write_json(target, {"a": float("nan")})

    def interrupted():
        with atomic_path(target) as temporary:
            temporary.write_text("half")
            raise KeyError("stop")

    with pytest.raises(KeyError):
        interrupted()
    assert json.loads(target.read_text()) == {"a": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["r.json"]


@given(st.lists(st.floats(allow_nan=False), max_size=5))
def test_fingerprints_tell_values_shapes_and_order_apart(values):
    a = np.array(values)
    assert fingerprint(a) == fingerprint(a.copy())
    assert fingerprint({"x": 1, "y": values}) == fingerprint({"y": values, "x": 1})
    assert fingerprint(a) != fingerprint(a.reshape(-1, 1))
    assert fingerprint(a) != fingerprint(a.view(np.int64))
    assert fingerprint("a", "b") != fingerprint("b", "a")
    assert fingerprint("ab") != fingerprint("a", "b")
    assert fingerprint(np.asfortranarray(np.eye(2) + [[0, 1], [0, 0]])) == fingerprint(
        np.eye(2) + [[0, 1], [0, 0]]
    )


SHAPES = {"x": (4, 3), "eta": (3, 5)}


def test_a_finished_run_is_read_back(tmp_path):
    writer = RunWriter(tmp_path / "run", SHAPES, {"scene": "a"})
    assert not writer.resumed
    writer.arrays["x"][:] = np.arange(12.0).reshape(4, 3)
    assert not (tmp_path / "run").exists()
    writer.finish({"wall_time": 1.0})
    run = RunReader(tmp_path / "run")
    assert run.header == {"scene": "a"}
    assert run.metadata == {"wall_time": 1.0}
    assert np.array_equal(run.arrays["x"], np.arange(12.0).reshape(4, 3))
    with pytest.raises(ValueError, match="read-only"):
        run.arrays["x"][0, 0] = 1.0
    assert not (tmp_path / "run.partial").exists()


def test_an_interrupted_run_goes_on_only_for_the_same_header(tmp_path):
    writer = RunWriter(tmp_path / "run", SHAPES, {"scene": "a"})
    writer.arrays["x"][:2] = 7.0
    writer.checkpoint({"x": np.full(3, 7.0)}, {"sample": 1})
    again = RunWriter(tmp_path / "run", SHAPES, {"scene": "a"})
    assert again.resumed
    arrays, metadata = again.last_checkpoint()
    assert metadata == {"sample": 1}
    assert np.array_equal(arrays["x"], np.full(3, 7.0))
    assert np.all(again.arrays["x"][:2] == 7.0)
    for shapes, header in ((SHAPES, {"scene": "b"}), ({**SHAPES, "x": (5, 3)}, {"scene": "b"})):
        other = RunWriter(tmp_path / "run", shapes, header)
        assert not other.resumed
        assert other.last_checkpoint() is None
        assert not other.arrays["x"].any()


@pytest.mark.parametrize("damage", ["checkpoint", "array", "header"])
def test_a_damaged_partial_run_starts_afresh(tmp_path, damage):
    writer = RunWriter(tmp_path / "run", SHAPES, {})
    writer.checkpoint({"x": np.zeros(3)}, {"sample": 1})
    name = {"checkpoint": "checkpoint.npz", "array": "eta.npy", "header": "header.json"}[damage]
    path = tmp_path / "run.partial" / name
    path.write_bytes(path.read_bytes()[:40])
    again = RunWriter(tmp_path / "run", SHAPES, {})
    assert again.last_checkpoint() is None


def test_damaged_finished_runs_are_refused(tmp_path):
    def finished(name):
        writer = RunWriter(tmp_path / name, SHAPES, {})
        writer.finish({})
        return tmp_path / name

    folder = finished("cut")
    path = folder / "x.npy"
    path.write_bytes(path.read_bytes()[:-8])
    with pytest.raises(FileFormatError):
        RunReader(folder)
    folder = finished("shape")
    np.save(folder / "x.npy", np.zeros((2, 3)))
    with pytest.raises(FileFormatError, match="damaged"):
        RunReader(folder)
    folder = finished("pickle")
    with (folder / "x.npy").open("wb") as file:
        np.save(file, np.array([_Payload()], dtype=object), allow_pickle=True)
    with pytest.raises(FileFormatError):
        RunReader(folder)
    folder = finished("schema")
    text = (folder / "run.json").read_text().replace('"schema": 1', '"schema": 99')
    (folder / "run.json").write_text(text)
    with pytest.raises(FileFormatError, match="schema 99"):
        RunReader(folder)
    folder = finished("json")
    (folder / "run.json").write_text("[1, 2]")
    with pytest.raises(FileFormatError):
        RunReader(folder)
    with pytest.raises(FileFormatError, match="not a complete"):
        RunReader(tmp_path / "absent")
    (tmp_path / "half.partial").mkdir()
    with pytest.raises(FileFormatError, match="not a complete"):
        RunReader(tmp_path / "half")


def test_a_run_larger_than_the_disk_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(MemoryBudgetError, match="GB on disk"):
        RunWriter(tmp_path / "run", {"x": (10**9, 10**6)}, {})
    assert list(tmp_path.iterdir()) == []


def test_finishing_again_replaces_the_old_run(tmp_path):
    for value in (1.0, 2.0):
        writer = RunWriter(tmp_path / "run", SHAPES, {})
        writer.arrays["x"][:] = value
        writer.finish({"value": value})
    assert RunReader(tmp_path / "run").metadata == {"value": 2.0}
    assert np.all(RunReader(tmp_path / "run").arrays["x"] == 2.0)
