"""Runs of scenes: cached on disk, resumable, several at a time."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import (
    DamagedRunWarning,
    FileFormatError,
    ForeignRunWarning,
    MemoryBudgetError,
)
from cellsys.integrate.record import first_samples, record_shapes, trajectory_of
from cellsys.integrate.simulate import simulate
from cellsys.mechanics.contact import touching, until_contact
from cellsys.scene.build import build, spreading
from cellsys.scene.executors import executor_of, gather
from cellsys.scene.load import scene_from_plain
from cellsys.scene.memory import check_mapping, check_scene_memory, memory_need
from cellsys.scene.scene import Scene
from cellsys.scene.steppers import BySystem
from cellsys.scene.workers import Workers, end_with_parent
from cellsys.store.processor import processor_kind
from cellsys.store.runs import RunReader, RunWriter
from cellsys.system import Event, OdeSystem
from cellsys.threads import one_thread
from cellsys.trajectory import Trajectory
from cellsys.trajectory_file import layout_table, provenance


@checked
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
        complete run is read back, one that is damaged is made again (`DamagedRunWarning`). A
        partial one is continued, bit for bit on one kind of processor and BLAS, with which the
        fingerprint changes.

    Raises
    ------
    MemoryBudgetError
        When memory or disk do not hold the run.
    ParameterError
        When another process is writing this run.
    LostRunError
        When the folder is removed while it is written.
    """
    if folder is None:
        check_scene_memory(scene)
        system = build(scene)
        run = replace(_simulated(scene, system, None, progress), source=origin(scene))
        return run if scene.until is None else until_contact(run)
    target = Path(folder) / run_name(scene)
    if not _kept([target]):
        _make(scene, target, progress=progress)
    return _read(scene, target, progress)


def run_name(scene: Scene) -> str:
    """Name of the folder of a scene's run in a cache."""
    return scene.fingerprint()[:20]


def _simulated(
    scene: Scene,
    system: OdeSystem,
    sink: RunWriter | None,
    progress: Callable[[float], None] | None = None,
) -> Trajectory:
    def told(share: float) -> None:
        if sink is not None:
            sink.check()  # at every sample: rows of a folder that was removed are nobody's
        if progress is not None:
            progress(share)

    method = scene.matrix_kind.method(scene)
    if isinstance(method, BySystem):
        method = method.of(system)
    with one_thread():
        return simulate(
            system,
            method,
            scene.times,
            seed=scene.seed,
            sink=sink,
            progress=told,
            label=scene.name,
            until=touching(spreading(system)) if scene.until == "contact" else None,
        )


