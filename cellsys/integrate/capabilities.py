"""What systems and integrators may have besides what their contracts ask for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np

from cellsys.contracts import StepSystem
from cellsys.system import Layout, OdeSystem
from cellsys.trajectory import ErrorEstimate


@runtime_checkable
class StartsRuns(Protocol):
    """A system with a step of its own whose runs keep something between steps."""

    def begin(self) -> Any:
        """A `cellsys.integrate.StepRun`, fresh for each run."""


@runtime_checkable
class Refines(Protocol):
    """A system with a step of its own that knows a better one.

    ``better_by``: how it is better, in words, and the error of a run over its distance to the
    better one.
    """

    better_by: tuple[str, float]

    def better(self) -> StepSystem:
        """The same system with a finer step, by a whole number, or a better rule."""


class SplitFlows(Protocol):
    """Two exact flows of a system: of a linear plant, and of what turns.

    ``turns``: whether anything does; if not, `drift` is the whole. Rows of p keep their length.
    """

    turns: bool

    def parts(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State of the plant, and p (K, .), of a state x (n,)."""

    def whole(self, plant: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Inverse of `parts`."""

    def drift(self, plant: np.ndarray, p: np.ndarray, h: float) -> np.ndarray:
        """The plant after h with p held."""

    def turn(self, plant: np.ndarray, p: np.ndarray, h: float) -> np.ndarray:
        """p after h with the plant held."""

    def blame(self) -> str:
        """Why a run grows beyond all bounds."""


@runtime_checkable
class Splits(Protocol):
    """A system that comes apart into two exact flows, such as coupled cells."""

    def splitting(self) -> SplitFlows:
        """The flows."""


@runtime_checkable
class Shows(Protocol):
    """A system whose samples show something else than its states."""

    shown: Layout

    def show(self, x: np.ndarray) -> np.ndarray:
        """What is shown (T, .) of states (T, n)."""


@runtime_checkable
class FindsEvents(Protocol):
    """An integrator that may locate events."""

    finds_events: bool


@runtime_checkable
class FixedSteps(Protocol):
    """An integrator with a fixed step, s."""

    step: float | None


@runtime_checkable
class ObservesRows(Protocol):
    """A system that observes all samples of a run at once."""

    def observe_rows(self, t: np.ndarray, x: np.ndarray) -> dict[str, np.ndarray]:
        """Read-outs of samples x (T, n)."""


@runtime_checkable
class JudgesItself(Protocol):
    """An integrator with an estimate of its own for the error of a run."""

    def estimator(
        self, system: OdeSystem, t: np.ndarray, x: np.ndarray, again: Any
    ) -> Callable[[], ErrorEstimate]:
        """Estimate of samples x (T, n); ``again(integrator, times)`` runs it anew."""


@runtime_checkable
class ComposesFlows(Protocol):
    """An integrator that on coupled cells composes exact flows."""

    def of_cells(self) -> Any:
        """The `Splitting` that it then is."""
