"""Random instances of the hard cases: draw, try, and simplify what fails.

A `Case` is a property with a space of parameters. An instance holds (the check returns), is
refused (it raises a `CellsysError`, whose message is for a user), or fails (anything else: a wrong
number, a foreign exception, a warning, too much time).
"""

from __future__ import annotations

import signal
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cellsys.errors import CellsysError

HELD, REFUSED, FAILED = "held", "refused", "failed"


@dataclass(frozen=True)
class Int:
    """A whole number in [low, high]; simplest: low."""

    low: int
    high: int

    def draw(self, rng):
        return int(rng.integers(self.low, self.high + 1))

    def simpler(self, value):
        for guess in (self.low, (self.low + value) // 2, value - 1):
            if self.low <= guess < value:
                yield guess


@dataclass(frozen=True)
class Power:
    """10^e with e uniform in [low, high]; simplest: fewer digits, then nearer to 1."""

    low: float
    high: float

    def draw(self, rng):
        return float(10.0 ** rng.uniform(self.low, self.high))

    def simpler(self, value):
        for digits in (0, 1):
            guess = float(f"{value:.{digits}e}")
            if guess != value and self._inside(guess):
                yield guess
        if not 0.5 < value < 2.0:
            guess = float(f"{value**0.5:.0e}")
            if self._inside(guess):
                yield guess

    def _inside(self, value):
        return 10.0**self.low <= value <= 10.0**self.high


@dataclass(frozen=True)
class Real:
    """A number in [low, high]; simplest: low, then fewer digits."""

    low: float
    high: float

    def draw(self, rng):
        return float(rng.uniform(self.low, self.high))

    def simpler(self, value):
        for guess in (self.low, float(f"{value:.0e}"), float(f"{value:.1e}")):
            if guess != value and self.low <= guess <= self.high:
                yield guess


class Choice:
    """One of some options; simplest: the first."""

    def __init__(self, *options):
        self.options = options

    def draw(self, rng):
        return self.options[int(rng.integers(len(self.options)))]

    def simpler(self, value):
        yield from self.options[: self.options.index(value)]


SEED = Int(0, 10**6)


@dataclass(frozen=True)
class Case:
    """A property, the space its parameters are drawn from, and the time an instance may take.

    `oracle`: the property is agreement with code that shares nothing with the toolbox; the
    summary names it.
    """

    name: str
    check: Callable[..., None]
    space: Mapping[str, Any] = field(default_factory=dict)
    seconds: float = 30.0
    oracle: bool = False


class TooLong(Exception):
    """An instance took more than its time: a hang, as far as a user can tell."""


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raise `TooLong` in the block after so many seconds of its own, or four times as many of the
    clock's, which other processes may take (main thread only)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def late(*_):
        raise TooLong(f"took more than {seconds:g} s")

    timers = (
        (signal.SIGPROF, signal.ITIMER_PROF, seconds),
        (signal.SIGALRM, signal.ITIMER_REAL, 4 * seconds),
    )
    before = [signal.signal(number, late) for number, _, _ in timers]
    for _, timer, limit in timers:
        signal.setitimer(timer, limit)
    try:
        yield
    finally:
        for (number, timer, _), handler in zip(timers, before, strict=True):
            signal.setitimer(timer, 0)
            signal.signal(number, handler)


def outcome(case: Case, values: Mapping[str, Any]) -> tuple[str, str]:
    """(held, refused or failed; what was said)."""
    try:
        with warnings.catch_warnings(), at_most(case.seconds):
            warnings.simplefilter("error")
            case.check(**values)
    except CellsysError as error:
        return REFUSED, f"{type(error).__name__}: {error}"
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        lines = traceback.format_exception(error)
        return FAILED, "".join(lines[-3:]).strip()
    return HELD, ""


def draw(case: Case, seed: tuple[int, ...]) -> dict[str, Any]:
    """Values of the parameters for a seed."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    return {name: space.draw(rng) for name, space in case.space.items()}


def shrink(case: Case, values: Mapping[str, Any], seconds: float = 30.0) -> dict[str, Any]:
    """The simplest values found that still fail."""
    best, end = dict(values), time.monotonic() + seconds
    found = True
    while found:
        found = False
        for name, space in case.space.items():
            for guess in space.simpler(best[name]):
                if time.monotonic() > end:
                    return best
                tried = best | {name: guess}
                if outcome(case, tried)[0] == FAILED:
                    best, found = tried, True
                    break
    return best


@dataclass
class Count:
    """What became of the instances of one case."""

    tried: int = 0
    held: int = 0
    refused: int = 0
    failed: int = 0
    seconds: float = 0.0

    def __add__(self, other: Count) -> Count:
        return Count(*(getattr(self, n) + getattr(other, n) for n in self.__dataclass_fields__))


def run(
    cases: Mapping[str, tuple[Case, ...]],
    seconds: float,
    seed: int = 0,
    say: Callable[[str], None] = print,
    share: tuple[int, int] = (0, 1),
) -> dict[str, Count]:
    """Try random instances of all cases for so long; counts by family and by case.

    The case that has had the least time so far is next, so that slow ones do not starve the rest.
    `share`: (which, of how many) processes that draw different instances.
    """
    every = [(family, case) for family, group in cases.items() for case in group]
    counts = {case.name: Count() for _, case in every}
    end, told = time.monotonic() + seconds, set()
    while time.monotonic() < end:
        family, case = min(every, key=lambda item: counts[item[1].name].seconds)
        count = counts[case.name]
        key = (seed, sum(map(ord, case.name)), share[0] + share[1] * count.tried)
        values = draw(case, key)
        began = time.monotonic()
        result, text = outcome(case, values)
        count.tried += 1
        setattr(count, result, getattr(count, result) + 1)
        if result == FAILED and (kind := (case.name, text.split("\n")[-1][:40])) not in told:
            told.add(kind)  # one instance of every kind of failure is enough to read
            small = shrink(case, values)
            say(f"FAILED {family} / {case.name}, seed {key}")
            say(f"  smallest found: {case.name}({_shown(small)})")
            say("  " + outcome(case, small)[1].replace("\n", "\n  "))
        count.seconds += time.monotonic() - began
    return {
        family: sum((counts[c.name] for c in group), Count()) for family, group in cases.items()
    } | {f"  {case.name}": counts[case.name] for _, case in every}


def _shown(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{k}={v!r}" for k, v in values.items())


def hold(case: Case, times: int) -> None:
    """Assert that the first instances of a case hold or are refused, as the test suite does."""
    for k in range(times):
        values = draw(case, (0, sum(map(ord, case.name)), k))
        result, text = outcome(case, values)
        if result == FAILED:
            raise AssertionError(f"{case.name}({_shown(shrink(case, values))})\n{text}")