def _make(
    scene: Scene,
    target: Path,
    *,
    patience: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write the run of a scene into a folder of the cache."""
    check_mapping([scene])
    check_scene_memory(scene)
    system = build(scene)
    made = _finished(target)
    writer = RunWriter(
        target,
        record_shapes(system, scene.times, True),
        {
            "scene": scene.canonical(),
            "fingerprint": scene.fingerprint(),
            "processor": processor_kind(),
        },
        patience=patience,
    )
    if _finished(target) != made:
        writer.discard()  # by somebody else, while this one waited
        return
    run = _simulated(scene, system, writer, progress)
    writer.finish(
        {
            "statistics": _numbers(run.statistics),
            "events": [list(e) for e in run.events],
            "states": layout_table(run.states),
            "auxiliaries": layout_table(run.auxiliaries),
            "source": provenance({"toml": scene.text} if scene.text else {}),
        }
    )


def origin(scene: Scene) -> dict[str, object]:
    """What a run keeps of its scene: all it depends on, and its file as it was given."""
    given: dict[str, object] = {"toml": scene.text} if scene.text else {}
    return {"scene": scene.canonical(), **given}


def _finished(target: Path) -> int | None:
    """When the run in a folder was finished, ns; None where there is none."""
    try:
        return (target / "run.json").stat().st_mtime_ns
    except OSError:
        return None


def _kept(targets: Iterable[Path]) -> set[Path]:
    """The folders that hold a complete run as it was written; of damaged ones a warning."""
    whole = set()
    for target in targets:
        if not target.exists() and not target.is_symlink():
            continue
        try:
            RunReader(target).verify()
        except FileFormatError as error:
            _warn_damaged(error, target)
            continue
        whole.add(target)
    return whole


def _warn_damaged(error: FileFormatError, target: Path) -> None:
    warnings.warn(
        f"{error}; the run is made again in {str(target.parent)!r}",
        DamagedRunWarning,
        stacklevel=4,
    )


def _read(
    scene: Scene, target: Path, progress: Callable[[float], None] | None = None
) -> Trajectory:
    """The run in a folder whose checksums hold; made again where it is not the scene's."""
    system = build(scene)
    try:
        return _trajectory(RunReader(target), system, scene)
    except FileFormatError as error:
        _warn_damaged(error, target)
    _make(scene, target, progress=progress)
    return _trajectory(RunReader(target), system, scene)


def _numbers(statistics: Mapping[str, object]) -> dict[str, object]:
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
    told = reader.metadata.get("source")  # runs of older versions have none
    made = {k: v for k, v in told.items() if k != "scene"} if isinstance(told, dict) else {}
    run = replace(run, source={**origin(scene), **made})
    return run if scene.until is None else until_contact(run)


def read_run(folder: str | Path) -> Trajectory:
    """A run folder of the cache, read back without its scene file.

    Raises
    ------
    FileFormatError
        When the folder does not hold a complete run.
    """
    reader = RunReader(folder)
    reader.verify()
    try:
        scene = scene_from_plain(reader.header["scene"])
        return _trajectory(reader, build(scene), scene)
    except (FileFormatError, MemoryBudgetError):
        raise
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise FileFormatError(f"{str(folder)!r} does not hold a run of a scene: {error}") from error


def _run_into(scene: Scene, target: str) -> None:
    """Make a run as a task of an executor: whoever has begun it already is waited for.

    A scheduler gives a run away a second time when it has lost sight of the first worker.
    """
    if not _kept([Path(target)]):
        _make(scene, Path(target), patience=float("inf"))


def _run_in_child(scene: Scene, target: str) -> None:
    """`_run_into` in a process of a pool, which is not to go on without its parent."""
    end_with_parent()
    _run_into(scene, target)


@checked
def run_ensemble(
    scenes: Sequence[Scene],
    folder: str | Path,
    *,
    workers: int = 2,
    executor: object = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Trajectory]:
    """Run many scenes in several processes; the same numbers whatever their number.

    The same bits, on one kind of processor and BLAS (`processor_kind`); runs that a cluster made
    on another kind are told by a `ForeignRunWarning`.

    Parameters
    ----------
    scenes : sequence of Scene
        Each is run once, even when it is listed twice.
    folder : path
        Run cache; trajectories come back memory-mapped from it. On a cluster every worker must
        see it under this name.
    workers : int
        Processes on this machine, of one thread each; not used with an `executor`. They end when
        this process ends, whatever way.
    executor : concurrent.futures.Executor or dask.distributed.Client, optional
        Where to run instead. It stays open.
    progress : callable, optional
        Called with (runs done, runs in all).

    Raises
    ------
    ParameterError
        Something that takes no work was given as executor.
    MemoryBudgetError
        When the runs do not fit into memory side by side, or a worker was killed.
    ExecutorError
        When the executor's scheduler or workers are gone.
    """
    pool = None if executor is None else executor_of(executor)
    targets = {s.fingerprint(): Path(folder) / run_name(s) for s in scenes}
    pending = {s.fingerprint(): s for s in scenes}
    whole = _kept(targets.values())
    missing = [(s, targets[key]) for key, s in pending.items() if targets[key] not in whole]
    done = len(pending) - len(missing)

    def one_more() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, len(pending))

    if progress is not None:
        progress(done, len(pending))
    check_mapping(pending.values())
    if pool is not None:
        task = _run_in_child if isinstance(pool, ProcessPoolExecutor) else _run_into
        for _ in gather(pool.submit, [(task, s, str(target)) for s, target in missing], folder):
            one_more()
    elif workers <= 1 or len(missing) <= 1:
        for scene, target in missing:
            _make(scene, target)
            one_more()
    else:
        count = min(workers, len(missing))
        largest = max((s for s, _ in missing), key=lambda s: memory_need(s).resident)
        check_scene_memory(largest, count)
        with Workers(count) as crew:
            for _ in crew.run(_run_into, [(s, str(target)) for s, target in missing]):
                one_more()
    runs = {key: _read(s, targets[key]) for key, s in pending.items()}
    _tell_foreign(targets.values())
    return [runs[s.fingerprint()] for s in scenes]


def _tell_foreign(targets: Iterable[Path]) -> None:
    """Warn of runs that another kind of processor made."""
    here = processor_kind()
    kinds = [RunReader(target).header.get("processor", here) for target in targets]
    foreign = sorted({str(kind) for kind in kinds if kind != here})
    if foreign:
        warnings.warn(
            f"{sum(kind != here for kind in kinds)} of {len(kinds)} runs were made on another kind "
            f"of processor ({'; '.join(foreign)}; here {here}): they may differ in the last digits "
            "from what is computed here",
            ForeignRunWarning,
            stacklevel=3,
        )
