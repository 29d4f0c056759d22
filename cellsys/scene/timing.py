"""Where the time of a run goes: every element's own calls are timed, the rest is the solve.

Times are exclusive: what the sensor asks of the fibres counts as the fibres' time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from cellsys.integrate.linearly_implicit import LinearlyImplicit
from cellsys.integrate.simulate import simulate
from cellsys.mechanics.effects.protocol import Element
from cellsys.mechanics.spreading import SpreadingSystem

_METHODS = (
    "efforts", "force", "flows", "rates", "advance", "stiffness", "low_rank", "between_steps",
    "observe", "slopes",
)  # fmt: skip
REST = "solve and stepping"


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
            began = time.perf_counter()
            try:
                return function(*arguments)
            finally:
                took = time.perf_counter() - began
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


def time_shares(
    system: SpreadingSystem, step: float, duration: float, seed: int = 0
) -> dict[str, float]:
    """Share of a run's time per effect, and of the solve; they add up to 1.

    The first half of the run warms up (compiling, first factorisations), the second is timed.
    The system is watched for good: build a fresh one for other purposes.
    """
    watch = Stopwatch()
    watch.watch(system)
    method = LinearlyImplicit(step=step)
    first = simulate(system, method, [0.0, duration], seed=seed, auxiliaries=False)
    watch.seconds.clear()
    began = time.perf_counter()
    simulate(
        system, method, [duration, 2.0 * duration], first.x[-1], seed=seed, auxiliaries=False
    )
    whole = time.perf_counter() - began
    shares = {label: seconds / whole for label, seconds in watch.seconds.items()}
    return {**shares, REST: 1.0 - sum(shares.values())}
