"""Runs of systems with a step of their own: one march, one way to record, one estimate.

    x_k+1 = step(x_k, u_k, t_k),    t_k = t_0 + k dt

A system needs `states`, `x0`, `dt` and `step` (`cellsys.contracts.StepSystem`). What its steps keep
for each other, what a sample shows and what the run reports at its end it gives by `begin`
(`StartsRuns`); by `better` it gives the system whose run its error is measured by (`Refines`).
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np

from cellsys.arguments import checked, unchecked
from cellsys.contracts import StepSystem, needs
from cellsys.errors import DataError, DimensionError, IntegrationError, ParameterError
from cellsys.integrate.capabilities import Refines, StartsRuns, StepRunner
from cellsys.integrate.estimate import estimate_by
from cellsys.store.memory import check_memory
from cellsys.system import Event, Layout
from cellsys.trajectory import ErrorEstimate, Trajectory
from cellsys.units import real_array

_OFF = 1e-6  # of a step: times this far from the grid are on it
_OBSERVED = ("p", "d", "amplitude", "virial", "stiffness")  # what a trajectory has room for


class Steps(Protocol):
    """What has a step of its own."""

    @property
    def dt(self) -> float:
        """s."""


@checked
class StepRun:
    """One run of a system: its step, and what is kept between steps.

    A system that keeps nothing needs no subclass.
    """

    def __init__(self, system: StepSystem) -> None:
        self.system = system

    @property
    def recorded(self) -> Layout:
        """What a sample shows; default the states."""
        return self.system.states

    @unchecked
    def step(self, x: np.ndarray, u: np.ndarray | None, t: float) -> np.ndarray:
        """x a step later, in a new array."""
        return self.system.step(x, u, t)

    @unchecked
    def record(self, x: np.ndarray) -> np.ndarray:
        """The row of `recorded` at the state x."""
        return x

    def observed(self, marks: np.ndarray, rows: np.ndarray) -> dict[str, np.ndarray]:
        """Read-outs ``p``, ``d``, ``amplitude`` of samples, taken after `marks` (T,) steps.

        `rows` (T, .) are the recorded ones.
        """
        return {}

    def events(self) -> Sequence[Event]:
        """What happened, at the end of the run."""
        return ()

    def statistics(self) -> Mapping[str, float]:
        """Counts, at the end of the run."""
        return {}


def run_of(system: StepSystem) -> StepRunner:
    """A fresh run of a system."""
    return system.begin() if isinstance(system, StartsRuns) else StepRun(system)


def refuse_integrator(system: Steps, integrator: object, instead: str = "") -> None:
    """Refuse an integrator given to a system with its own step.

    Raises
    ------
    ParameterError
        With the step, and what can be done instead.
    """
    if integrator is not None:
        raise ParameterError(
            f"{type(system).__name__} steps by itself every {system.dt:g} s and takes no "
            f"integrator, got {integrator!r}; leave it out (None)"
            + (f", or {instead}" if instead else "")
        )


def marks_of(times: np.ndarray, dt: float, who: str) -> np.ndarray:
    """Numbers of steps (T,) from the first of the times to each.

    Raises
    ------
    ParameterError
        When a time does not lie on the grid of the steps.
    """
    count = (times - times[0]) / dt
    off = np.abs(count - np.round(count))
    if off.max() > _OFF:
        k = int(np.argmax(off > _OFF))
        raise ParameterError(
            f"t must lie on the grid of {who}, {times[0]:g} s and whole steps of {dt:g} s, and "
            f"t[{k}] = {times[k]:g} s does not"
        )
    return np.round(count).astype(int)


def held_inputs(u: np.ndarray | None, steps: int) -> np.ndarray | None:
    """Inputs (steps, n_u), each held over its step, from (n_u,) or (steps, n_u).

    Raises
    ------
    DimensionError, DataError
    """
    if u is None:
        return None
    values = real_array(u, "u")
    if values.ndim == 1:
        values = np.broadcast_to(values, (steps, len(values)))
    if values.ndim != 2 or len(values) != steps:
        raise DimensionError(
            f"u must be (n_u,), held all the time, or ({steps}, n_u), held over each step; got "
            f"shape {np.shape(u)}"
        )
    if not np.all(np.isfinite(values)):
        raise DataError("u holds NaN or inf")
    return values


def simulate_steps(
    system: StepSystem,
    times: np.ndarray,
    x0: np.ndarray,
    u: np.ndarray | None,
    progress: Callable[[float], None] | None,
    label: str,
    model_error: Mapping[str, float] | None,
    until: Callable[[float, np.ndarray], bool] | None,
) -> Trajectory:
    """Run a system over checked times from a checked start; see `simulate`."""
    dt, who = float(system.dt), type(system).__name__
    if not (np.isfinite(dt) and dt > 0):
        raise ParameterError(f"{who}.dt must be > 0 s, got {system.dt!r}")
    marks = marks_of(times, dt, who)
    inputs = held_inputs(u, int(marks[-1]))
    began = clock.perf_counter()
    run = run_of(system)
    needs(run, StepRun, f"{who}.begin()")
    check_memory(8.0 * len(times) * run.recorded.size, "this run needs", "sample less often")
    rows = _march(run, x0, inputs, marks, float(times[0]), progress, until)
    marks, times = marks[: len(rows)], times[: len(rows)]
    statistics = {
        "steps": int(marks[-1]),
        **run.statistics(),
        "wall_time": clock.perf_counter() - began,
    }

    def again(better: StepSystem) -> np.ndarray:
        parts = max(1, round(dt / better.dt))
        held = None if inputs is None else np.repeat(inputs[: marks[-1]], parts, axis=0)
        return _march(run_of(better), x0, held, parts * marks, float(times[0]))

    seen = run.observed(marks, rows)
    if unknown := sorted(set(seen) - set(_OBSERVED)):
        raise ParameterError(
            f"{who}.begin().observed() must return read-outs among {', '.join(_OBSERVED)}, got "
            f"{unknown[0]!r}"
        )
    return Trajectory(
        t=times,
        x=rows,
        states=run.recorded,
        p=seen.get("p"),
        d=seen.get("d"),
        amplitude=seen.get("amplitude"),
        virial=seen.get("virial"),
        stiffness=seen.get("stiffness"),
        events=tuple(run.events()),
        statistics=statistics,
        label=label,
        estimator=_estimator(system, rows, again),
        model_error=dict(model_error or {}),
    )


def _estimator(
    system: StepSystem, rows: np.ndarray, again: Callable[[StepSystem], np.ndarray]
) -> Callable[[], ErrorEstimate]:
    if isinstance(system, Refines):
        said, share = system.better_by
        return estimate_by(rows, lambda: again(system.better()), said, share)
    why = f"the steps of {type(system).__name__} come without an estimate"
    return lambda: ErrorEstimate(None, np.abs(rows).max(axis=0), why)


def _march(
    run: StepRunner,
    x: np.ndarray,
    inputs: np.ndarray | None,
    marks: np.ndarray,
    t0: float,
    progress: Callable[[float], None] | None = None,
    until: Callable[[float, np.ndarray], bool] | None = None,
) -> np.ndarray:
    """Recorded rows after `marks` steps from x, or up to the one where `until` is true."""
    dt, n, rows = float(run.system.dt), len(x), np.empty((len(marks), run.recorded.size))
    rows[0] = run.record(x)
    done = 0
    for i, mark in enumerate(marks[1:].tolist(), start=1):
        for k in range(done, mark):
            before, t = x, t0 + k * dt
            x = run.step(x, None if inputs is None else inputs[k], t)
            if np.shape(x) != (n,):
                raise DimensionError(
                    f"{type(run.system).__name__}.step must return ({n},), got {np.shape(x)}"
                )
            if not np.isfinite(np.sum(x)):
                _fail(run.system, before, x, t + dt)
        done = mark
        rows[i] = run.record(x)
        ends = until is not None and until(t0 + mark * dt, x)
        if progress is not None:
            progress(1.0 if ends else mark / int(marks[-1]))
        if ends:
            return rows[: i + 1]
    return rows


def _fail(system: StepSystem, before: np.ndarray, x: np.ndarray, t: float) -> None:
    bad = np.flatnonzero(~np.isfinite(x))
    name = system.states.names[bad[0]] if bad.size else "the sum of the states"
    raise IntegrationError(
        f"{type(system).__name__}: {name} is not finite",
        time=t,
        state_norm=float(np.linalg.norm(before)),
        step=float(system.dt),
    )
