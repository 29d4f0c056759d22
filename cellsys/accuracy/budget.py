"""The cheapest setting that meets an error, shown on starts it was not chosen on.

Settings are timed and measured on a few training starts; the cheapest whose worst error there is
below error/margin is then tried on held-out starts (other headings, other seeds). If it misses,
the next more accurate one is tried. When none meets the error, the floor that prevents it is
named.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellsys.accuracy.setups import CostProblem, Setup, by_step, by_tolerance
from cellsys.accuracy.work_precision import WorkPrecision, work_precision
from cellsys.errors import ParameterError
from cellsys.integrate import (
    CVODES,
    DOP853,
    LSODA,
    RKC,
    ExplicitEuler,
    Exponential,
    LinearlyImplicit,
    stability_limit,
)
from cellsys.loop import ClosedLoop
from cellsys.scene import Scene, build

TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
STEPS = (2.0, 1.0, 0.5, 0.25, 0.1)
PROBE = 10.0  # s of a scene that are run to find its setting


@dataclass(frozen=True, eq=False)
class Budget:
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
    integrator: Any
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


def budget(
    target: ClosedLoop | Scene,
    *,
    error: float,
    measure: str | None = None,
    t: np.ndarray | None = None,
    margin: float = 2.0,
    training: int = 2,
    held_out: int = 2,
    seed: int = 0,
    setups: Sequence[Setup] | None = None,
) -> Budget:
    """The cheapest setting of an integrator that meets an error.

    Parameters
    ----------
    target : ClosedLoop or Scene
        A loop on a latent model, or a scene (its full-order system over its first 10 s).
    error : float
        Largest error in the measure.
    measure : str, optional
        One of `cellsys.accuracy.MEASURES`; default "maximum" for a loop and "motion" for a scene.
    t : array, optional
        Samples of the probe, s; default 0 .. 1000 s by 1 s for a loop, 10 s by the
        scene's sample (at most 2 s) for a scene.
    margin : float
        Errors on the training starts must be this factor smaller than asked.
    training, held_out : int
        Starts that the setting is chosen on, and other ones that it is tried on.
    seed : int
        Of the starts.
    setups : sequence of Setup, optional
        Default every method that suits the target.

    Raises
    ------
    ParameterError
        For an error or margin out of range, or a target of another kind.

    Notes
    -----
    A latent model has an error of its own. Where the model's card measures one that is larger
    than `error`, no integrator can meet it: the answer is empty and names the model as the floor.
    """
    if not (np.isfinite(error) and error > 0):
        raise ParameterError(f"error must be a finite number > 0, got {error!r}")
    if not margin >= 1:
        raise ParameterError(f"margin must be >= 1, got {margin!r}")
    if isinstance(target, ClosedLoop):
        kind, floor = "maximum", _model_floor(target, error)
        problems = loop_problems(target, training + held_out, t, seed)
        ours = setups or [by_tolerance(m, TOLERANCES) for m in (Exponential, LSODA, DOP853)]
        ends = "rounding and the tightest tolerance of the sweep"
        references = (by_tolerance(Exponential, [1e-11]), by_tolerance(CVODES, [1e-11]))
        agree, repeats = 1e-7, 2
    elif isinstance(target, Scene):
        kind, floor = "motion", ""
        problems = scene_problems(target, training + held_out, t, seed)
        ours = setups or full_order_setups(problems[0])
        ends = "the tightest setting of the sweep"
        references = full_order_references(problems[0])
        agree, repeats = 0.1 * error, 1
    else:
        raise ParameterError(f"budget takes a ClosedLoop or a Scene, got {type(target).__name__}")
    measure = kind if measure is None else measure
    if floor:
        nan = float("nan")
        return Budget(error, measure, None, nan, nan, nan, floor, ())
    sweeps = tuple(
        work_precision(ours, p, references, error=measure, repeats=repeats, agree=agree)
        for p in problems[:training]
    )
    return _choose(error, measure, margin, ours, sweeps, problems[training:], references, ends)


def _choose(
    error: float,
    measure: str,
    margin: float,
    setups: Sequence[Setup],
    sweeps: tuple[WorkPrecision, ...],
    others: list[CostProblem],
    references: tuple[Setup, Setup],
    ends: str,
) -> Budget:
    worst = [
        (max(p.seconds for p in row), max(p.error for p in row), row[0].setup, row[0].setting)
        for row in zip(*(s.points for s in sweeps), strict=True)
        if all(np.isfinite(p.error) and np.isfinite(p.seconds) for p in row)
    ]
    by_name = {s.name: s for s in setups}
    tried = float("nan")
    for seconds, found, name, setting in sorted(worst):
        if found > error / margin:
            continue
        setup = by_name[name]
        single = dataclasses.replace(setup, settings=(setting,))
        held = [
            work_precision([single], p, references, error=measure, repeats=1, agree=np.inf)
            for p in others
        ]
        tried = max((w.points[0].error for w in held), default=found)
        if tried <= error:
            integrator = name if setup.make is None else setup.make(setting)
            return Budget(error, measure, integrator, seconds, found, tried, "", sweeps)
    best = min((found for _, found, _, _ in worst), default=float("nan"))
    floor = f"{ends} leaves {best:.2g} (asked {error:g} with a margin of {margin:g})"
    nan = float("nan")
    return Budget(error, measure, None, nan, best, tried, floor, sweeps)


def _model_floor(loop: ClosedLoop, error: float) -> str:
    card = loop.model.card
    rows = {} if card is None else (card.held_out or card.training)
    if not rows:
        return ""
    block, row = next(iter(rows.items()))
    if row["model"] <= error:
        return ""
    return (
        f"the model itself: its error on {block} is {row['model']:.2g} (its card), whatever the "
        "integrator; use more training runs, another order, or the full-order model"
    )


def loop_problems(
    loop: ClosedLoop, count: int, t: np.ndarray | None, seed: int
) -> list[CostProblem]:
    """The loop from `count` headings drawn from a seed."""
    times = np.arange(0.0, 1001.0) if t is None else np.asarray(t, dtype=float)
    rng = np.random.default_rng(seed)
    out = []
    for k in range(count):
        angle = rng.uniform(-np.pi, np.pi)
        p0 = float(np.linalg.norm(loop.p0)) * np.array([np.cos(angle), np.sin(angle), 0.0])
        out.append(
            CostProblem(f"loop, start {k}", loop.system, times, np.concatenate([loop.z0, p0]))
        )
    return out


def scene_problems(scene: Scene, count: int, t: np.ndarray | None, seed: int) -> list[CostProblem]:
    """The scene's full-order system from `count` draws of headings and seeds; first its own."""
    if t is None:
        end = min(PROBE, scene.duration)
        t = np.linspace(0.0, end, 1 + max(2, round(end / min(scene.sample, 2.0))))
    rng = np.random.default_rng(seed)
    out = []
    for k in range(count):
        turned = scene
        if k:
            cells = tuple(
                dataclasses.replace(c, polarity=float(rng.uniform(-np.pi, np.pi)))
                for c in scene.cells
            )
            turned = dataclasses.replace(scene, cells=cells, seed=scene.seed + k)
        out.append(CostProblem(f"{scene.name}, start {k}", build(turned), t, seed=turned.seed))
    return out


def full_order_setups(problem: CostProblem) -> list[Setup]:
    """Every method for a full-order system but the references, loosest first."""
    out = [by_step(LinearlyImplicit, STEPS)]
    if not getattr(problem.system, "discrete", False):
        out.append(by_tolerance(RKC, (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)))
    return out


def full_order_references(problem: CostProblem) -> tuple[Setup, Setup]:
    """Two methods, each tighter than what is swept.

    Systems that change between steps leave no other choice than two first-order methods.
    """
    euler = by_step(ExplicitEuler, [0.9 * stability_limit(problem.system)])
    if getattr(problem.system, "discrete", False):
        return euler, by_step(LinearlyImplicit, [0.5 * STEPS[-1]])
    return by_tolerance(RKC, [1e-8]), euler
