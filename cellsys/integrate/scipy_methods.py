"""Variable-step methods of scipy with root-found events: DOP853, Radau, LSODA."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import scipy.integrate as integrate

from cellsys.arguments import checked
from cellsys.errors import IntegrationError, ParameterError
from cellsys.integrate.hybrid import Rate, Solver, solve_hybrid
from cellsys.integrate.solution import Solution
from cellsys.system import OdeSystem
from cellsys.units import real_number

_LEAST = 100 * float(np.finfo(float).eps)  # scipy would raise a smaller rtol to this by itself


@dataclass(frozen=True, kw_only=True)
class _Method:
    """Settings shared by the variable-step methods."""

    rtol: float
    atol: float
    max_step: float = np.inf
    max_steps: int = 1_000_000
    cascade: int = 100
    first_step: float | None = field(default=None)
    finds_events: ClassVar[bool] = True
    local: ClassVar[float] = 1.0  # share of the tolerances that one step may leave
    untold: ClassVar[tuple[str, ...]] = ()  # counts that the program behind keeps to itself
    _solver: ClassVar[Callable[..., Solver]]

    def __post_init__(self) -> None:
        name = type(self).__name__
        for label in ("rtol", "atol", "max_step", "max_steps", "cascade"):
            value = getattr(self, label)
            if value != np.inf:
                value = real_number(value, f"{name}.{label}")
            if not (value > 0 and (np.isfinite(value) or label == "max_step")):
                raise ParameterError(f"{name}.{label} must be > 0, got {value!r}")
        if self.rtol < _LEAST:
            raise ParameterError(
                f"{name}.rtol must be >= {_LEAST:.2g}, a hundred roundings, got {self.rtol!r}"
            )
        if self.first_step is not None and not real_number(self.first_step, "first_step") > 0:
            raise ParameterError(f"{name}.first_step must be > 0 s, got {self.first_step!r}")

    def solve(
        self, system: OdeSystem, t: np.ndarray, x0: np.ndarray, *, averages: bool = True
    ) -> Solution:
        """Integrate over the grid `t`, with the system's events and stop points."""

        def start(fun: Rate, t0: float, x: np.ndarray, bound: float) -> Solver:
            first = None if self.first_step is None else min(self.first_step, bound - t0)
            solver = self._solver(
                fun,
                t0,
                x,
                bound,
                rtol=max(self.local * self.rtol, _LEAST),
                atol=self.local * self.atol,
                max_step=self.max_step,
                first_step=first,
            )
            # scipy tries steps of NaN for ever.
            step = getattr(solver, "h_abs", 0.0)
            if not (np.isfinite(step) and np.all(np.isfinite(fun(t0, x)))):
                raise IntegrationError(
                    f"{type(self).__name__}: the law is NaN or inf at the start of a piece, or "
                    "right after it; mend the law there, or start elsewhere",
                    time=t0,
                    state_norm=float(np.linalg.norm(x)),
                    step=0.0,
                )
            return solver

        solution = solve_hybrid(
            system,
            t,
            x0,
            start,
            name=type(self).__name__,
            max_steps=self.max_steps,
            cascade=self.cascade,
            averages=averages,
        )
        return replace(solution, statistics={**solution.statistics, **dict.fromkeys(self.untold)})


@checked
@dataclass(frozen=True, kw_only=True)
class DOP853(_Method):
    """Explicit Runge-Kutta of order 8 (Dormand and Prince); for systems that are not stiff.

    Parameters
    ----------
    rtol, atol : float
        Error per step is kept below rtol |x| + atol; there is no default.
    max_step, first_step : float
        Bounds on the step, s.
    max_steps : int
        Steps after which the run is given up with an `IntegrationError`.
    cascade : int
        Events at one instant after which the run is called chattering.
    """

    _solver = integrate.DOP853


@checked
@dataclass(frozen=True, kw_only=True)
class Radau(_Method):
    """Implicit Runge-Kutta of order 5 (Radau IIA), L-stable; for stiff systems.

    Parameters are those of `DOP853`.
    """

    untold: ClassVar[tuple[str, ...]] = ("rejected",)
    _solver = integrate.Radau


@checked
@dataclass(frozen=True, kw_only=True)
class LSODA(_Method):
    """Adams and BDF of variable order with automatic switching (ODEPACK).

    Parameters are those of `DOP853`, but a step may leave only a tenth (`local`) of the
    tolerances: errors of multistep methods add up to more than a hundred times that.
    """

    local: ClassVar[float] = 0.1
    untold: ClassVar[tuple[str, ...]] = ("jacobians", "factorisations", "rejected")

    _solver = integrate.LSODA

    def solve(
        self, system: OdeSystem, t: np.ndarray, x0: np.ndarray, *, averages: bool = True
    ) -> Solution:
        with warnings.catch_warnings():
            # What it warns of it also fails with, and the IntegrationError says so once.
            warnings.filterwarnings("ignore", message="lsoda:", category=UserWarning)
            return super().solve(system, t, x0, averages=averages)
