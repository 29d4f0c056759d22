"""Where the time of a run goes: every element's own calls are timed, the rest is the solve.

Times are exclusive: what the sensor asks of the fibres counts as the fibres' time. They are
times of this process's processor, so that other processes do not enter.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import ParamSpec, TypeVar

import numpy as np

from cellsys.arguments import checked
from cellsys.effects.protocol import Configuration, Element, Stiffness
from cellsys.integrate.linearly_implicit import LinearlyImplicit
from cellsys.integrate.simulate import simulate
from cellsys.integrate.stepping import Stepper
from cellsys.kinds import Count, Seed
from cellsys.mechanics.spreading import SpreadingSystem
from cellsys.system import OdeSystem

_P = ParamSpec("_P")
_T = TypeVar("_T")
_METHODS = (
    "efforts", "force", "flows", "rates", "advance", "stiffness", "low_rank", "between_steps",
    "observe", "slopes", "unbuckled",
)  # fmt: skip
_SOLVE, _REST = "(solve)", "(stepping)"


def effect_of(element: Element) -> str:
    """Name of the effect that an element belongs to: the end of its own name."""
    return element.name.rpartition(".")[2]


class Stopwatch:
    """Exclusive times and calls by label, without the time that reading the clock takes."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.calls: dict[str, int] = {}
        self._inner: list[float] = []
        self._watched: list[tuple[Element, str]] = []
        self._reading = 0.0
        nothing = self.timed("nothing", lambda: None)
        for _ in range(1000):
            nothing()
        self._reading = self.seconds.pop("nothing") / self.calls.pop("nothing")

    def timed(self, label: str, function: Callable[_P, _T]) -> Callable[_P, _T]:
        """The function, with its calls counted and its time without that of timed ones inside."""

        def call(*arguments: _P.args, **named: _P.kwargs) -> _T:
            self._inner.append(0.0)
            began = time.process_time()
            try:
                return function(*arguments, **named)
            finally:
                took = time.process_time() - began - self._reading
                inside = self._inner.pop()
                self.seconds[label] = self.seconds.get(label, 0.0) + took - inside
                self.calls[label] = self.calls.get(label, 0) + 1
                if self._inner:
                    self._inner[-1] += took

        return call

    def watch(self, system: SpreadingSystem) -> None:
        """Time every element of a system from now on."""
        for element in system.elements:
            label = effect_of(element)
            for name in _METHODS:
                if getattr(type(element), name, None) is not getattr(Element, name, None):
                    self._set(element, name, self.timed(label, getattr(element, name)))
            if "stiffness" in vars(element):
                self._watch_matrices(label, element)
            if type(element).sensed is not Element.sensed:
                self._set(element, "sensed", self.timed("stiffness_sensing", element.sensed))

    def release(self) -> None:
        """The elements as they were."""
        for element, name in self._watched:
            delattr(element, name)
        self._watched.clear()

    def _set(self, element: Element, name: str, function: Callable[..., object]) -> None:
        setattr(element, name, function)
        self._watched.append((element, name))

    def _watch_matrices(self, label: str, element: Element) -> None:
        inner = element.stiffness

        def stiffness(s: Configuration) -> tuple[Stiffness, ...]:
            return tuple(item._replace(matrix=self.timed(label, item.matrix)) for item in inner(s))

        vars(element)["stiffness"] = stiffness


@checked
@dataclass(frozen=True)
class StepCost:
    """Mean time of one step, s.

    Parameters
    ----------
    whole : float
        Of a run that nothing watches.
    laws : dict
        In each effect's own calls: forces, energies' gradients, rates, bounds of its tangent.
    solve : float
        Summing the bounds, factorising, and solving with the factors and the rank-one terms.
    """

    whole: float
    laws: dict[str, float]
    solve: float

    @property
    def rest(self) -> float:
        """What is neither: putting vectors together, W_eta, deciding on corrections."""
        return self.whole - self.solve - sum(self.laws.values())


@dataclass(frozen=True, kw_only=True)
class _Watched(LinearlyImplicit):
    """A `LinearlyImplicit` whose factorising and solving are timed."""

    watch: Stopwatch

    def start(
        self, system: OdeSystem, t0: float, x0: np.ndarray, rng: np.random.Generator
    ) -> Stepper:
        stepper = super().start(system, t0, x0, rng)
        for name in ("_solve", "_look"):
            setattr(stepper, name, self.watch.timed(_SOLVE, getattr(stepper, name)))
        return stepper


@checked
def step_cost(
    system: SpreadingSystem, step: float, duration: float, seed: Seed = 0, repeats: Count = 1
) -> StepCost:
    """Cost of a step over `duration` s, after as many to warm up, without setting up the run.

    Steps with and without the stopwatch take turns, `repeats` times; of each kind the shortest
    counts: what other processes take is left out.
    """
    watch = Stopwatch()
    plain, watched = LinearlyImplicit(step=step), _Watched(step=step, watch=watch)
    x0 = simulate(system, plain, np.array([0.0, duration]), seed=seed, auxiliaries=False).x[-1]

    def once(method: LinearlyImplicit) -> tuple[float, int]:
        stepper = method.start(system, duration, x0, np.random.default_rng(seed))
        stepper.averages = False
        began = time.process_time()
        stepper.advance(2.0 * duration)
        return time.process_time() - began, stepper.statistics["steps"]

    whole = least = float("inf")
    for _ in range(repeats):
        took, steps = once(plain)
        whole = min(whole, took / steps)
        watch.seconds.clear()
        watch.watch(system)
        try:
            took, steps = once(watched)
        finally:
            watch.release()
        if took < least:
            least, seconds = took, dict(watch.seconds)
    laws = {label: total / steps for label, total in seconds.items()}
    return StepCost(whole, laws, laws.pop(_SOLVE))


def time_shares(
    system: SpreadingSystem, step: float, duration: float, seed: Seed = 0
) -> dict[str, float]:
    """Share of a run's time per effect, in the solve and in the rest; see `step_cost`."""
    cost = step_cost(system, step, duration, seed, repeats=2)
    parts = {**cost.laws, _SOLVE: cost.solve, _REST: max(0.0, cost.rest)}
    whole = sum(parts.values())
    return {label: seconds / whole for label, seconds in parts.items()}
