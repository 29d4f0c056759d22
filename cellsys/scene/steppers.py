"""Which method steps a scene through time: the one that its [run] names, or what suits its class.

    [run]
    stepper = "BDF2"          # "auto" | "BDF2" | "RKC" | "LinearlyImplicit"
    step = "1.25 s"           # or tolerance = "0.02"

`step` is the longest step; `tolerance` is the local error of RKC (relative, and in um), and what
the other two may leave over of a rate. "auto" takes the cheapest setting of the scene's class
[notes: measurements, steppers].
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

import numpy as np

from cellsys.errors import SceneError
from cellsys.integrate.bdf2 import BDF2
from cellsys.integrate.linearly_implicit import LinearlyImplicit
from cellsys.integrate.rkc import RKC
from cellsys.integrate.stepping import SampledRun
from cellsys.scene.plan import ScenePlan
from cellsys.system import OdeSystem

SceneStepper = LinearlyImplicit | BDF2 | RKC

STEPPERS = ("auto", "BDF2", "RKC", "LinearlyImplicit")
_FREE = 100.0  # s: the tolerance of RKC and the samples alone decide
STEPS = {"BDF2": 1.25, "LinearlyImplicit": 0.5, "RKC": _FREE}  # s, where a scene names none
UNTOLD = STEPS["LinearlyImplicit"]  # s, of scenes whose stepper chooses its own
_TOLERANCE = 0.01  # of RKC
_DRAWN = 0.5  # s: how often RKC draws what binds and ruptures, where a scene names no step
_JUMPING = 0.25  # s: longest step of first order between bindings and ruptures


def check_stepping(stepper: str | None, step: float, tolerance: float | None) -> None:
    """Refuse a stepper that there is not, and settings that it does not take.

    Raises
    ------
    SceneError
        Naming the value, the bound and the cure.
    """
    if not (isfinite(step) and step > 0):
        raise SceneError(f"step must be > 0 s, got {step!r}")
    if stepper is not None and stepper not in STEPPERS:
        near = difflib.get_close_matches(stepper, STEPPERS, 1, 0.5)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise SceneError(f"run.stepper must be one of {', '.join(STEPPERS)}, got {stepper!r}{hint}")
    if stepper == "auto" and step != UNTOLD:
        raise SceneError(
            f'step = {step:g} s is given and stepper = "auto" chooses its own; name one of '
            f"{', '.join(STEPPERS[1:])} with it"
        )
    if tolerance is None:
        return
    if stepper is None:
        raise SceneError(
            f"run.tolerance = {tolerance!r} needs a stepper that keeps it; add run.stepper, one of "
            f"{', '.join(STEPPERS[1:])}"
        )
    if stepper == "auto":
        raise SceneError(
            f'run.tolerance = {tolerance!r} is given and stepper = "auto" chooses its own; leave '
            f"it out, or name one of {', '.join(STEPPERS[1:])}"
        )
    if not 0 < tolerance < 1:
        raise SceneError(
            f"run.tolerance must be > 0 and < 1, a share, got {tolerance!r}; 0.01 suits RKC, 0.05 "
            "the others"
        )


def stepper_told(
    steps: Mapping[str, float | None], stepper: str | None, tolerance: float | None
) -> str | None:
    """Of a scene file that names none: "auto", or None (LinearlyImplicit) where it names a step."""
    if stepper is None and tolerance is None and all(step is None for step in steps.values()):
        return "auto"
    return stepper


def step_told(values: Mapping[str, float | None], stepper: str | None) -> float:
    """Longest step, s, of what a scene file says under ``step`` and ``run.step``.

    Raises
    ------
    SceneError
        When both are given, or one to a stepper that chooses its own.
    """
    given = {key: value for key, value in values.items() if value is not None}
    if len(given) > 1:
        both = " and ".join(f"{key} = {value:g} s" for key, value in given.items())
        raise SceneError(f"{both} say the same thing twice; keep run.step")
    for key, value in given.items():
        if stepper == "auto":
            raise SceneError(
                f'{key} = {value:g} s is given and stepper = "auto" chooses its own; leave it out, '
                f"or name one of {', '.join(STEPPERS[1:])}"
            )
        return value
    return STEPS.get(stepper or "", UNTOLD)


@dataclass(frozen=True)
class BySystem:
    """A stepper whose setting depends on whether the system changes between steps.

    Binding and rupture, thermal forces and the like leave no method of second order, and their
    probabilities need a step.
    """

    smooth: SceneStepper
    changing: SceneStepper

    def of(self, system: OdeSystem) -> SceneStepper:
        """The method for a built system."""
        return self.changing if system.discrete else self.smooth

    def start(
        self, system: OdeSystem, t0: float, x0: np.ndarray, rng: np.random.Generator
    ) -> SampledRun:
        """A stepper at (t0, x0)."""
        return self.of(system).start(system, t0, x0, rng)


# Of a gel, whose factors fill as the power 1.5 of its nodes: explicit, without any.
GEL_TOLERANCE = 1e-3
GEL_AUTO = BySystem(
    RKC(rtol=GEL_TOLERANCE, atol=GEL_TOLERANCE),
    RKC(rtol=GEL_TOLERANCE, atol=GEL_TOLERANCE, largest_step=_DRAWN),
)
AUTO = BySystem(BDF2(step=STEPS["BDF2"]), LinearlyImplicit(step=_JUMPING))


def stepper_of(scene: ScenePlan) -> SceneStepper | BySystem:
    """The method, with its setting, that steps a scene of cells with membranes or a network."""
    name, step, tolerance = scene.stepper, scene.step, scene.tolerance
    if name == "auto":
        return AUTO
    if name == "RKC":
        share = _TOLERANCE if tolerance is None else tolerance
        often = step if step < _FREE else _DRAWN
        return BySystem(
            RKC(rtol=share, atol=share, largest_step=step),
            RKC(rtol=share, atol=share, largest_step=often),
        )
    kind = BDF2 if name == "BDF2" else LinearlyImplicit
    return kind(step=step) if tolerance is None else kind(step=step, tolerance=tolerance)
