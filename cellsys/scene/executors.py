"""Executors of others, a pool or a cluster, as places where runs are made."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Protocol, runtime_checkable

from cellsys.errors import ExecutorError, MemoryBudgetError, ParameterError

_OF_DASK = (
    ("distributed", "CancelledError"),
    ("distributed", "KilledWorker"),
    ("distributed.client", "ClosedClientError"),
    ("distributed.client", "FutureCancelledError"),
    ("distributed.comm.core", "CommClosedError"),
)


@runtime_checkable
class GivesExecutor(Protocol):
    """A client of a cluster, such as dask.distributed.Client."""

    def get_executor(self) -> object:
        """A concurrent.futures.Executor of the cluster."""


def executor_of(given: object) -> Executor:
    """The executor, or that of a dask client, which gives ordinary futures.

    Raises
    ------
    ParameterError
        Something that takes no work.
    """
    if isinstance(given, GivesExecutor):
        given = given.get_executor()
    if not isinstance(given, Executor):
        raise ParameterError(
            "executor must be a concurrent.futures.Executor or a dask.distributed.Client, got "
            f"{type(given).__name__}"
        )
    return given


def gather(
    submit: Callable[..., Future], tasks: Iterable[tuple], folder: str | Path
) -> Iterator[object]:
    """Submit tasks and wait for all: results as they come; after a failure the rest is cancelled.

    Parameters
    ----------
    submit : callable
        Of an executor.
    tasks : iterable of tuple
        Function and arguments of each.
    folder : path
        Where finished runs are, for messages.

    Raises
    ------
    ExecutorError
        When the scheduler or the workers are gone, or take no work.
    MemoryBudgetError
        When a process of a pool was killed.
    """
    waiting: set[Future] = set()
    try:
        _submit(submit, tasks, waiting)
        while waiting:
            finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in finished:
                yield future.result()
    except BrokenProcessPool:
        # Ctrl-C reaches the workers first: our own interrupt surfaces while we wait.
        time.sleep(1.0)
        raise MemoryBudgetError(
            "a worker process ended before its run was done, killed or out of memory; use fewer "
            "workers, and resume to go on from the last checkpoint"
        ) from None
    except _gone() as error:
        raise ExecutorError(
            f"the executor ended before all runs were done ({_said(error)}): its scheduler or its "
            f"workers are gone or do not answer. Finished runs are kept in {str(folder)!r}; start "
            "it again, and run the same scenes to go on from there"
        ) from None
    finally:
        for future in waiting:
            future.cancel()


def _submit(submit: Callable[..., Future], tasks: Iterable[tuple], waiting: set[Future]) -> None:
    """Fill the set with the futures of the tasks."""
    try:
        for task in tasks:
            waiting.add(submit(*task))
    except BrokenProcessPool:
        raise
    except RuntimeError as error:
        raise ExecutorError(
            f"the executor takes no work ({_said(error)}): it was closed; open another"
        ) from None


def _gone() -> tuple[type[BaseException], ...]:
    """What a lost executor raises; dask's own where it is loaded."""
    found: tuple[type[BaseException], ...] = (CancelledError, TimeoutError, ConnectionError)
    for module, name in _OF_DASK:
        error = getattr(sys.modules.get(module), name, None)
        if isinstance(error, type) and issubclass(error, BaseException):
            found += (error,)
    return found


def _said(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:200]}" if text else type(error).__name__
