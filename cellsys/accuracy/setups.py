"""What a work-precision sweep varies: a problem, and ways to solve it at a setting."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import Integrator
from cellsys.errors import ParameterError
from cellsys.integrate import simulate
from cellsys.kinds import Seed
from cellsys.system import OdeSystem


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class CostProblem:
    """A run whose cost is asked for.

    Parameters
    ----------
    name : str
    system : OdeSystem
    t : array (T,)
        Samples, s.
    x0 : array (n,), optional
        Start; default the system's.
    seed : int
        Of what is random in the run.
    """

    name: str
    system: OdeSystem
    t: np.ndarray
    x0: np.ndarray | None = None
    seed: Seed = 0

    @property
    def start(self) -> np.ndarray:
        """x0 (n,)."""
        return np.asarray(self.system.x0 if self.x0 is None else self.x0, dtype=float)


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Setup:
    """A way to solve a problem at several settings.

    Parameters
    ----------
    name : str
    solve : callable
        ``solve(problem, setting)`` -> states (T, n).
    settings : sequence of float
        Tolerances or steps, loosest first.
    unit : str
        What a setting is: "tolerance" or "step, s".
    own : bool
        Whether the method is this package's own, not a wrapped one.
    make : callable, optional
        The integrator at a setting, where the setup is an integrator of this package.
    """

    name: str
    solve: Callable[[CostProblem, float], np.ndarray]
    settings: Sequence[float] = field(default=())
    unit: str = "tolerance"
    own: bool = False
    make: Callable[[float], Integrator] | None = None

    def __post_init__(self) -> None:
        if not len(self.settings):
            raise ParameterError(f"setup {self.name!r} needs at least one setting")


IntegratorClass = Annotated[type, "a class of integrators, such as cs.RungeKutta4"]
_OWN = ("BDF2", "Exponential", "LinearlyImplicit", "RKC")


@checked
def by_tolerance(
    method: IntegratorClass, tolerances: Sequence[float], fixed: Mapping[str, float] | None = None
) -> Setup:
    """A setup that gives rtol = atol = tolerance to an integrator class.

    `fixed` are further fields of the integrator (largest_step, say).
    """
    more = dict(fixed or {})
    return _setup(method, tolerances, "tolerance", lambda v: method(rtol=v, atol=v, **more))


@checked
def by_step(
    method: IntegratorClass, steps: Sequence[float], fixed: Mapping[str, float] | None = None
) -> Setup:
    """A setup that gives a step, s, to an integrator class; `fixed` as in `by_tolerance`."""
    more = dict(fixed or {})
    return _setup(method, steps, "step, s", lambda v: method(step=v, **more))


def _setup(
    method: type, settings: Sequence[float], unit: str, make: Callable[[float], Integrator]
) -> Setup:
    def solve(problem: CostProblem, setting: float) -> np.ndarray:
        return np.asarray(
            simulate(
                problem.system,
                make(setting),
                problem.t,
                problem.start,
                auxiliaries=False,
                seed=problem.seed,
            ).x
        )

    name = method.__name__
    return Setup(
        name=name, solve=solve, settings=tuple(settings), unit=unit, own=name in _OWN, make=make
    )
