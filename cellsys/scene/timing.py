"""Where the time of a run goes: every element's own calls are timed, the rest is the solve.

Times are exclusive: what the sensor asks of the fibres counts as the fibres' time. They are
times of this process's processor, so that other processes do not enter.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from cellsys.integrate.linearly_implicit import LinearlyImplicit
from cellsys.integrate.simulate import simulate
from cellsys.mechanics.effects.protocol import Element
from cellsys.mechanics.spreading import SpreadingSystem

_METHODS = (
    "efforts", "force", "flows", "rates", "advance", "stiffness", "low_rank", "between_steps",
    "observe", "slopes",
)  # fmt: skip
_SOLVE, _REST = "(solve)", "(stepping)"


def effect_of(element: Element) -> str:
    """Name of the effect that an element belongs to: the end of its own name."""
    return element.name.rpartition(".")[2]


class Stopwatch:
    """Exclusive times and calls by label."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.calls: dict[str, int] = {}
        self._inner: list[float] = []

    def timed(self, label: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, with its calls counted and its time without that of timed ones inside."""

        def call(*arguments: Any) -> Any:
            self._inner.append(0.0)
            began = time.process_time()
            try:
                return function(*arguments)
            finally:
                took = time.process_time() - began
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
                    setattr(element, name, self.timed(label, getattr(element, name)))
            if "stiffness" in vars(element):
                self._watch_matrices(label, element)
            if hasattr(element, "sensed"):
                element.sensed = self.timed("stiffness_sensing", element.sensed)

    def _watch_matrices(self, label: str, element: Element) -> None:
        inner = element.stiffness

        def stiffness(s: Any) -> tuple:
            return tuple(item._replace(matrix=self.timed(label, item.matrix)) for item in inner(s))

        element.stiffness = stiffness


@dataclass(frozen=True)
class StepCost:
    """Mean time of one step, s: whole, in each effect's own calls, in factorising and solving."""

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

    def start(self, system: Any, t0: float, x0: Any, rng: Any) -> Any:
        stepper = super().start(system, t0, x0, rng)
        for name in ("_solve", "_look"):
            setattr(stepper, name, self.watch.timed(_SOLVE, getattr(stepper, name)))
        return stepper


def step_cost(
    system: SpreadingSystem, step: float, duration: float, seed: int = 0, repeats: int = 1
) -> StepCost:
    """Cost of a step of a fresh system, over `duration` s after as many to warm up.

    Of `repeats` the one with the shortest whole: what other processes take is left out. The
    system is watched for good: build a fresh one for other purposes.
    """
    watch = Stopwatch()
    watch.watch(system)
    method = _Watched(step=step, watch=watch)
    x0 = simulate(system, method, [0.0, duration], seed=seed, auxiliaries=False).x[-1]
    best: StepCost | None = None
    for _ in range(repeats):
        watch.seconds.clear()
        began = time.process_time()
        run = simulate(
            system, method, [duration, 2.0 * duration], x0, seed=seed, auxiliaries=False
        )
        whole, n = time.process_time() - began, run.statistics["steps"]
        laws = {label: seconds / n for label, seconds in watch.seconds.items()}
        cost = StepCost(whole / n, laws, laws.pop(_SOLVE))
        best = cost if best is None or cost.whole < best.whole else best
    return best


def time_shares(
    system: SpreadingSystem, step: float, duration: float, seed: int = 0
) -> dict[str, float]:
    """Share of a run's time per effect, in the solve and in the rest; see `step_cost`."""
    cost = step_cost(system, step, duration, seed)
    shares = {label: seconds / cost.whole for label, seconds in cost.laws.items()}
    return {**shares, _SOLVE: cost.solve / cost.whole, _REST: cost.rest / cost.whole}
