"""The cheapest setting that meets an error, shown on starts it was not chosen on.

Settings are timed and measured on a few training starts; the cheapest whose worst error there is
below error/margin is then tried on held-out starts: other headings, and for a scene other places,
other seeds and runs ten times as long. If it misses, the next more accurate one is tried. When
none meets the error, the floor that prevents it is named.
"""

from __future__ import annotations

import dataclasses
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from cellsys.accuracy.measures import measure
from cellsys.accuracy.setups import CostProblem, Setup, by_tolerance
from cellsys.accuracy.starts import (
    LONG,
    PROBE,
    TOLERANCES,
    full_order_references,
    full_order_setups,
    loop_problems,
    probe_times,
    scene_problems,
    uncapped,
)
from cellsys.accuracy.work_precision import WorkPrecision, work_precision
from cellsys.arguments import checked
from cellsys.contracts import Integrator, LinearModel
from cellsys.errors import CellsysError, DataError, IntegrationError, ParameterError
from cellsys.integrate import CVODES, DOP853, LSODA, Exponential
from cellsys.integrate.record import check_times
from cellsys.kinds import Seed
from cellsys.loop import ClosedLoop, ScheduledLoop, closed_loop
from cellsys.scene import Scene
from cellsys.shown import Shown


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Budget(Shown):
    """The answer of `budget`.

    Parameters
    ----------
    error, measure : float, str
        What was asked for.
    integrator : object or None
        The cheapest integrator that meets it; None when none does.
    seconds : float
        Time of one training run with it; NaN when none does.
    training, held_out : float
        Its worst error on the training and on the held-out starts.
    floor : str
        What prevents the error when no setting meets it, else "".
    sweeps : tuple of WorkPrecision
        What was measured on the training starts.
    """

    error: float
    measure: str
    integrator: Integrator | str | None
    seconds: float
    training: float
    held_out: float
    floor: str
    sweeps: tuple[WorkPrecision, ...]

    @property
    def margin(self) -> float:
        """Asked error over the worst held-out error; above 1 it is met with room."""
        return self.error / self.held_out if self.held_out else float("inf")

    def __bool__(self) -> bool:
        return self.integrator is not None

    def __str__(self) -> str:
        asked = f"{self.measure} error {self.error:g}"
        if self.integrator is None:
            return f"no setting meets {asked}: {self.floor}"
        return (
            f"{asked}: {self.integrator!r}, {1e3 * self.seconds:.3g} ms a run; worst held-out "
            f"error {self.held_out:.2g} (margin {self.margin:.2g})"
        )


