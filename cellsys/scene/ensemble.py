"""Runs of scenes: cached on disk, resumable, several at a time."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from cellsys.errors import BudgetError, FileFormatError, ParameterError
from cellsys.integrate.linearly_implicit import LinearlyImplicit
from cellsys.integrate.simulate import first_samples, record_shapes, simulate, trajectory_of
from cellsys.mechanics.contact import touching, until_contact
from cellsys.scene.build import build
from cellsys.scene.chain import METHOD, ChainScene
from cellsys.scene.parse import scene_from_plain
from cellsys.scene.scene import Scene
from cellsys.store.runs import RunReader, RunWriter
from cellsys.system import Event, OdeSystem
from cellsys.trajectory import Trajectory


def run_scene(
    scene: Scene, folder: str | Path | None = None, progress: Callable[[float], None] | None = None
) -> Trajectory:
    """Simulate a scene; with a folder, cached there and resumable.

    A disc is marched at the scene's own step; on a chain LSODA finds the switches (rtol 1e-10,
    atol 1e-12; a run takes seconds and is started again when it was interrupted). A scene with
    ``until = "contact"`` ends with the sample after which two cells touch; the event of the
    contact has its time.

    Parameters
    ----------
    scene : Scene
        What to run.
    folder : path, optional
        Parent of the cached runs; the run's own folder is named by the scene's fingerprint. A
        complete run is read back, a partial one is continued, bit for bit.
    """
    system = build(scene)
    chain = isinstance(scene.matrix, ChainScene)
    method = METHOD if chain else LinearlyImplicit(step=scene.step)
    until = touching(system) if scene.until == "contact" else None
    if folder is None:
        run = simulate(
            system,
            method,
            scene.times,
            seed=scene.seed,
            progress=progress,
            label=scene.name,
            until=until,
        )
        return run if until is None else until_contact(run)
    target = Path(folder) / scene.fingerprint()[:20]
    if not (target / "run.json").exists():
        writer = RunWriter(
            target,
            record_shapes(system, scene.times, True),
            {"scene": scene.canonical(), "fingerprint": scene.fingerprint()},
        )
        run = simulate(
            system,
            method,
            scene.times,
            seed=scene.seed,
            sink=writer,
            progress=progress,
            until=until,
        )
        writer.finish(
            {"statistics": _numbers(run.statistics), "events": [list(e) for e in run.events]}
        )
    return _trajectory(RunReader(target), system, scene)


def _numbers(statistics: Mapping[str, Any]) -> dict[str, Any]:
    """Without what JSON has no number for: the shortest interval of a run with one switch."""
    return {k: v for k, v in statistics.items() if not isinstance(v, float) or np.isfinite(v)}


def _trajectory(reader: RunReader, system: OdeSystem, scene: Scene) -> Trajectory:
    t, label = scene.times, scene.name
    if not isinstance(label, str):
        raise FileFormatError(f"{str(reader.folder)!r} names its scene {label!r}, not by a text")
    found = {k: (v.shape, v.dtype) for k, v in reader.arrays.items()}
    wanted = {k: (s, np.dtype(float)) for k, s in record_shapes(system, t, True).items()}
    if found != wanted:
        wrong = sorted(k for k in found.keys() | wanted if found.get(k) != wanted.get(k))
        raise FileFormatError(
            f"{str(reader.folder)!r} holds other arrays than its scene writes: {', '.join(wrong)}; "
            "run the scene again"
        )
    try:
        events = tuple(Event(float(e[0]), e[1] + "", e[2] + "") for e in reader.metadata["events"])
        statistics = dict(reader.metadata["statistics"])
        if "step" in statistics:
            float(statistics["step"])
        count = int(statistics["samples"]) if scene.until is not None else len(t)
    except (LookupError, TypeError, ValueError, OverflowError) as error:
        raise FileFormatError(
            f"{str(reader.folder)!r} holds damaged events or statistics: {error}"
        ) from error
    if not 2 <= count <= len(t):
        raise FileFormatError(
            f"{str(reader.folder)!r} says it ended after {count} of {len(t)} samples; run the "
            "scene again"
        )
    t, arrays = first_samples(count, t, reader.arrays)
    run = trajectory_of(system, t, arrays, events, statistics, label)
    return run if scene.until is None else until_contact(run)


def read_run(folder: str | Path) -> Trajectory:
    """A run folder of the cache, read back without its scene file.

    Raises
    ------
    FileFormatError
        When the folder does not hold a complete run.
    """
    reader = RunReader(folder)
    try:
        scene = scene_from_plain(reader.header["scene"])
        return _trajectory(reader, build(scene), scene)
    except (FileFormatError, BudgetError):
        raise
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise FileFormatError(f"{str(folder)!r} does not hold a run of a scene: {error}") from error


THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Processes started within use one thread each for linear algebra; a user's setting stays.

    The libraries read the environment when they are loaded, which in a new process is before any
    code of ours. Threads of several workers on the same cores only wait for each other.
    """
    absent = [name for name in THREADS if name not in os.environ]
    os.environ.update(dict.fromkeys(absent, "1"))
    try:
        yield
    finally:
        for name in absent:
            os.environ.pop(name, None)


