"""What fixed-step integrators share: cutting an interval into steps, averages, failures."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from itertools import pairwise
from math import isfinite
from typing import NoReturn

import numpy as np

from cellsys.arguments import checked, unchecked
from cellsys.errors import IntegrationError, ParameterError
from cellsys.system import Event, OdeSystem
from cellsys.units import real_number

MOST_STEPS = 1e8


def check_step(name: str, step: float) -> None:
    """A step is a finite number of seconds above zero."""
    if not real_number(step, f"{name}.step") > 0:
        raise ParameterError(f"{name}.step must be a finite time > 0 s, got {step!r}")


def steps_of(span: float, step: float) -> int:
    """Number of equal steps of at most `step` in `span`; refused beyond `MOST_STEPS`."""
    if span > MOST_STEPS * step:
        raise ParameterError(
            f"{span:g} s in steps of {step:g} s are more than {MOST_STEPS:g} steps between two "
            "samples or stop points; take longer steps or another method"
        )
    return max(1, int(np.ceil(span / step * (1.0 - 1e-12))))


def cuts(t0: float, t1: float, step: float, stops: np.ndarray) -> np.ndarray:
    """Times from t0 to t1 in equal steps of at most `step`, hitting every stop point between."""
    inner = stops[(stops > t0) & (stops < t1)]
    edges = np.concatenate([[t0], inner, [t1]])
    times = [np.array([t0])]
    for a, b in pairwise(edges):
        n = steps_of(b - a, step)
        times.append(a + (b - a) * np.arange(1, n + 1) / n)
        times[-1][-1] = b
    return np.concatenate(times)


@checked
class SampledRun(ABC):
    """State of a run between two samples.

    `advance(t1)` moves from `self.t` to t1 and returns the averages of eta and u over the
    interval (zeros from a fixed-step method when `averages` is false). `memory` and `restore`
    carry what a later interval needs, so that a run resumed at a sample continues bit for bit (on
    the kind of processor and BLAS that began it).
    """

    def __init__(
        self, system: OdeSystem, t0: float, x0: np.ndarray, rng: np.random.Generator, step: float
    ) -> None:
        self.system, self.t, self.x, self.rng, self.step = system, float(t0), x0.copy(), rng, step
        self.stops = np.unique(np.asarray(system.stop_points(), dtype=float))
        self.averages = True
        self.events: list[Event] = []
        names = ("steps", "rejected", "rhs", "jacobians", "factorisations", "solves")
        self.statistics = dict.fromkeys(names, 0)

    @unchecked
    def memory(self) -> dict[str, np.ndarray]:
        """Arrays that the next interval depends on, apart from t and x."""
        return {}

    @unchecked
    def restore(self, memory: dict[str, np.ndarray]) -> None:
        """Take back what `memory` gave."""
        return None

    @abstractmethod
    @unchecked
    def advance(self, t1: float) -> tuple[np.ndarray, np.ndarray]:
        """Move to t1; returns the averages of eta (n_eta,) and u (n,) over the interval."""

    def fail(self, t: float, dt: float, reason: str | None = None) -> NoReturn:
        """Raise the typed error, naming the first state that is not finite."""
        bad = np.flatnonzero(~np.isfinite(self.x))
        if reason is None:
            name = self.system.states.names[bad[0]] if bad.size else "the state's norm"
            reason = f"{type(self).__name__}: {name} is not finite; use a smaller step"
        norm = float(np.linalg.norm(self.x[np.isfinite(self.x)]))
        raise IntegrationError(reason, time=t, state_norm=norm, step=dt)


@checked
class Stepper(SampledRun):
    """State of a fixed-step run between two samples; a method gives `take_step`."""

    @abstractmethod
    @unchecked
    def take_step(self, t: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """One step from (t, self.x); returns eta and u of the step."""

    @unchecked
    def advance(self, t1: float) -> tuple[np.ndarray, np.ndarray]:
        """Move to t1; returns the averages of eta (n_eta,) and u (n,) over the interval."""
        t0 = self.t
        times = cuts(t0, t1, self.step, self.stops)
        sums = np.zeros(self.system.auxiliaries.size), np.zeros(self.system.states.size)
        # Overflow in a law is reported by `fail`, with the time and the state's name.
        with np.errstate(over="ignore", invalid="ignore"):
            for a, b in pairwise(times.tolist()):
                averages = self.take_step(a, b - a)
                self.statistics["steps"] += 1
                if not isfinite(np.add.reduce(self.x)):
                    self.fail(b, b - a)
                if self.averages:
                    for total, value in zip(sums, averages, strict=True):
                        total += (b - a) * value
        self.t = float(t1)
        return sums[0] / (t1 - t0), sums[1] / (t1 - t0)


StepperFactory = Callable[[OdeSystem, float, np.ndarray, np.random.Generator], SampledRun]
