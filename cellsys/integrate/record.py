"""What a run records: where its rows go, which arrays they fill, and the trajectory over them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp

from cellsys.errors import DataError, DimensionError
from cellsys.integrate.estimate import first_order, left_over
from cellsys.store.memory import available_memory as available_memory
from cellsys.store.memory import check_memory
from cellsys.system import Block, Event, Layout, OdeSystem
from cellsys.trajectory import ErrorEstimate, Trajectory
from cellsys.units import real_array


class Sink(Protocol):
    """Where the rows of a run go: memory, or a run folder that can be resumed."""

    arrays: dict[str, np.ndarray]

    def checkpoint(self, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, object]) -> None:
        """Make the rows so far durable."""

    def last_checkpoint(self) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
        """Where an interrupted run stopped."""


class MemorySink:
    """Rows in memory, which must have room for them."""

    def __init__(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        need = 8.0 * sum(int(np.prod(s, dtype=object)) for s in shapes.values())
        check_memory(
            need,
            "this run needs",
            "sample less often, shorten the run, or record it without auxiliaries",
        )
        # Zeros of the system cost nothing until they are written.
        self.arrays = {name: np.zeros(shape) for name, shape in shapes.items()}

    def checkpoint(self, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, object]) -> None:
        """Nothing to keep: a run in memory is not resumed."""

    def last_checkpoint(self) -> None:
        """None."""
        return None


def auxiliary_layout(system: OdeSystem) -> Layout:
    """Auxiliaries as logged: the system's own, then ``step_residual`` (n,)."""
    return system.auxiliaries + Layout(
        [Block("step_residual", (system.states.size,), "state/s", role="component", kind="rate")]
    )


def record_shapes(
    system: OdeSystem, t: np.ndarray, auxiliaries: bool
) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays that a run of `system` over `t` fills."""
    n, T = system.states.size, len(t)
    shapes: dict[str, tuple[int, ...]] = {"x": (T, n)}
    if auxiliaries:
        shapes["eta"] = (max(T - 1, 0), auxiliary_layout(system).size)
        shapes["u"] = (max(T - 1, 0), n)
        shapes["eta_start"] = (shapes["eta"][1],)
    for name, value in system.observe(float(t[0]), system.x0).items():
        shapes[name] = (T, *value.shape)
    return shapes


def check_times(t: object) -> np.ndarray:
    """Times as a float array: at least one, finite, increasing."""
    times = np.atleast_1d(real_array(t, "t"))
    if times.ndim != 1 or not times.size:
        raise DimensionError(f"t must be a 1-D array of times in s, got shape {times.shape}")
    if not np.all(np.isfinite(times)):
        raise DataError("t holds NaN or inf")
    if np.abs(times).max() > 1e300:
        raise DataError(f"t reaches {np.abs(times).max():g} s; it must stay below 1e300 s")
    if np.any(np.diff(times) <= 0):
        raise DataError("t must increase from sample to sample")
    return times


def first_samples(
    count: int, t: np.ndarray, arrays: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times and recorded arrays of the first `count` samples."""
    rows = {"eta": count - 1, "u": count - 1, "eta_start": None}
    return t[:count], {name: a[: rows.get(name, count)] for name, a in arrays.items()}


def trajectory_of(
    system: OdeSystem,
    t: np.ndarray,
    arrays: Mapping[str, np.ndarray],
    events: tuple[Event, ...],
    statistics: Mapping[str, Any],
    label: str,
    estimator: Callable[[], ErrorEstimate] | None = None,
    model_error: Mapping[str, float] | None = None,
    states: Layout | None = None,
) -> Trajectory:
    """A `Trajectory` over recorded arrays; `states`: of x, where it does not hold the system's."""
    full = "eta" in arrays
    if estimator is None and "step" in statistics:
        # A stepper: its error is read from the samples, of a second-order one from the log.
        def estimator() -> ErrorEstimate:
            if statistics.get("order", 1) > 1:
                return left_over(t, arrays["x"], arrays["eta"][:, system.auxiliaries.size :])
            return first_order(t, arrays["x"], float(statistics["step"]))

    return Trajectory(
        t=t,
        x=arrays["x"],
        states=system.states if states is None else states,
        eta=arrays.get("eta"),
        u=arrays.get("u"),
        auxiliaries=auxiliary_layout(system) if full else Layout(),
        W_x=system.W_x if full else None,
        W_eta=(
            sp.csr_array(sp.hstack([system.W_eta, sp.eye_array(system.states.size)]))
            if full
            else None
        ),
        p=arrays.get("p"),
        d=arrays.get("d"),
        amplitude=arrays.get("amplitude"),
        virial=arrays.get("virial"),
        stiffness=arrays.get("stiffness"),
        eta_start=arrays.get("eta_start"),
        events=events,
        statistics=statistics,
        label=label,
        geometry=system.geometry(),
        estimator=estimator,
        model_error=dict(model_error or {}),
    )


def log_averages(
    system: OdeSystem,
    arrays: Mapping[str, np.ndarray],
    k: int,
    t: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    eta: np.ndarray,
    u: np.ndarray,
) -> None:
    """Row k of eta and u; what the laws do not explain goes to the last block."""
    rate = (after - before) / (t[k + 1] - t[k])
    n_eta = system.auxiliaries.size
    arrays["eta"][k, :n_eta] = eta
    arrays["eta"][k, n_eta:] = rate - system.W_x @ before - system.W_eta @ eta - u
    arrays["u"][k] = u


def log_sample(
    system: OdeSystem, arrays: Mapping[str, np.ndarray], k: int, t: float, x: np.ndarray
) -> None:
    """Row k of the states and of what the system observes."""
    arrays["x"][k] = x
    for name, value in system.observe(t, x).items():
        if name in arrays:
            arrays[name][k] = value
