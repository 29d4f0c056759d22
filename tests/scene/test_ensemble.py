"""Runs of scenes: cached, resumable, the same numbers in one process or two."""

import json
import platform
import shutil

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from cellsys.errors import DamagedRunWarning, FileFormatError, ForeignRunWarning, LostRunError
from cellsys.scene import Scene, run_ensemble, run_scene
from cellsys.scene import ensemble as room
from cellsys.scene.ensemble import read_run
from cellsys.scene.workers import Workers
from cellsys.store import processor
from cellsys.threads import one_thread
from tests.mechanics.scenes import table
from tests.study.scenes import TINY


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


def flip(path, at=-9):
    data = bytearray(path.read_bytes())
    data[at] ^= 0x10
    path.write_bytes(bytes(data))


DAMAGES = {
    "a byte of an array": lambda run: flip(run / "x.npy"),
    "an array cut short": lambda run: (run / "eta.npy").write_bytes(
        (run / "eta.npy").read_bytes()[:-500]
    ),
    "an array removed": lambda run: (run / "u.npy").unlink(),
    "an array of other values": lambda run: np.save(run / "x.npy", 2.0 * np.load(run / "x.npy")),
    "its description removed": lambda run: (run / "run.json").unlink(),
    "its description cut": lambda run: (run / "run.json").write_text('{"schema": 1, "hea'),
    "an empty folder": lambda run: [path.unlink() for path in run.iterdir()],
    "a file in its place": lambda run: (shutil.rmtree(run), run.write_text("")),
    "events of another run": lambda run: (run / "run.json").write_text(
        json.dumps(json.loads((run / "run.json").read_text()) | {"metadata": {"events": 3}})
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_run_is_made_again_with_one_warning(damage, tmp_path):
    whole = run_ensemble([scene()], tmp_path)[0].x.copy()
    folder = tmp_path / room.run_name(scene())
    DAMAGES[damage](folder)
    with pytest.warns(DamagedRunWarning, match="made again") as told:
        again = run_ensemble([scene(), scene()], tmp_path)
    assert len(told) == 1
    assert np.array_equal(again[0].x, whole)
    # naive: a header that can be read makes a run; here it is whole again, and said no more
    assert np.array_equal(read_run(folder).x, whole)
    assert np.array_equal(run_scene(scene(), tmp_path).x, whole)


def test_the_command_line_says_it_in_one_line(call, tmp_path):
    (tmp_path / "s.toml").write_text(TINY.replace('"40 s"', '"10 s"'))
    sweep = ("sweep", "s.toml", "--set", "seed=1", "-o", "out", "--json")
    code, before, _ = call(*sweep)
    assert code == 0
    flip(next((tmp_path / "out" / "runs").glob("*/x.npy")))
    code, out, err = call(*sweep)
    assert (code, out) == (0, before)
    assert err.count("\n") == 1
    assert err.startswith("cellsys: array 'x' of run")
    assert call(*sweep)[2] == ""


def test_read_run_refuses_what_is_not_as_it_was_written(tmp_path):
    run_scene(scene(), tmp_path)
    folder = tmp_path / room.run_name(scene())
    flip(folder / "x.npy")
    with pytest.raises(FileFormatError, match=r"array 'x' .* is damaged"):
        read_run(folder)


@pytest.mark.parametrize("what", ["run", "cache"])
def test_a_folder_removed_while_running_is_noticed_at_the_next_sample(what, tmp_path):
    samples = []

    def remove(share):
        samples.append(share)
        if len(samples) == 2:
            shutil.rmtree(next(tmp_path.glob("runs/*.partial")) if what == "run" else tmp_path)

    with pytest.raises(LostRunError, match="removed while"):
        run_scene(scene(), tmp_path / "runs", progress=remove)
    assert len(samples) == 2  # of more


# The kind of processor


def test_another_kind_of_processor_has_its_own_runs(tmp_path, monkeypatch):
    """Another order of sums: the last digits differ, and nothing else would tell."""
    here = scene().fingerprint()
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    processor.processor_kind.cache_clear()
    try:
        assert "generic" in processor.processor_kind()
        assert scene().fingerprint() != here
    finally:
        monkeypatch.undo()
        processor.processor_kind.cache_clear()
    assert scene().fingerprint() == here


def test_the_kind_names_compiler_target_vectors_and_blas():
    kind = processor.processor_kind()
    assert platform.machine() in kind
    blas = {i["internal_api"] for i in threadpool_info() if i["user_api"] == "blas"}
    assert all(name in kind for name in blas)


def test_runs_of_another_kind_in_an_ensemble_are_told(tmp_path, monkeypatch):
    """As of a cluster of two kinds of machines that share one folder."""
    with monkeypatch.context() as there:
        there.setattr(room, "processor_kind", lambda: "a machine of another kind")
        room._make(scene(), tmp_path / room.run_name(scene()))
    with pytest.warns(ForeignRunWarning, match=r"1 of 2 runs .*a machine of another kind"):
        run_ensemble([scene(), scene(90.0)], tmp_path)


def blas_threads():
    return sorted({lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas"})


def test_small_matrices_are_looped_over_in_one_thread_whatever_was_set():
    with threadpool_limits(2):
        with Workers(1) as workers:
            assert list(workers.run(blas_threads, [()])) == [[1]]
        before = blas_threads()
        with one_thread():  # as a run in this process
            assert blas_threads() == [1]
            with one_thread():
                pass
            assert blas_threads() == [1]
        assert blas_threads() == before
