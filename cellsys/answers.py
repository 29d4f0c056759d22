"""What objects behind the contracts answer: a solution, a run, errors, flags, poles.

An object of your own may answer with anything that has these parts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping, Sequence
from typing import Protocol

import numpy as np

from cellsys.system import Event


class WholeSolution(Protocol):
    """What an integrator found of a whole run, such as a `cellsys.integrate.Solution`."""

    @property
    def x(self) -> np.ndarray:
        """States (T, n)."""

    @property
    def eta(self) -> np.ndarray | None:
        """Averages (T - 1, n_eta) over the intervals; None where they were not asked for."""

    @property
    def u(self) -> np.ndarray | None:
        """Averages (T - 1, n) over the intervals; None where they were not asked for."""

    @property
    def statistics(self) -> Mapping[str, object]:
        """Counts and times."""

    @property
    def events(self) -> Sequence[Event]:
        """What happened."""

    @property
    def estimate(self) -> Callable[[], np.ndarray] | None:
        """Its own estimate (n,) of the largest error of each state."""


class SteppedRun(Protocol):
    """A run that goes from sample to sample, such as a `cellsys.integrate.Stepper`."""

    t: float
    x: np.ndarray
    averages: bool  # whether `advance` has to find them
    events: list[Event]

    @property
    def statistics(self) -> MutableMapping[str, int]:
        """Counts so far."""

    def advance(self, t1: float) -> tuple[np.ndarray, np.ndarray]:
        """Go on to t1; averages of eta and u on the way."""

    def memory(self) -> dict[str, np.ndarray]:
        """What the next interval depends on, apart from t and x."""

    def restore(self, memory: dict[str, np.ndarray]) -> None:
        """Take back what `memory` gave."""


class Measured(Protocol):
    """What a model is worth, such as a `cellsys.Card`: its errors by block, then by name."""

    @property
    def training(self) -> Mapping[str, Mapping[str, float]]:
        """Of the runs it was learned from."""

    @property
    def held_out(self) -> Mapping[str, Mapping[str, float]]:
        """Of runs it never saw."""


class OutsideRange(Protocol):
    """Something outside the trained range, such as a `cellsys.Flag`."""

    @property
    def time(self) -> float:
        """s."""

    @property
    def what(self) -> str:
        """Which quantity."""

    @property
    def value(self) -> float:
        """Its value."""

    @property
    def bound(self) -> float:
        """What it was trained up to."""


class DistinctPoles(Protocol):
    """Distinct poles with their multiplicities, such as `cellsys.population.PoleSet`."""

    @property
    def values(self) -> np.ndarray:
        """Complex (n,), 1/s."""

    @property
    def multiplicity(self) -> np.ndarray:
        """How often each occurs (n,)."""

    @property
    def abscissa(self) -> float:
        """Largest real part, 1/s."""
