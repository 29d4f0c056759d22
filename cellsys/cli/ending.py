"""How a command ends when it is told to: SIGINT, SIGTERM and SIGHUP alike, whatever it is doing."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import TextIO

from cellsys.cli.output import say

# Ctrl-C keeps the code of a job that did not come to its end; the others have the shell's.
CODES = {signal.SIGINT: 1, signal.SIGTERM: 128 + signal.SIGTERM}
if hasattr(signal, "SIGHUP"):
    CODES[signal.SIGHUP] = 128 + signal.SIGHUP
_Handler = Callable[[int, FrameType | None], object] | int | signal.Handlers | None
GRACE = 8.0  # s from the signal to the end, whatever is still running


class Told(KeyboardInterrupt):
    """A signal told the program to end; what is caught as Ctrl-C is caught with it."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = signal.Signals(number)


class Signals:
    """While this context lasts, the signals of `CODES` raise `Told`, once.

    Further ones are not heeded: the end is under way. It comes within `GRACE` seconds even where
    the exception cannot be raised (a long call into a library) or is swallowed (a callback of
    one): locks and workers end with the process, and the files of a run are always such that it
    can be gone on with. A signal that the process was started to ignore (nohup) stays ignored.
    """

    def __init__(self) -> None:
        self.received: int | None = None
        self._before: dict[int, _Handler] = {}
        self._pipe: tuple[int, int] | None = None
        self._wakeup = -1

    @property
    def code(self) -> int | None:
        """Exit code that the signal asks for; None while there was none."""
        return None if self.received is None else CODES[signal.Signals(self.received)]

    def __enter__(self) -> Signals:
        if threading.current_thread() is not threading.main_thread():
            return self  # only the main thread may; a signal ends the process as it always does
        if os.name == "posix":  # elsewhere only a socket can tell of a signal
            reader, writer = os.pipe()
            os.set_blocking(writer, False)
            self._pipe = reader, writer
            self._wakeup = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
            threading.Thread(target=_see_to_it, args=(reader,), daemon=True).start()
        for number in CODES:
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                self._before[number] = signal.signal(number, self._tell)
        return self

    def _tell(self, number: int, frame: FrameType | None) -> None:
        if self.received is None:
            self.received = number
            raise Told(number)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        if self.received is not None:
            return  # told to end: no further signal is to disturb that
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if self._pipe is not None:
            signal.set_wakeup_fd(self._wakeup)
            os.close(self._pipe[1])  # its reader then ends too


def _see_to_it(reader: int) -> None:
    """End the process some time after a signal, should it still be there."""
    codes = {int(number): code for number, code in CODES.items()}
    while numbers := os.read(reader, 64):
        told = [codes[n] for n in numbers if n in codes]
        if told:
            time.sleep(GRACE)
            os._exit(told[0])
    os.close(reader)


def say_ending(stop: KeyboardInterrupt, hint: str) -> int:
    """Say that the command was ended, and how to go on; the exit code."""
    if isinstance(stop, Told) and stop.number != signal.SIGINT:
        say(f"ended by {stop.number.name}; {hint}")
        return CODES[stop.number]
    say(f"interrupted; {hint}")
    return CODES[signal.SIGINT]


def leave_streams() -> None:
    """Let go of output that nobody takes any more (a closed terminal), so that the code stands."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError, AttributeError):
            try:
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
            except (OSError, ValueError, AttributeError):
                continue


@contextmanager
def told_in_one_line() -> Iterator[None]:
    """Warnings of cellsys about the run cache are one line each, as errors are."""
    from cellsys.errors import DamagedRunWarning, ForeignRunWarning

    with warnings.catch_warnings():
        others = warnings.showwarning

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if issubclass(category, (DamagedRunWarning, ForeignRunWarning)):
                say(str(message))
            else:
                others(message, category, filename, lineno, file, line)

        warnings.showwarning = show
        for category in (DamagedRunWarning, ForeignRunWarning):
            warnings.simplefilter("always", category)
        yield
