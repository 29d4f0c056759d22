"""The same ensemble on executors of all kinds: bitwise the same runs."""

import multiprocessing
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

from cellsys.errors import CellsysError, ParameterError
from cellsys.scene import Scene, run_ensemble
from cellsys.scene import ensemble as room
from tests.mechanics.scenes import table


def scenes(count=2):
    out = []
    for k in range(count):
        spec = table()
        spec["cells"][0]["polarity"] = f"{90.0 * k} deg"
        out.append(Scene.parse(spec))
    return out


def same(a, b):
    return all(
        np.array_equal(getattr(x, name), getattr(y, name))
        for x, y in zip(a, b, strict=True)
        for name in ("x", "eta", "u", "p", "d")
    )


def test_any_executor_gives_the_same_bits(tmp_path):
    here = run_ensemble(scenes(), tmp_path / "here", workers=1)
    seen = []
    with ThreadPoolExecutor(1) as pool:
        other = run_ensemble(
            scenes(), tmp_path / "thread", executor=pool, progress=lambda *p: seen.append(p)
        )
        # it stays open, and complete runs are not run again
        assert pool.submit(int, "3").result() == 3
    assert same(here, other)
    assert seen[0] == (0, 2)
    assert seen[-1] == (2, 2)


def test_a_failure_cancels_what_has_not_begun(tmp_path, monkeypatch):
    class Failed(CellsysError):
        pass

    class Pool(ThreadPoolExecutor):
        futures: tuple = ()

        def submit(self, function, *arguments):
            future = Future()
            if not self.futures:
                future.set_exception(Failed("a run failed"))
            self.futures = (*self.futures, future)
            return future

    pool = Pool(1)
    with pytest.raises(Failed, match="a run failed"):
        run_ensemble(scenes(3), tmp_path, executor=pool)
    assert sum(f.cancelled() for f in pool.futures) == 2
    pool.shutdown()


def test_something_else_is_refused_before_anything_runs(tmp_path, monkeypatch):
    monkeypatch.setattr(room, "run_scene", None)
    with pytest.raises(ParameterError, match="got int"):
        run_ensemble(scenes(), tmp_path, executor=4)


@pytest.mark.slow
def test_a_pool_of_processes_gives_the_same_bits(tmp_path):
    here = run_ensemble(scenes(), tmp_path / "here", workers=1)
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        assert same(here, run_ensemble(scenes(), tmp_path / "process", executor=pool))


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # dask's own, about ports and clusters closing
def test_a_dask_cluster_gives_the_same_bits(tmp_path):
    distributed = pytest.importorskip("distributed")
    here = run_ensemble(scenes(), tmp_path / "here", workers=1)
    for workers in (1, 2):
        with (
            distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, dashboard_address=None
            ) as cluster,
            distributed.Client(cluster) as client,
        ):
            seen = []
            there = run_ensemble(
                scenes(),
                tmp_path / f"dask{workers}",
                executor=client,
                progress=lambda *p, seen=seen: seen.append(p),
            )
        assert same(here, there)
        assert seen[-1] == (2, 2)
