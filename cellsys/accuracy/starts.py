"""Starts that a budget is found and tried on, and the methods and references for each target."""

from __future__ import annotations

import dataclasses

import numpy as np

from cellsys.accuracy.setups import CostProblem, Setup, by_step, by_tolerance
from cellsys.arguments import checked
from cellsys.contracts import Integrator
from cellsys.errors import ParameterError
from cellsys.integrate import (
    BDF2,
    DOP853,
    LSODA,
    RKC,
    ExplicitEuler,
    LinearlyImplicit,
    Radau,
    stability_limit,
)
from cellsys.kinds import Count, Seed
from cellsys.loop import ClosedLoop
from cellsys.overdamped import OverdampedSystem
from cellsys.scene import Scene, build
from cellsys.scene.steppers import STEPS as STEPS_OF

TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
STEPS = (2.0, 1.0, 0.5, 0.25, 0.1)
PROBE = 10.0  # s of a scene that are run to find its setting
LONG = 100.0  # s of the held-out runs of a scene
EULER = 0.002  # asked share of the motion down to which explicit Euler is a reference
MOST = 500  # steps of RKC between two samples


@checked
def loop_problems(
    loop: ClosedLoop, count: Count, t: np.ndarray | None, seed: Seed
) -> list[CostProblem]:
    """The loop from `count` headings drawn from a seed."""
    times = np.arange(0.0, 1001.0) if t is None else np.asarray(t, dtype=float)
    rng = np.random.default_rng(seed)
    out = []
    for k in range(count):
        angle = rng.uniform(-np.pi, np.pi)
        p0 = float(np.linalg.norm(loop.p0)) * np.array([np.cos(angle), np.sin(angle), 0.0])
        out.append(
            CostProblem(
                name=f"loop, start {k}",
                system=loop.system,
                t=times,
                x0=np.concatenate([loop.z0, p0]),
            )
        )
    return out


@checked
def probe_times(scene: Scene, seconds: float) -> np.ndarray:
    """0 .. `seconds`, at most the scene's duration, by its sample but at least every 2 s."""
    if not 0 < seconds < np.inf:
        raise ParameterError(f"seconds must be finite and > 0 s, got {seconds!r}")
    end = min(seconds, scene.duration)
    return np.linspace(0.0, end, 1 + max(2, round(end / min(scene.sample, 2.0))))


@checked
def scene_problems(
    scene: Scene, count: Count, t: np.ndarray, seed: Seed, first: int = 0
) -> list[CostProblem]:
    """The scene from drawn headings, places and seeds, number `first` on; number 0 is its own.

    On a disc every cell draws a heading and all of them together a shift of up to 2 um
    along each axis (their distances stay). On a chain every crawler draws the velocities it
    starts with.
    """
    rng = np.random.default_rng(seed)
    out = []
    for k in range(first + count):
        drawn = scene
        if k:
            cells = scene.matrix_kind.start_elsewhere(scene, rng)
            drawn = dataclasses.replace(scene, cells=cells, seed=scene.seed + k)
        if k >= first:
            name = f"{scene.name}, start {k}"
            out.append(CostProblem(name=name, system=build(drawn), t=t, seed=drawn.seed))
    return out


@checked
def full_order_setups(problem: CostProblem) -> list[Setup]:
    """Every method for a full-order system but the references, loosest first."""
    if problem.system.events():
        tight = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
        return [by_tolerance(m, tight) for m in (LSODA, DOP853, Radau)]
    if problem.system.discrete:
        return [by_step(LinearlyImplicit, STEPS)]
    return [_setup_of(name) for name in ("LinearlyImplicit", "BDF2", "RKC")]


def _setup_of(stepper: str) -> Setup:
    """The settings of a stepper that a scene may name, loosest first."""
    if stepper == "RKC":
        return by_tolerance(RKC, (1e-2, 1e-3, 1e-4, 1e-5, 1e-6), {"max_steps": MOST})
    return by_step(BDF2 if stepper == "BDF2" else LinearlyImplicit, STEPS)


@checked
def scene_setups(scene: Scene) -> list[Setup] | None:
    """Settings of the stepper that a scene names; None for "auto", which takes any."""
    return None if scene.stepper == "auto" else [_setup_of(scene.stepper or "LinearlyImplicit")]


@checked
def stepped_by(scene: Scene, integrator: Integrator) -> Scene:
    """The scene with the stepper and the setting of an integrator that it may name.

    Raises
    ------
    ParameterError
        For any other integrator.
    """
    if isinstance(integrator, RKC):
        step = min(integrator.largest_step, STEPS_OF["RKC"])
        return dataclasses.replace(scene, stepper="RKC", tolerance=integrator.rtol, step=step)
    if not isinstance(integrator, (LinearlyImplicit, BDF2)):
        raise ParameterError(
            f"a scene is stepped by LinearlyImplicit, BDF2 or RKC, not by {integrator!r}"
        )
    same = scene.stepper is None and isinstance(integrator, LinearlyImplicit)
    name = None if same else type(integrator).__name__
    return dataclasses.replace(scene, stepper=name, step=integrator.step, tolerance=None)


@checked
def full_order_references(problem: CostProblem, error: float) -> tuple[Setup, Setup]:
    """Two methods, each tighter than what is swept for an `error`; the first is the truth.

    Explicit Euler is off by 6 % of the motion of a spreading cell for every second of its step
    (measured at 6 and 22 ms on two discs); it takes starts on which contact opens and closes,
    where the steps of RKC fall with the tolerance. RKC confirms it; below an error of `EULER`
    the two are RKC and DOP853. Systems that change between steps leave no other choice than two
    first-order methods.
    """
    if problem.system.events():
        return by_tolerance(LSODA, [1e-11]), by_tolerance(DOP853, [1e-11])
    if not isinstance(problem.system, OverdampedSystem):
        raise ParameterError(
            "the references of a full-order run are for nodes with drag, got a "
            f"{type(problem.system).__name__}"
        )
    limit = 0.9 * stability_limit(problem.system)
    if problem.system.discrete:
        return by_step(ExplicitEuler, [limit]), by_step(LinearlyImplicit, [0.5 * STEPS[-1]])
    if error < EULER:
        tight = by_tolerance(RKC, [1e-8], {"max_steps": 10 * MOST})
        return tight, by_tolerance(DOP853, [1e-8], {"max_steps": 100 * MOST})
    euler = by_step(ExplicitEuler, [min(limit, 0.5 * error)])
    tolerance = min(3e-4 * error, 1e-5)
    return euler, by_tolerance(RKC, [tolerance], {"max_steps": 10 * MOST})


def uncapped(integrator: Integrator) -> Integrator:
    """The integrator without the cap on steps that only keeps a search short."""
    if isinstance(integrator, RKC):
        return dataclasses.replace(integrator, max_steps=RKC.max_steps)
    return integrator
