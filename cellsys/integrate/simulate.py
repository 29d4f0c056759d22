"""`simulate`: problem, method, data, in that order."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp

from cellsys.arguments import checked
from cellsys.contracts import Integrator
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.integrate.estimate import estimate_of, first_order
from cellsys.kinds import Seed
from cellsys.store.memory import available_memory as available_memory
from cellsys.store.memory import check_memory
from cellsys.system import Block, Event, Layout, OdeSystem
from cellsys.trajectory import ErrorEstimate, Trajectory
from cellsys.units import real_array

SEGMENT = 20  # samples between two checkpoints


class Sink(Protocol):
    """Where the rows of a run go: memory, or a run folder that can be resumed."""

    arrays: dict[str, np.ndarray]

    def checkpoint(self, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, Any]) -> None:
        """Make the rows so far durable."""

    def last_checkpoint(self) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
        """Where an interrupted run stopped."""


class _Memory:
    def __init__(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        need = 8.0 * sum(int(np.prod(s, dtype=object)) for s in shapes.values())
        check_memory(
            need,
            "this run needs",
            "sample less often, shorten the run, or record it without auxiliaries",
        )
        # Zeros of the system cost nothing until they are written.
        self.arrays = {name: np.zeros(shape) for name, shape in shapes.items()}

    def checkpoint(self, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, Any]) -> None:
        """Nothing to keep: a run in memory is not resumed."""

    def last_checkpoint(self) -> None:
        """None."""
        return None


def auxiliary_layout(system: OdeSystem) -> Layout:
    """Auxiliaries as logged: the system's own, then ``step_residual`` (n,)."""
    return system.auxiliaries + Layout(
        [Block("step_residual", (system.states.size,), "state/s", "component", "rate")]
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


def check_times(t: Any) -> np.ndarray:
    """Times as a float array: at least one, finite, increasing."""
    times = np.atleast_1d(real_array(t, "t"))
    if times.ndim != 1 or not times.size:
        raise DimensionError(f"t must be a 1-D array of times in s, got shape {np.shape(t)}")
    if not np.all(np.isfinite(times)):
        raise DataError("t holds NaN or inf")
    if np.abs(times).max() > 1e300:
        raise DataError(f"t reaches {np.abs(times).max():g} s; it must stay below 1e300 s")
    if np.any(np.diff(times) <= 0):
        raise DataError("t must increase from sample to sample")
    return times


@checked
def simulate(
    system: OdeSystem,
    integrator: Integrator,
    t: np.ndarray,
    x0: np.ndarray | None = None,
    *,
    seed: Seed | np.random.SeedSequence = 0,
    auxiliaries: bool = True,
    sink: Sink | None = None,
    progress: Callable[[float], None] | None = None,
    label: str = "",
    model_error: Mapping[str, float] | None = None,
    until: Callable[[float, np.ndarray], bool] | None = None,
) -> Trajectory:
    """Integrate a system and record it at the times `t`.

    Parameters
    ----------
    system : OdeSystem
        What to integrate.
    integrator : object of `cellsys.integrate`
        How; it carries its step or tolerances. LinearlyImplicit, RKC and ExplicitEuler are for
        full-order models, Exponential for closed loops on latent models, CVODES, IDAS,
        Collocation and RungeKutta4 for systems with a symbolic form; DOP853, Radau and LSODA
        take any system and locate its events.
    t : array (T,)
        Sample times, s, increasing; the run starts at t[0].
    x0 : array (n,), optional
        Initial state; default the system's own.
    seed : int or SeedSequence
        Of everything random in the run; the same seed gives the same run, bit for bit on one
        kind of processor and BLAS, to the last digits on another.
    auxiliaries : bool
        Whether eta and u are recorded (averages over each sampling interval).
    sink : Sink, optional
        Where rows go; default memory. A sink with a checkpoint is continued.
    progress : callable, optional
        Called with the share done, 0 to 1.
    label : str
        Name of the run.
    model_error : mapping, optional
        The model's part of the error by block, written to the trajectory.
    until : callable, optional
        ``until(t, x)`` is asked at every sample from a fixed-step integrator; where it is true
        the run ends, and later samples are neither computed nor returned.

    Raises
    ------
    IntegrationError
        When the integrator fails or returns NaN; it has the time, state norm and step.
    MemoryBudgetError
        When the record does not fit into memory.
    ParameterError
        When the system has events and the integrator does not look for them.
    """
    times = check_times(t)
    start = real_array(system.x0 if x0 is None else x0, "x0").copy()
    if start.shape != system.x0.shape:
        raise DimensionError(f"x0 must have shape {system.x0.shape}, got {start.shape}")
    if not np.all(np.isfinite(start)):
        raise DataError("x0 holds NaN or inf")
    guards = system.events()
    if guards and not getattr(integrator, "finds_events", False):
        raise ParameterError(
            f"{type(integrator).__name__} does not look for events and this system has some "
            f"({guards[0].name!r}, ...); use DOP853, Radau or LSODA"
        )
    if until is not None and hasattr(integrator, "solve"):
        raise ParameterError(
            f"{type(integrator).__name__} finds a whole run at once and cannot end it on a "
            "condition; use LinearlyImplicit or ExplicitEuler"
        )
    if hasattr(integrator, "solve") and getattr(system, "discrete", False):
        raise ParameterError(
            f"{type(integrator).__name__} knows no steps, and this system changes between them "
            "(binding, rupture, thermal forces); use LinearlyImplicit or ExplicitEuler"
        )
    rows = sink if sink is not None else _Memory(record_shapes(system, times, auxiliaries))
    if auxiliaries:
        rows.arrays["eta_start"][: system.auxiliaries.size] = system.eta(float(times[0]), start)
    began = clock.perf_counter()
    estimator = None
    if hasattr(integrator, "solve"):
        solution = integrator.solve(system, times, start, averages=auxiliaries)
        statistics, events = _record_solution(system, solution, times, rows, auxiliaries)
        own = solution.estimate
    else:
        rng = np.random.default_rng(
            seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
        )
        statistics, events = _march(
            system, integrator, times, start, rng, rows, auxiliaries, progress, until
        )
        own = None
    arrays = rows.arrays
    if until is not None:
        times, arrays = first_samples(statistics["samples"], times, arrays)
    # A stepper without tolerances reads its error from the samples, in `trajectory_of`.
    if "step" not in statistics:

        def again(second: Any) -> np.ndarray:
            return _samples(system, second, times, start, seed)

        estimator = estimate_of(integrator, arrays["x"], again, own)
    statistics["wall_time"] = statistics.get("wall_time", 0.0) + clock.perf_counter() - began
    statistics["integrator"] = repr(integrator)
    return trajectory_of(
        system, times, arrays, events, statistics, label, estimator, model_error
    )


def first_samples(
    count: int, t: np.ndarray, arrays: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times and recorded arrays of the first `count` samples."""
    rows = {"eta": count - 1, "u": count - 1, "eta_start": None}
    return t[:count], {name: a[: rows.get(name, count)] for name, a in arrays.items()}


def _samples(
    system: OdeSystem, integrator: Any, t: np.ndarray, x0: np.ndarray, seed: Any
) -> np.ndarray:
    """The states (T, n) alone of a run."""
    if hasattr(integrator, "solve"):
        return integrator.solve(system, t, x0, averages=False).x
    rows = _Memory({"x": (len(t), len(x0))})
    rng = np.random.default_rng(
        seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
    )
    _march(system, integrator, t, x0, rng, rows, False)
    return rows.arrays["x"]


def trajectory_of(
    system: OdeSystem,
    t: np.ndarray,
    arrays: Mapping[str, np.ndarray],
    events: tuple[Event, ...],
    statistics: Mapping[str, Any],
    label: str,
    estimator: Callable[[], ErrorEstimate] | None = None,
    model_error: Mapping[str, float] | None = None,
) -> Trajectory:
    """A `Trajectory` over recorded arrays."""
    full = "eta" in arrays
    if estimator is None and "step" in statistics:
        # A first-order stepper: its error is read from the samples.
        def estimator() -> ErrorEstimate:
            return first_order(t, arrays["x"], float(statistics["step"]))

    return Trajectory(
        t=t,
        x=arrays["x"],
        states=system.states,
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


def _log(
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


def _sample(
    system: OdeSystem, arrays: Mapping[str, np.ndarray], k: int, t: float, x: np.ndarray
) -> None:
    arrays["x"][k] = x
    for name, value in system.observe(t, x).items():
        if name in arrays:
            arrays[name][k] = value


def _march(
    system: OdeSystem,
    integrator: Any,
    t: np.ndarray,
    x0: np.ndarray,
    rng: np.random.Generator,
    rows: Sink,
    auxiliaries: bool,
    progress: Callable[[float], None] | None = None,
    until: Callable[[float, np.ndarray], bool] | None = None,
) -> tuple[dict[str, Any], tuple[Event, ...]]:
    stepper = integrator.start(system, float(t[0]), x0, rng)
    stepper.averages = auxiliaries
    first, wall = 0, 0.0
    kept = rows.last_checkpoint()
    if kept is not None:
        arrays, meta = kept
        first, wall = int(meta["sample"]), float(meta["wall_time"])
        stepper.t, stepper.x = float(t[first]), arrays["x"].copy()
        stepper.restore(arrays)
        stepper.events = [Event(*e) for e in meta["events"]]
        stepper.statistics.update(meta["statistics"])
        rng.bit_generator.state = meta["rng"]
    else:
        _sample(system, rows.arrays, 0, float(t[0]), x0)
    began, count = clock.perf_counter(), len(t)
    for k in range(first, len(t) - 1):
        before = stepper.x.copy()
        eta, u = stepper.advance(float(t[k + 1]))
        if auxiliaries:
            _log(system, rows.arrays, k, t, before, stepper.x, eta, u)
        _sample(system, rows.arrays, k + 1, float(t[k + 1]), stepper.x)
        if (k + 1) % SEGMENT == 0 and k + 2 < len(t):
            memory = stepper.memory()
            rows.checkpoint(
                {"x": stepper.x, **memory},
                {
                    "sample": k + 1,
                    "wall_time": wall + clock.perf_counter() - began,
                    "events": [list(e) for e in stepper.events],
                    "statistics": stepper.statistics,
                    "rng": rng.bit_generator.state,
                },
            )
        ends = until is not None and until(float(t[k + 1]), stepper.x)
        if progress is not None:
            progress(1.0 if ends else (k + 1) / (len(t) - 1))
        if ends:
            count = k + 2
            break
    statistics = {**stepper.statistics, "wall_time": wall}
    if until is not None:
        statistics["samples"] = count
    if getattr(integrator, "rtol", None) is None:
        statistics |= {"step": float(integrator.step), "estimate_is_quick": True}
    return statistics, tuple(stepper.events)


def _record_solution(
    system: OdeSystem, solution: Any, t: np.ndarray, rows: Sink, auxiliaries: bool
) -> tuple[dict[str, Any], tuple[Event, ...]]:
    arrays, x = rows.arrays, solution.x
    if isinstance(rows, _Memory):
        arrays["x"] = x  # no second copy
    else:
        arrays["x"][:] = x
    together = getattr(system, "observe_rows", None)
    if together is not None:
        for name, values in together(t, x).items():
            if name in arrays:
                arrays[name][:] = values
    else:
        for k in range(len(t)):
            for name, value in system.observe(float(t[k]), x[k]).items():
                if name in arrays:
                    arrays[name][k] = value
    if auxiliaries and len(t) > 1:
        n_eta, linear = system.auxiliaries.size, solution.u.copy()
        linear += (system.W_x @ x[:-1].T).T
        if n_eta:
            linear += (system.W_eta @ solution.eta.T).T
            arrays["eta"][:, :n_eta] = solution.eta
        arrays["eta"][:, n_eta:] = np.diff(x, axis=0) / np.diff(t)[:, None] - linear
        arrays["u"][:] = solution.u
    return dict(solution.statistics), tuple(solution.events)
