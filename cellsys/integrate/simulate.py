"""`simulate`: problem, method, data, in that order."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping

import numpy as np

from cellsys.answers import WholeSolution
from cellsys.arguments import checked
from cellsys.contracts import Integrator, Stepping, StepSystem, WholeRun
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.integrate.capabilities import (
    FindsEvents,
    FixedSteps,
    JudgesItself,
    ObservesRows,
    Ordered,
    Shows,
)
from cellsys.integrate.estimate import estimate_of
from cellsys.integrate.record import (
    MemorySink,
    Sink,
    check_times,
    first_samples,
    log_averages,
    log_sample,
    record_shapes,
    trajectory_of,
)
from cellsys.integrate.step_runs import refuse_integrator, simulate_steps
from cellsys.kinds import Seed
from cellsys.system import Event, OdeSystem
from cellsys.threads import one_thread
from cellsys.trajectory import ErrorEstimate, Trajectory
from cellsys.units import real_array

SEGMENT = 20  # samples between two checkpoints


@checked
@one_thread()
def simulate(
    system: OdeSystem | StepSystem,
    integrator: Integrator | None,
    t: np.ndarray,
    x0: np.ndarray | None = None,
    *,
    u: np.ndarray | None = None,
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
    system : OdeSystem or StepSystem
        What to integrate, or what steps by itself: states, x0, dt and step(x, u, t) -> x+.
    integrator : object of `cellsys.integrate`; None for a StepSystem
        How; it carries its step or tolerances. LinearlyImplicit, BDF2, RKC and ExplicitEuler are
        for full-order models, Exponential for closed loops on latent models, CVODES, IDAS,
        Collocation and RungeKutta4 for systems with a symbolic form; DOP853, Radau and LSODA
        take any system and locate its events.
    t : array (T,)
        Sample times, s, increasing; the run starts at t[0].
    x0 : array (n,), optional
        Initial state; default the system's own.
    u : array (n_u,) or (steps, n_u), optional
        Inputs of a StepSystem, held all the time or over each of its steps.
    seed : int or SeedSequence
        Of everything random in the run; the same seed gives the same run, bit for bit on one
        kind of processor and BLAS, to the last digits on another.
    auxiliaries : bool
        Whether eta and u are recorded (averages over each sampling interval); a StepSystem has
        none.
    sink : Sink, optional
        Where rows go; default memory. A sink with a checkpoint is continued.
    progress : callable, optional
        Called with the share done, 0 to 1; by an integrator that finds a whole run at once, when
        it is done.
    label : str
        Name of the run.
    model_error : mapping, optional
        The model's part of the error by block, written to the trajectory.
    until : callable, optional
        ``until(t, x)`` is asked at every sample of fixed steps; where it is true
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
    if start.shape != (system.states.size,):
        raise DimensionError(f"x0 must have shape ({system.states.size},), got {start.shape}")
    if not np.all(np.isfinite(start)):
        raise DataError("x0 holds NaN or inf")
    if not isinstance(system, OdeSystem):
        refuse_integrator(system, integrator)
        if sink is not None:
            raise ParameterError(f"a {type(system).__name__} steps in memory; leave sink out")
        return simulate_steps(system, times, start, u, progress, label, model_error, until)
    if integrator is None:
        raise ParameterError(
            "integrator must be an integrator such as cs.DOP853(rtol=1e-8, atol=1e-10), got None"
        )
    if u is not None:
        raise ParameterError("an OdeSystem has its inputs in its forcing; leave u out")
    guards = system.events()
    if guards and not (isinstance(integrator, FindsEvents) and integrator.finds_events):
        raise ParameterError(
            f"{type(integrator).__name__} does not look for events and this system has some "
            f"({guards[0].name!r}, ...); use DOP853, Radau or LSODA"
        )
    whole = integrator if isinstance(integrator, WholeRun) else None
    if until is not None and whole is not None:
        raise ParameterError(
            f"{type(integrator).__name__} finds a whole run at once and cannot end it on a "
            "condition; use LinearlyImplicit or ExplicitEuler"
        )
    if whole is not None and system.discrete:
        raise ParameterError(
            f"{type(integrator).__name__} knows no steps, and this system changes between them "
            "(binding, rupture, thermal forces); use LinearlyImplicit or ExplicitEuler"
        )
    shows = system if isinstance(system, Shows) else None
    if shows is not None and (auxiliaries or sink is not None):
        raise ParameterError(
            f"samples of a {type(system).__name__} are no states: neither laws nor a run folder go "
            "with them; use auxiliaries=False and no sink"
        )
    rows = sink if sink is not None else MemorySink(record_shapes(system, times, auxiliaries))
    if auxiliaries:
        rows.arrays["eta_start"][: system.auxiliaries.size] = system.eta(float(times[0]), start)
    began = clock.perf_counter()
    own: Callable[[], np.ndarray] | None = None
    if isinstance(integrator, WholeRun):
        solution = integrator.solve(system, times, start, averages=auxiliaries)
        statistics, events = _record_solution(system, solution, times, rows, auxiliaries)
        own = solution.estimate
        count, spent = len(times), statistics.get("wall_time")
        if progress is not None:
            progress(1.0)
    else:
        rng = np.random.default_rng(
            seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
        )
        count, spent, statistics, events = _march(
            system, integrator, times, start, rng, rows, auxiliaries, progress, until
        )
    arrays = rows.arrays
    if until is not None:
        times, arrays = first_samples(count, times, arrays)
    x = arrays["x"] if shows is None else shows.show(arrays["x"])

    def again(second: Integrator, times: np.ndarray = times) -> np.ndarray:
        found = _samples(system, second, times, start, seed)
        return found if shows is None else shows.show(found)

    estimator: Callable[[], ErrorEstimate] | None = None
    if isinstance(integrator, JudgesItself):
        estimator = integrator.estimator(system, times, x, again)
    elif "step" not in statistics:
        estimator = estimate_of(integrator, x, again, own if shows is None else None)
    # A stepper without tolerances reads its error from the samples, in `trajectory_of`.
    before = spent if isinstance(spent, float) else 0.0
    statistics["wall_time"] = before + clock.perf_counter() - began
    statistics["integrator"] = repr(integrator)
    return trajectory_of(
        system,
        times,
        {**arrays, "x": x},
        events,
        statistics,
        label,
        estimator,
        model_error,
        None if shows is None else shows.shown,
    )


def _samples(
    system: OdeSystem,
    integrator: Integrator,
    t: np.ndarray,
    x0: np.ndarray,
    seed: int | np.random.SeedSequence,
) -> np.ndarray:
    """The states (T, n) alone of a run."""
    if isinstance(integrator, WholeRun):
        return integrator.solve(system, t, x0, averages=False).x
    rows = MemorySink({"x": (len(t), len(x0))})
    rng = np.random.default_rng(
        seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
    )
    _march(system, integrator, t, x0, rng, rows, False)
    return rows.arrays["x"]


def _march(
    system: OdeSystem,
    integrator: Stepping,
    t: np.ndarray,
    x0: np.ndarray,
    rng: np.random.Generator,
    rows: Sink,
    auxiliaries: bool,
    progress: Callable[[float], None] | None = None,
    until: Callable[[float, np.ndarray], bool] | None = None,
) -> tuple[int, float, dict[str, object], tuple[Event, ...]]:
    """Samples that were found, s of earlier parts of the run, statistics and events."""
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
        log_sample(system, rows.arrays, 0, float(t[0]), x0)
    began, count = clock.perf_counter(), len(t)
    for k in range(first, len(t) - 1):
        before = stepper.x.copy()
        eta, u = stepper.advance(float(t[k + 1]))
        if auxiliaries:
            log_averages(system, rows.arrays, k, t, before, stepper.x, eta, u)
        log_sample(system, rows.arrays, k + 1, float(t[k + 1]), stepper.x)
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
    statistics: dict[str, object] = {**stepper.statistics, "wall_time": wall}
    if until is not None:
        statistics["samples"] = count
    if isinstance(integrator, FixedSteps) and not isinstance(integrator, JudgesItself):
        step = integrator.step
        order = integrator.order if isinstance(integrator, Ordered) else 1
        if step is not None and (order == 1 or auxiliaries):  # without its log it runs again
            statistics |= {"step": float(step), "estimate_is_quick": True}
            if order > 1:
                statistics["order"] = order
    return count, wall, statistics, tuple(stepper.events)


def _record_solution(
    system: OdeSystem, solution: WholeSolution, t: np.ndarray, rows: Sink, auxiliaries: bool
) -> tuple[dict[str, object], tuple[Event, ...]]:
    arrays, x = rows.arrays, solution.x
    if isinstance(rows, MemorySink):
        arrays["x"] = x  # no second copy
    else:
        arrays["x"][:] = x
    if isinstance(system, ObservesRows):
        for name, values in system.observe_rows(t, x).items():
            if name in arrays:
                arrays[name][:] = values
    else:
        for k in range(len(t)):
            for name, value in system.observe(float(t[k]), x[k]).items():
                if name in arrays:
                    arrays[name][k] = value
    if auxiliaries and len(t) > 1:
        eta, u = solution.eta, solution.u
        if u is None or eta is None:
            raise DataError("the integrator found no averages of eta and u; auxiliaries=False")
        n_eta, linear = system.auxiliaries.size, u.copy()
        linear += (system.W_x @ x[:-1].T).T
        if n_eta:
            linear += (system.W_eta @ eta.T).T
            arrays["eta"][:, :n_eta] = eta
        arrays["eta"][:, n_eta:] = np.diff(x, axis=0) / np.diff(t)[:, None] - linear
        arrays["u"][:] = u
    return dict(solution.statistics), tuple(solution.events)
