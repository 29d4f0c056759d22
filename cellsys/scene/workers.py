"""Worker processes of an ensemble: they never outlive the process that started them.

A worker that went on would hold its run's lock and its memory, and nobody would read what it
finds. When the parent is interrupted it ends its workers; when it dies without a word the system
tells them (Linux: prctl(2), PR_SET_PDEATHSIG), or they see it themselves within a second.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import NamedTuple

from threadpoolctl import threadpool_limits

from cellsys.errors import CellsysError, ExecutorError, MemoryBudgetError

_WATCH = "cellsys parent watch"
_LOOK = 1.0  # s between two looks at the parent where nothing tells of its death
_LEAVE = 5.0  # s for a worker without work to end by itself
_PR_SET_PDEATHSIG = 1
_READY, _DONE = "ready", "done"


class _Worker(NamedTuple):
    process: BaseProcess
    line: Connection


class Workers:
    """Processes for runs, as a context: all are gone when it is left.

    New interpreters, not forks: those would take along the threads' locks of whatever the calling
    program runs. A run that fails lets the others that have begun come to their end, so that they
    are kept; an interrupt ends them at once.

    Parameters
    ----------
    count : int
        How many.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._workers: list[_Worker] = []

    def __enter__(self) -> Workers:
        context = multiprocessing.get_context("spawn")
        with ExitStack() as undo:
            undo.callback(self.kill)
            for _ in range(self._count):
                ours, theirs = context.Pipe()
                # A daemon: also ended where the program ends while a thread of it waits for us.
                process = context.Process(target=_serve, args=(theirs,), daemon=True)
                self._workers.append(_Worker(process, ours))
                process.start()
                theirs.close()
            undo.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        if kind is not None:
            self.kill()  # of a run that failed, `run` has waited for the others
        for worker in self._workers:
            worker.line.close()
        for worker in self._workers:
            worker.process.join(_LEAVE)
        self.kill()

    def kill(self) -> None:
        """End all processes now; what they wrote can be gone on with."""
        for worker in self._workers:
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()

    def run(self, function: Callable[..., object], tasks: Iterable[tuple]) -> Iterator[object]:
        """Call a function with every tuple of arguments; results as they come, in any order.

        Raises
        ------
        MemoryBudgetError
            When a worker ends before its work is done.
        Exception
            The first that the function raised, when what had begun has come to its end.
        """
        left = deque(tasks)
        failed: BaseException | None = None
        waiting = {worker.line: worker for worker in self._workers}
        while waiting:
            ready = set(wait(list(waiting)))
            for line in [known for known in waiting if known in ready]:
                try:
                    word, value = line.recv()
                except (EOFError, ConnectionError):
                    raise _ended(waiting[line].process) from None
                if word == _DONE:
                    yield value
                elif word != _READY:
                    failed = failed or value
                if left and failed is None:
                    line.send((function, left.popleft()))
                else:
                    del waiting[line]
        if failed is not None:
            raise failed


def _ended(process: BaseProcess) -> MemoryBudgetError:
    """Why a worker is gone, as far as it can be known."""
    process.join(_LEAVE)
    code = process.exitcode
    if code is not None and code < 0:
        why = f"it was ended by {signal.Signals(-code).name}: killed, or out of memory"
    else:
        why = (
            "it could not begin or left by itself; a script that starts workers needs "
            '`if __name__ == "__main__":` around what it runs'
        )
    return MemoryBudgetError(
        f"a worker process ended before its run was done: {why}. Use fewer workers, and resume to "
        "go on from the last checkpoint"
    )


class _Outcome:
    """What a block of code raised, as a value that can be sent."""

    error: Exception | None = None

    def __enter__(self) -> _Outcome:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> bool:
        if not isinstance(error, Exception):
            return False
        if not isinstance(error, CellsysError):
            error.add_note("in a worker process:\n" + "".join(traceback.format_exception(error)))
        self.error = error
        return True


def _serve(line: Connection) -> None:
    """The life of a worker: tasks from the line until it is closed."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        # Ctrl-C reaches the workers too, and ends them without a traceback.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    end_with_parent(at_once=True)
    threadpool_limits(1)  # also of what a task imports later: many processes share the processors
    line.send((_READY, None))
    while True:
        try:
            function, arguments = line.recv()
        except EOFError:
            return
        value = None
        with _Outcome() as outcome:
            value = function(*arguments)
        if outcome.error is None:
            line.send((_DONE, value))
            continue
        with _Outcome() as sending:
            line.send(("failed", outcome.error))
        if sending.error is not None:  # it cannot be pickled
            text = f"{type(outcome.error).__name__}: {outcome.error}"
            line.send(("failed", ExecutorError(f"in a worker process: {text}")))


def end_with_parent(*, at_once: bool = False) -> None:
    """From now on this process ends when the one that started it by `multiprocessing` is gone.

    Parameters
    ----------
    at_once : bool
        Let the system end it. On Linux that follows the *thread* that started this process, so
        that thread must live as long as the work.
    """
    parent = multiprocessing.parent_process()
    if parent is None or any(thread.name == _WATCH for thread in threading.enumerate()):
        return
    child_of_it = os.getppid() == parent.pid  # a fork server may stand between
    if at_once and child_of_it and sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent.pid:
            os._exit(1)  # gone just before it was said

    def watch() -> None:
        while not wait([parent.sentinel], _LOOK):
            # Where a sibling holds the other end of the sentinel too, nothing closes it.
            if child_of_it and os.getppid() != parent.pid:
                break
        os._exit(1)

    threading.Thread(target=watch, name=_WATCH, daemon=True).start()
