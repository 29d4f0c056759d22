"""The integrator's part of the error of a run, estimated from the run itself.

A method with a tolerance controls the error of one step; what is left at the end of a run is the
sum of what the steps did, carried along by the flow, and can be a hundred times the tolerance.
Ways to find it, in order of preference: the method's own second solution, the same run at a
tenth of the tolerance (or half the step), and for steppers what their samples and log tell: of a
first-order one the leading term of its error, of a second-order one what the laws left over.
"""

from __future__ import annotations

import dataclasses
import time as clock
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from cellsys.contracts import Integrator
from cellsys.errors import IntegrationError, ParameterError
from cellsys.integrate.capabilities import (
    BoundsStages,
    EstimatesError,
    FixedSteps,
    Ordered,
    Tolerances,
)
from cellsys.trajectory import ErrorEstimate

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_Refined = TypeVar("_Refined", bound="DataclassInstance")
SAFETY = 1.5  # the second solution is not exact either
# Error of a step of implicit Euler over its distance to two half ones: 2 for slow modes, at most
# this, max over a of (r_1 - e^-a)/(r_1 - r_2) with r_n = (1 + a/n)^-n.
EULER = 2.41
TIGHTEST = 1e-13  # relative tolerance below which rounding rules


def estimate_of(
    integrator: Integrator,
    x: np.ndarray,
    again: Callable[[Integrator], np.ndarray],
    own: Callable[[], np.ndarray] | None,
) -> Callable[[], ErrorEstimate]:
    """A function that estimates the error of the samples x (T, n), run when it is called.

    Parameters
    ----------
    again : callable
        ``again(integrator)`` -> (T, n): the same run by another integrator.
    own : callable or None
        The method's own estimate, () -> (n,).
    """

    def find() -> ErrorEstimate:
        began = clock.perf_counter()
        scale = np.abs(x).max(axis=0)
        if own is not None:
            method = integrator.estimates if isinstance(integrator, EstimatesError) else "its own"
            absolute: np.ndarray | None = own()
        else:
            method, absolute = _twice(integrator, x, again)
        if absolute is not None:
            # Rounding of the samples themselves is always there.
            absolute = SAFETY * absolute + 4 * np.finfo(float).eps * scale
        return ErrorEstimate(absolute, scale, method, clock.perf_counter() - began)

    return find


def estimate_by(
    x: np.ndarray, better: Callable[[], np.ndarray], method: str, share: float = 1.0
) -> Callable[[], ErrorEstimate]:
    """A function that estimates the error of x (T, n) by a better solution, made when called.

    `share`: the error of x over its distance to the better solution.
    """

    def find() -> ErrorEstimate:
        began = clock.perf_counter()
        scale = np.abs(x).max(axis=0)
        absolute = SAFETY * share * np.abs(x - better()).max(axis=0)
        absolute += 4 * np.finfo(float).eps * scale
        return ErrorEstimate(absolute, scale, method, clock.perf_counter() - began)

    return find


def finer(integrator: _Refined) -> _Refined | None:
    """The method at a tenth of its tolerances or half its step; None where that is rounding."""
    if isinstance(integrator, Tolerances):
        rtol, atol = integrator.rtol, integrator.atol
        if rtol is not None and atol is not None:
            if rtol <= TIGHTEST:
                return None
            second = replace(integrator, rtol=max(0.1 * rtol, 0.5 * TIGHTEST), atol=0.1 * atol)
            if isinstance(second, BoundsStages):
                # Where stages or the step are at their bound, the tolerance alone changes nothing.
                stages = max(3, int(0.6 * second.largest_stages))
                step = 0.4 * second.largest_step
                second = replace(second, largest_stages=stages, largest_step=step)
            return second
    if isinstance(integrator, FixedSteps) and integrator.step is not None:
        return replace(integrator, step=0.5 * integrator.step)
    raise ParameterError(f"{_no_accuracy(integrator)}; give it one")


def _no_accuracy(integrator: object) -> str:
    return f"{type(integrator).__name__} carries no tolerance or step to be refined"


def _twice(
    integrator: Integrator, x: np.ndarray, again: Callable[[Integrator], np.ndarray]
) -> tuple[str, np.ndarray | None]:
    if not (
        dataclasses.is_dataclass(integrator)
        and not isinstance(integrator, type)
        and {"rtol", "step"} & {field.name for field in dataclasses.fields(integrator)}
    ):
        return _no_accuracy(integrator), None
    second = finer(integrator)
    if second is None:
        return "the tolerance is at rounding", None
    halved = not (isinstance(second, Tolerances) and second.rtol is not None)
    kind = "half the step" if halved else "a tenth of the tolerance"
    try:
        better = again(second)
    except IntegrationError as error:
        return f"the run at {kind} fails: {error}", None
    # Half the step of an order-q method leaves 2^-q of the error in the second solution too.
    share = 1.0
    if halved and isinstance(second, Ordered):
        share = 1.0 / (1.0 - 0.5**second.order)
    return f"solved again at {kind}", share * np.abs(x - better).max(axis=0)


def first_order(t: np.ndarray, x: np.ndarray, step: float) -> ErrorEstimate:
    """Leading error of Euler's methods, (step/2) |x'(t) - x'(0)|, largest over the samples.

    It is what the local errors (step^2/2) x'' add up to when none is damped: for a system that
    contracts it errs on the large side.
    """
    began = clock.perf_counter()
    x = np.asarray(x)
    scale = np.abs(x).max(axis=0)
    if len(t) < 3:
        return ErrorEstimate(None, scale, "fewer than three samples")
    rate = np.diff(x, axis=0) / np.diff(t)[:, None]
    absolute = 0.5 * step * np.abs(rate[1:] - rate[0]).max(axis=0)
    return ErrorEstimate(absolute, scale, "leading first-order term", clock.perf_counter() - began)


def left_over(t: np.ndarray, x: np.ndarray, residual: np.ndarray) -> ErrorEstimate:
    """Largest sum over time of the logged step residual (T - 1, n), |sum of r_k (t_k+1 - t_k)|.

    The residual is what the rate of the samples is off the laws, so this is the error that it
    leads to when none is damped: for a system that contracts it errs on the large side.
    """
    began = clock.perf_counter()
    scale, total = np.abs(x).max(axis=0), np.zeros(x.shape[1])
    most = np.zeros_like(total)
    for row, dt in zip(residual, np.diff(t).tolist(), strict=True):
        total += dt * row
        np.maximum(most, np.abs(total), out=most)
    return ErrorEstimate(most, scale, "sum of the step residual", clock.perf_counter() - began)
