"""The cache that studies share: where it is, what is in it, what goes first."""

import os

import pytest

from cellsys.errors import ParameterError
from cellsys.store import RunWriter
from cellsys.store.cache import MODELS, cache_folder, entries, prune, touch


def put(folder, name, size, used):
    """An entry of `size` bytes that was last used at `used`."""
    place = folder / name
    place.mkdir(parents=True)
    if place.parent.name != MODELS:
        (place / "run.json").write_text("{}")
        size -= 2
    (place / "x.npz").write_bytes(b"0" * size)
    os.utime(place, (used, used))
    return place


def test_where_it_is(monkeypatch, tmp_path):
    monkeypatch.setenv("CELLSYS_CACHE", str(tmp_path / "mine"))
    assert cache_folder() == tmp_path / "mine"
    monkeypatch.delenv("CELLSYS_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("sys.platform", "linux")
    assert cache_folder() == tmp_path / "cellsys"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "cellsys"
    assert entries(tmp_path / "nowhere") == []


def test_the_longest_unused_go_first_and_nothing_that_is_kept_or_foreign(tmp_path):
    old, new = put(tmp_path, "a", 1000, 100), put(tmp_path, "b", 2000, 300)
    learned = put(tmp_path, f"{MODELS}/c", 500, 200)
    foreign = tmp_path / "photos"
    foreign.mkdir()
    (foreign / "cat.png").write_bytes(b"0" * 9000)
    assert [(e.path, e.bytes) for e in entries(tmp_path)] == [
        (old, 1000), (learned, 500), (new, 2000)
    ]  # fmt: skip
    assert prune(tmp_path, 3500) == []
    assert [e.path for e in prune(tmp_path, 2400, keep=[old])] == [learned, new]
    assert old.exists()
    touch([old])
    assert entries(tmp_path)[0].used > 1e9
    assert [e.path for e in prune(tmp_path, 0)] == [old]
    assert foreign.exists()
    for limit in (-1.0, float("nan")):
        with pytest.raises(ParameterError, match="limit must be >= 0"):
            prune(tmp_path, limit)


def test_a_run_that_is_being_written_is_left_alone(tmp_path):
    writer = RunWriter(tmp_path / "run", {"x": (3, 2)}, {})
    dead = tmp_path / "dead.partial"
    dead.mkdir()
    (dead / "x.npy").write_bytes(b"0")
    assert [e.path.name for e in prune(tmp_path, -0.0)] == ["dead.partial"]
    assert (tmp_path / "run.partial").exists()
    writer.discard()


def test_the_command_line_says_and_cleans(call, tmp_path):
    folder = tmp_path / "out" / "runs"
    for k in range(3):
        put(folder, f"r{k}", 2_000_000, 100 + k)
    code, out, _ = call("cache")
    assert code == 0
    assert "3 entries, 6 MB" in out
    assert str(folder) in out
    code, out, _ = call("cache", "--limit", "4.5")
    assert "removed 1, 2 MB" in out
    assert not (folder / "r0").exists()
    code, out, _ = call("cache", "--clear")
    assert "0 entries" in out
    assert call("cache", "--limit", "-1")[0] == 2
    assert call("cache", "--clear", "--limit", "1")[0] == 2
