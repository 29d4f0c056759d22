"""The same ensemble on executors of all kinds: bitwise the same runs, on one machine."""

import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import tomllib
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import cellsys
from cellsys.errors import CellsysError, ExecutorError, ParameterError
from cellsys.scene import Scene, run_ensemble, run_scene
from cellsys.scene import ensemble as room
from tests.mechanics.scenes import table
from tests.study.scenes import tiny


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


@pytest.mark.parametrize("closed", [True, False])
def test_an_executor_that_takes_or_does_no_work_is_one_error(closed, tmp_path):
    class Cancelling(ThreadPoolExecutor):
        def submit(self, function, *arguments):
            future = Future()
            future.cancel()
            future.set_running_or_notify_cancel()
            return future

    pool = ThreadPoolExecutor(1) if closed else Cancelling(1)
    if closed:
        pool.shutdown()
    with pytest.raises(ExecutorError, match="takes no work" if closed else "CancelledError") as got:
        run_ensemble(scenes(), tmp_path, executor=pool)
    # one error: naive, the bare one of the library, which says nothing
    assert got.value.__cause__ is None
    assert got.value.__suppress_context__
    pool.shutdown()


# Dask in processes of its own, as a user starts it.

LONG = tiny(replace={'"40 s"': '"4000 s"', "runs = 3": "runs = 2"})


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def cluster(tmp_path):
    """Address, scheduler and two workers; their leases end after 3 s."""
    pytest.importorskip("distributed")
    address = f"tcp://127.0.0.1:{free_port()}"
    paths = [str(Path(cellsys.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    settings = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(p for p in paths if p),
        "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "4s",
    }
    (tmp_path / "leases.py").write_text(
        "import cellsys.store.hold as hold\nhold.LONGEST, hold.BEAT = 3.0, 0.3\n"
    )
    made = []

    def begin(kind, *arguments):
        made.append(
            subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.dask_{kind}", *arguments],
                env=settings, cwd=tmp_path, start_new_session=True,
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )
        )  # fmt: skip
        return made[-1]

    scheduler = begin("scheduler", "--port", address.rpartition(":")[2], "--no-dashboard")
    workers = [
        begin(
            "worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny",
            "--preload", str(tmp_path / "leases.py"),
        )
        for _ in range(2)
    ]  # fmt: skip
    yield address, scheduler, workers
    for process in made:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def when_written(folder, count, action):
    """Do something in another thread when `count` runs have a checkpoint."""

    def wait():
        until = time.monotonic() + 60
        while len(list(folder.glob("*.partial/checkpoint.npz"))) < count:
            if time.monotonic() > until:
                return
            time.sleep(0.05)
        action()

    threading.Thread(target=wait, daemon=True).start()


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_scheduler_that_is_gone_is_one_error(cluster, tmp_path):
    distributed = pytest.importorskip("distributed")
    address, scheduler, _ = cluster
    long = [Scene.parse({**tomllib.loads(LONG), "seed": k}) for k in (1, 2)]
    client = distributed.Client(address, timeout=30)
    when_written(tmp_path / "runs", 1, scheduler.kill)
    with pytest.raises(ExecutorError, match="gone or do not answer"):
        run_ensemble(long, tmp_path / "runs", executor=client)
    client.close(timeout=1)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_the_run_of_a_worker_that_is_cut_off_is_given_to_another(cluster, tmp_path):
    """Stopped: it keeps its lock and does nothing. Naive, by locks alone: "being written"."""
    distributed = pytest.importorskip("distributed")
    address, _, workers = cluster
    text = LONG.replace('"4000 s"', '"400 s"', 1)
    wanted = [Scene.parse({**tomllib.loads(text), "seed": k}) for k in (1, 2)]
    with distributed.Client(address, timeout=30) as client:
        client.wait_for_workers(2, timeout=30)
        when_written(tmp_path / "runs", 2, lambda: os.kill(workers[0].pid, signal.SIGSTOP))
        there = run_ensemble(wanted, tmp_path / "runs", executor=client)
    assert same(there, [run_scene(s) for s in wanted])
    assert len(list((tmp_path / "runs").iterdir())) == 2