@checked
def budget(
    target: ClosedLoop | ScheduledLoop | LinearModel | Scene,
    *,
    error: float,
    measure: str | None = None,
    t: np.ndarray | None = None,
    held_out_t: np.ndarray | None = None,
    margin: float = 2.0,
    training: int = 3,
    held_out: int = 2,
    seed: Seed = 0,
    setups: Sequence[Setup] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Budget:
    """The cheapest setting of an integrator that meets an error.

    Parameters
    ----------
    target : ClosedLoop, ScheduledLoop, LinearModel or Scene
        A loop on a reduced model, such a model with a sensor (its loop is closed here), or a
        scene (its full-order system).
    error : float
        Largest error in the measure.
    measure : str, optional
        One of `cellsys.accuracy.MEASURES`; default "maximum" for a loop and "motion" for a scene.
    t : array, optional
        Samples of the training runs, s; default 0 .. 1000 s by 1 s for a loop, 10 s by the
        scene's sample (at most 2 s) for a scene.
    held_out_t : array, optional
        Samples of the held-out runs, s; default `t` for a loop, and 100 s of a scene (or all of
        it). What is promised is the error over these and over the length of `t`.
    margin : float
        Errors on the training starts must be this factor smaller than asked.
    training, held_out : int
        Starts that the setting is chosen on, and other ones that it is tried on.
    seed : int
        Of the starts.
    setups : sequence of Setup, optional
        Default every method that suits the target.
    progress : callable, optional
        Called with a stage's name and its share done.

    Raises
    ------
    ParameterError
        For an error or margin out of range, a target of another kind, or a model without sensor.

    Notes
    -----
    A reduced model has an error of its own. Where its card measures one that is larger than
    `error`, no integrator can meet it: the answer is empty and names the model as the floor. A
    loop on an equivariant model steps by itself: its error is the one that its card measured on
    held-out runs, and there is nothing to choose. A scene is not weighed against reduced models
    of it: they cost the training runs, which the axis `runs_cost` shows; ask for the budget of
    the model itself.
    """
    if not (np.isfinite(error) and error > 0):
        raise ParameterError(f"error must be a finite number > 0, got {error!r}")
    if not margin >= 1:
        raise ParameterError(f"margin must be >= 1, got {margin!r}")
    if training < 1 or held_out < 0:
        raise ParameterError(
            f"training must be >= 1 and held_out >= 0, got {training!r} and {held_out!r}"
        )
    if not isinstance(target, (ClosedLoop, ScheduledLoop, Scene)):
        target = closed_loop(target)
    if isinstance(target, ScheduledLoop):
        return _of_own_step(target, error, t)
    if isinstance(target, ClosedLoop):
        kind, floor = "maximum", _model_floor(target, error)
        problems = loop_problems(target, training + held_out, t, seed)
        others = problems[training:]
        if held_out_t is not None:
            later = np.asarray(held_out_t, dtype=float)
            others = [dataclasses.replace(p, t=later) for p in others]
        ours = setups or [by_tolerance(m, TOLERANCES) for m in (Exponential, LSODA, DOP853)]
        ends = "rounding and the tightest tolerance of the sweep"
        references = (by_tolerance(Exponential, [1e-11]), by_tolerance(CVODES, [1e-11]))
        agree, repeats = 1e-7, 2
    else:
        kind, floor = "motion", ""
        short = probe_times(target, PROBE) if t is None else check_times(t)
        long = probe_times(target, LONG) if held_out_t is None else check_times(held_out_t)
        problems = scene_problems(target, training, short, seed)
        others = scene_problems(target, held_out, long, seed, training)
        ours = setups or full_order_setups(problems[0])
        ends = "the tightest setting of the sweep"
        references = full_order_references(problems[0], error)
        agree, repeats = 0.1 * error, 1
    measure = kind if measure is None else measure
    if floor:
        return _none(error, measure, floor)
    say = progress or (lambda stage, share: None)
    try:
        sweeps = tuple(
            work_precision(
                ours,
                p,
                references,
                error=measure,
                repeats=repeats,
                agree=agree,
                progress=partial(say, f"start {i} of {training}"),
            )
            for i, p in enumerate(problems[:training], 1)
        )
    except (DataError, IntegrationError) as apart:
        return _none(error, measure, f"it cannot be told whether it is met: {apart}")
    say("held-out starts", 0.0)
    found = _choose(
        error, measure, margin, ours, sweeps, others, problems[0].t[-1], references, ends
    )
    say("held-out starts", 1.0)
    return found


def _none(error: float, measure: str, floor: str) -> Budget:
    nan = float("nan")
    return Budget(
        error=error,
        measure=measure,
        integrator=None,
        seconds=nan,
        training=nan,
        held_out=nan,
        floor=floor,
        sweeps=(),
    )


def _of_own_step(loop: ScheduledLoop, error: float, t: np.ndarray | None) -> Budget:
    """A loop without a choice: its card's error, and the time of one run."""
    measure, dt = "held out", loop.model.dt
    floor, row = _model_floor(loop, error), _card_row(loop)
    if floor or row is None:
        return _none(error, measure, floor or "the model has no card, so that its error is unknown")
    times = dt * np.arange(round(1000.0 / dt) + 1) if t is None else np.asarray(t, dtype=float)
    began = clock.perf_counter()
    loop.simulate(times)
    seconds = clock.perf_counter() - began
    found, nan = row[1], float("nan")
    return Budget(
        error=error,
        measure=measure,
        integrator=f"its own step of {dt:g} s",
        seconds=seconds,
        training=nan,
        held_out=found,
        floor="",
        sweeps=(),
    )


def _choose(
    error: float,
    measure: str,
    margin: float,
    setups: Sequence[Setup],
    sweeps: tuple[WorkPrecision, ...],
    others: list[CostProblem],
    early: float,
    references: tuple[Setup, Setup],
    ends: str,
) -> Budget:
    worst = [
        (max(p.seconds for p in row), max(p.error for p in row), row[0].setup, row[0].setting)
        for row in zip(*(s.points for s in sweeps), strict=True)
        if all(np.isfinite(p.error) and np.isfinite(p.seconds) for p in row)
    ]
    by_name = {s.name: s for s in setups}
    tried, tight = float("nan"), references[0]
    # Training starts have shown that the references agree: here one of them is enough.
    truths = [tight.solve(p, tight.settings[-1]) for p in others] if worst else []
    for seconds, found, name, setting in sorted(worst):
        if found > error / margin:
            continue
        setup = by_name[name]
        tried = max(
            (held_out_error(setup, setting, p, b, measure, early)
             for p, b in zip(others, truths, strict=True)),
            default=found,
        )  # fmt: skip
        if tried <= error:
            integrator = name if setup.make is None else uncapped(setup.make(setting))
            return Budget(
                error=error,
                measure=measure,
                integrator=integrator,
                seconds=seconds,
                training=found,
                held_out=tried,
                floor="",
                sweeps=sweeps,
            )
    best = min((found for _, found, _, _ in worst), default=float("nan"))
    floor = f"{ends} leaves {best:.2g} (asked {error:g} with a margin of {margin:g})"
    if not np.isnan(tried):
        floor = (
            f"what meets it on the training starts ({best:.2g} at best) leaves {tried:.2g} on "
            "held-out ones at the last; give more training starts or longer ones (t=)"
        )
    nan = float("nan")
    return Budget(
        error=error,
        measure=measure,
        integrator=None,
        seconds=nan,
        training=best,
        held_out=tried,
        floor=floor,
        sweeps=sweeps,
    )


def held_out_error(
    setup: Setup,
    setting: float,
    problem: CostProblem,
    truth: np.ndarray,
    name: str,
    early: float = np.inf,
) -> float:
    """Error of one setting against a reference (T, n); inf where it fails.

    It is the larger of two: over the whole run, and up to the time `early`, s.
    """
    try:
        with np.errstate(all="ignore"):
            x = setup.solve(problem, setting)
            rows = problem.t <= early + 1e-9
            found = measure(name, x, truth)
            if rows.sum() > 1:
                found = max(found, measure(name, x[rows], truth[rows]))
    except (CellsysError, RuntimeError, ArithmeticError):
        return float("inf")
    return found if np.isfinite(found) else float("inf")


def _card_row(loop: ClosedLoop | ScheduledLoop) -> tuple[str, float] | None:
    """Block and error that the model's card measured, held out where there is one."""
    card = loop.model.card
    rows = {} if card is None else (card.held_out or card.training)
    if not rows:
        return None
    block, row = next(iter(rows.items()))
    return block, float(row["model"])


def _model_floor(loop: ClosedLoop | ScheduledLoop, error: float) -> str:
    row = _card_row(loop)
    if row is None or row[1] <= error:
        return ""
    return (
        f"the model itself: its error on {row[0]} is {row[1]:.2g} (its card), whatever the "
        "integrator; use more training runs, another order, or the full-order model"
    )