def _die_on_interrupt() -> None:
    """Ctrl-C ends a worker at once; what it wrote can be resumed."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _run_into(scene: Scene, folder: str) -> None:
    run_scene(scene, folder)


def run_ensemble(
    scenes: Sequence[Scene],
    folder: str | Path,
    *,
    workers: int = 2,
    executor: Any = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Trajectory]:
    """Run many scenes in several processes; the same numbers whatever their number.

    Parameters
    ----------
    scenes : sequence of Scene
        Each is run once, even when it is listed twice.
    folder : path
        Run cache; trajectories come back memory-mapped from it. On a cluster every worker must
        see it under this name.
    workers : int
        Processes on this machine; not used with an `executor`.
    executor : concurrent.futures.Executor or dask.distributed.Client, optional
        Where to run instead. It stays open.
    progress : callable, optional
        Called with (runs done, runs in all).

    Raises
    ------
    ParameterError
        Something that takes no work was given as executor.
    """
    submit = None if executor is None else _submit_of(executor)
    pending = {s.fingerprint(): s for s in scenes}
    missing = [
        s for key, s in pending.items() if not (Path(folder) / key[:20] / "run.json").exists()
    ]
    done = len(pending) - len(missing)

    def told(more: int) -> None:
        nonlocal done
        done += more
        if progress is not None:
            progress(done, len(pending))

    told(0)
    if submit is not None:
        _gather({submit(_run_into, s, str(folder)) for s in missing}, told)
    elif workers <= 1 or len(missing) <= 1:
        for scene in missing:
            run_scene(scene, folder)
            told(1)
    else:
        pool = ProcessPoolExecutor(
            min(workers, len(missing)), get_context("spawn"), initializer=_die_on_interrupt
        )
        try:
            with one_thread_each():  # a process starts when work is submitted
                waiting = {pool.submit(_run_into, s, str(folder)) for s in missing}
            _gather(waiting, told)
        finally:
            # After a failure or an interrupt the runs not yet begun are not begun.
            pool.shutdown(cancel_futures=True)
    return [run_scene(s, folder) for s in scenes]


def _submit_of(executor: Any) -> Callable[..., Future]:
    """`submit` of an executor; a dask client brings one that gives ordinary futures."""
    if hasattr(executor, "get_executor"):
        executor = executor.get_executor()
    if not isinstance(executor, Executor):
        raise ParameterError(
            "executor must be a concurrent.futures.Executor or a dask.distributed.Client, got "
            f"{type(executor).__name__}"
        )
    return executor.submit


def _gather(waiting: set[Future], told: Callable[[int], None]) -> None:
    """Wait for all; the first failure is raised and what has not begun is cancelled."""
    try:
        while waiting:
            finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in finished:
                future.result()
            told(len(finished))
    except BrokenProcessPool:
        # Ctrl-C reaches the workers first: our own interrupt surfaces while we wait.
        time.sleep(1.0)
        raise BudgetError(
            "a worker process ended before its run was done, killed or out of memory; use fewer "
            "workers, and resume to go on from the last checkpoint"
        ) from None
    finally:
        for future in waiting:
            future.cancel()
