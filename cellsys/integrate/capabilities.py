"""What systems and integrators may have besides what their contracts ask for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from cellsys.contracts import Integrator, Stepping, StepSystem, WholeRun
from cellsys.integrate.semilinear import Semilinear
from cellsys.system import Event, Layout, OdeSystem
from cellsys.trajectory import ErrorEstimate


class StepRunner(Protocol):
    """One run of a system with a step of its own: a `cellsys.integrate.StepRun`."""

    @property
    def system(self) -> StepSystem:
        """What runs."""

    @property
    def recorded(self) -> Layout:
        """What a sample shows."""

    def step(self, x: np.ndarray, u: np.ndarray | None, t: float) -> np.ndarray:
        """x a step later."""

    def record(self, x: np.ndarray) -> np.ndarray:
        """The row of `recorded` at the state x."""

    def observed(self, marks: np.ndarray, rows: np.ndarray) -> dict[str, np.ndarray]:
        """Read-outs of samples."""

    def events(self) -> Sequence[Event]:
        """What happened."""

    def statistics(self) -> Mapping[str, float]:
        """Counts."""


@runtime_checkable
class StartsRuns(Protocol):
    """A system with a step of its own whose runs keep something between steps."""

    def begin(self) -> StepRunner:
        """A `cellsys.integrate.StepRun`, fresh for each run."""


@runtime_checkable
class Refines(Protocol):
    """A system with a step of its own that knows a better one.

    ``better_by``: how it is better, in words, and the error of a run over its distance to the
    better one.
    """

    @property
    def better_by(self) -> tuple[str, float]:
        """How, and the share."""

    def better(self) -> StepSystem:
        """The same system with a finer step, by a whole number, or a better rule."""


class SplitFlows(Protocol):
    """Two exact flows of a system: of a linear plant, and of what turns.

    ``turns``: whether anything does; if not, `drift` is the whole. Rows of p keep their length.
    """

    @property
    def turns(self) -> bool:
        """Whether anything does."""

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

    @property
    def shown(self) -> Layout:
        """Names of what is shown."""

    def show(self, x: np.ndarray) -> np.ndarray:
        """What is shown (T, .) of states (T, n)."""


@runtime_checkable
class FindsEvents(Protocol):
    """An integrator that may locate events."""

    @property
    def finds_events(self) -> bool:
        """Whether it does."""


@runtime_checkable
class FixedSteps(Protocol):
    """An integrator with a fixed step, s."""

    @property
    def step(self) -> float | None:
        """s; None where tolerances are given instead."""


@runtime_checkable
class ObservesRows(Protocol):
    """A system that observes all samples of a run at once."""

    def observe_rows(self, t: np.ndarray, x: np.ndarray) -> dict[str, np.ndarray]:
        """Read-outs of samples x (T, n)."""


@runtime_checkable
class JudgesItself(Protocol):
    """An integrator with an estimate of its own for the error of a run."""

    def estimator(
        self,
        system: OdeSystem,
        t: np.ndarray,
        x: np.ndarray,
        again: Callable[[Integrator, np.ndarray], np.ndarray],
    ) -> Callable[[], ErrorEstimate]:
        """Estimate of samples x (T, n); ``again(integrator, times)`` runs it anew."""


@runtime_checkable
class ComposesFlows(Protocol):
    """An integrator that on coupled cells composes exact flows."""

    def of_cells(self) -> WholeRun | Stepping:
        """The `Splitting` that it then is."""


@runtime_checkable
class Tolerances(Protocol):
    """An integrator that may have tolerances."""

    @property
    def rtol(self) -> float | None:
        """Relative."""

    @property
    def atol(self) -> float | None:
        """Absolute."""


@runtime_checkable
class BoundsStages(Protocol):
    """An integrator whose steps have bounds beside the tolerance, such as `RKC`."""

    @property
    def largest_stages(self) -> int:
        """Most stages of a step."""

    @property
    def largest_step(self) -> float:
        """s."""


@runtime_checkable
class EstimatesError(Protocol):
    """An integrator whose solutions come with an estimate of their error."""

    @property
    def estimates(self) -> str:
        """How, in words."""


@runtime_checkable
class Ordered(Protocol):
    """An integrator of known order."""

    @property
    def order(self) -> int:
        """q, of the global error in the step."""


@runtime_checkable
class SymbolicMethod(Protocol):
    """A method that CasADi can differentiate."""

    @property
    def plugin(self) -> str:
        """What CasADi calls it."""

    def options(self, span: float) -> Mapping[str, float | str | Mapping[str, float]]:
        """CasADi's options for a piece of `span` seconds."""


@runtime_checkable
class HasParameters(Protocol):
    """A system with named parameters."""

    @property
    def parameter_values(self) -> np.ndarray:
        """Values (n_p,), in the order of their names."""


@runtime_checkable
class NamesLinearPart(Protocol):
    """A system that `Exponential` can take apart, such as a closed loop on a latent model."""

    def semilinear(self) -> Semilinear:
        """Its linear part and what is slow."""
