"""Runs of scenes: cached, resumable, the same numbers in one process or two."""

import os

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from cellsys.errors import FileFormatError
from cellsys.scene import Scene, run_ensemble, run_scene
from cellsys.scene import ensemble as room
from cellsys.scene.ensemble import read_run
from cellsys.scene.workers import THREADS, Workers, one_thread
from tests.mechanics.scenes import table


def scene(angle=30.0):
    spec = table()
    spec["cells"][0]["polarity"] = f"{angle} deg"
    return Scene.parse(spec)


def test_a_cached_run_is_the_run(tmp_path, monkeypatch):
    fresh = run_scene(scene())
    stored = run_scene(scene(), tmp_path)
    for name in ("x", "eta", "u", "p", "d"):
        assert np.array_equal(getattr(stored, name), getattr(fresh, name)), name

    def refuse(*args, **kwargs):
        raise RuntimeError("a cached run was computed again")

    monkeypatch.setattr(room, "simulate", refuse)
    again = run_scene(scene(), tmp_path)
    assert np.array_equal(again.x, fresh.x)
    with pytest.raises(RuntimeError, match="computed again"):
        run_scene(scene(31.0), tmp_path)


def test_a_run_folder_is_read_without_its_scene_file(tmp_path):
    stored = run_scene(scene(), tmp_path)
    folder = next(p for p in tmp_path.iterdir() if p.is_dir())
    back = read_run(folder)
    assert np.array_equal(back.x, stored.x)
    assert back.states == stored.states
    # The header lists effects by name; the columns of eta stay those of the run.
    assert back.auxiliaries == stored.auxiliaries
    rate = np.diff(back.x, axis=0) / np.diff(back.t)[:, None]
    told = back.eta @ back.W_eta.T + back.u
    assert np.allclose(told, rate, atol=1e-9 * np.abs(rate).max())  # rounding of sums of forces
    with pytest.raises(FileFormatError):
        read_run(tmp_path)


def test_one_or_two_workers_give_the_same_numbers(tmp_path):
    scenes = [scene(a) for a in (0.0, 90.0)]
    one = run_ensemble([*scenes, scenes[0]], tmp_path / "one", workers=1)
    seen = []
    two = run_ensemble(
        scenes, tmp_path / "two", workers=2, progress=lambda done, total: seen.append((done, total))
    )
    assert seen[0] == (0, 2)
    assert seen[-1] == (2, 2)
    for a, b in zip(one, two, strict=False):
        assert np.array_equal(a.x, b.x)
        assert np.array_equal(a.eta, b.eta)
    assert np.array_equal(one[0].x, one[2].x)
    assert len(list((tmp_path / "one").iterdir())) == 2


def blas_threads():
    return sorted({lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas"})


def test_workers_use_one_thread_each_unless_told_otherwise(monkeypatch):
    for name in THREADS:
        monkeypatch.delenv(name, raising=False)
    with Workers(1) as workers:
        assert list(workers.run(blas_threads, [()])) == [[1]]
    before = blas_threads()
    with one_thread():  # as a run in this process
        assert blas_threads() == [1]
    assert blas_threads() == before
    monkeypatch.setenv(THREADS[1], "2")
    with Workers(1) as workers:
        told = next(iter(workers.run(blas_threads, [()])))
    # OpenBLAS starts no more threads than there are processors
    assert told == [min(2, os.cpu_count())]
    with one_thread():
        assert blas_threads() == before
