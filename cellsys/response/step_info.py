"""What is read off a step response: rise, settling, overshoot, peak, steady state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.optimize as so

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.errors import ParameterError
from cellsys.response.channel import one_channel
from cellsys.response.sampling import exponential
from cellsys.response.timeresponse import step_response
from cellsys.shown import Shown
from cellsys.spectra.gramians import require_stable
from cellsys.spectra.realization import EPS, Realization, balancing, realization
from cellsys.units import real_number

_PERIOD = 24  # points a period of an oscillation
_MOST = 60_000
_PARTS = 300  # points between a time and half of it


@checked
@dataclass(frozen=True, kw_only=True)
class StepFigures(Shown):
    """Figures of a unit step response; times in s from the step on, nan where there is none.

    Attributes
    ----------
    rise_time : float
        Between 10 and 90 % (`rise`) of the steady state, each the first time it is reached.
    settling_time : float
        From when on the output stays within 2 % (`settling`) of the steady state.
    overshoot, undershoot : float
        Percent of the steady state beyond it, and to the other side of 0.
    peak, peak_time : float
        Largest |y| and when; the steady state and inf where it is only approached.
    steady_state : float
        G(0), or G(1) in discrete time.
    """

    rise_time: float
    settling_time: float
    overshoot: float
    undershoot: float
    peak: float
    peak_time: float
    steady_state: float

    def __str__(self) -> str:
        return (
            f"steady state {self.steady_state:.6g}, rise {self.rise_time:.4g} s, settling "
            f"{self.settling_time:.4g} s, overshoot {self.overshoot:.4g} %, undershoot "
            f"{self.undershoot:.4g} %, peak {self.peak:.6g} at {self.peak_time:.4g} s"
        )


@checked
def step_info(
    sys: LinearSystem,
    *,
    input: str | int | None = None,
    output: str | int | None = None,
    settling: float = 0.02,
    rise: tuple[float, float] = (0.1, 0.9),
    delay: float = 0.0,
) -> StepFigures:
    """Rise, settling, overshoot and peak of the step response of one channel.

    Crossings are found on a grid that follows every mode as long as it lives, then by root finding
    on the matrix exponential: no step size enters. In discrete time they are samples.

    Parameters
    ----------
    sys : control.StateSpace, TransferFunction or tuple of arrays
        Stable.
    input, output : str or int, optional
        The channel of a system of several.
    settling : float
        Width of the band around the steady state, as a share of it.
    rise : (float, float)
        Shares between which the rise is timed.
    delay : float
        Dead time before the system, s: added to the settling and peak times.

    Returns
    -------
    StepFigures

    Raises
    ------
    ParameterError
        The system is not stable (an integrator has no steady state), its steady state is 0, or a
        share lies outside (0, 1).
    """
    system = one_channel(realization(sys).dense(), input, output)
    delay = real_number(delay, "delay")
    settling = real_number(settling, "settling")
    low, high = (real_number(r, "rise") for r in rise)
    if not (0 < settling < 1 and 0 < low < high < 1 and delay >= 0):
        raise ParameterError(
            f"settling must lie in (0, 1), rise must rise within (0, 1) and delay be >= 0 s, got "
            f"{settling!r}, {rise!r} and {delay!r}"
        )
    require_stable(system, "the steady state of a step response")
    steady = _steady(system)
    size = float(np.abs(system.C).max(initial=0.0) * np.abs(system.B).max(initial=0.0))
    if abs(steady) <= 100 * EPS * (abs(float(system.D[0, 0])) + size):
        raise ParameterError(
            "the step response returns to 0: it has no rise and no overshoot in percent; read its "
            "peak off step_response"
        )
    t = _grid(system, settling)
    y = step_response(system, t).y[:, 0, 0] / steady
    exact = None if system.is_discrete else _exact(system, steady)
    first = [_first(t, y, share, exact) for share in (low, high)]
    outside = np.flatnonzero(np.abs(y - 1) > settling)
    settled = 0.0
    if outside.size:
        k = int(outside[-1])
        if k + 1 == len(t):
            settled = np.nan
        elif exact is None:
            settled = float(t[k + 1])
        else:
            side = 1 + settling * np.sign(y[k] - 1)
            settled = _root(lambda s: exact(s) - side, float(t[k]), float(t[k + 1]))
    peak, at = _extreme(t, np.abs(y), exact)
    lowest, _ = _extreme(t, -y, exact)
    top, _ = _extreme(t, y, exact)
    return StepFigures(
        rise_time=first[1] - first[0],
        settling_time=settled + delay,
        overshoot=max(100 * (top - 1), 0.0) + 0.0,
        undershoot=max(100 * lowest, 0.0) + 0.0,
        peak=max(peak, 1.0) * abs(steady),
        peak_time=at + delay if peak > 1 else np.inf,
        steady_state=steady,
    )


def _steady(system: Realization) -> float:
    n = system.n_states
    M = np.eye(n) - system.A if system.is_discrete else -system.A
    return (
        float((system.D + system.C @ np.linalg.solve(M, system.B))[0, 0])
        if n
        else float(system.D[0, 0])
    )


def _grid(system: Realization, settling: float) -> np.ndarray:
    """Times that follow each mode until it has fallen far below the band."""
    if not system.n_states:
        return np.array([0.0, system.dt or 1.0])
    poles = np.linalg.eigvals(balancing(system.A)[0]).astype(complex)
    deep = np.log(1e4 / settling)
    if system.is_discrete:
        decay = -np.log(np.clip(np.abs(poles).max(), 1e-12, 1 - 1e-12))
        count = int(min(np.ceil(deep / decay) + 2 * system.n_states + 1, 10 * _MOST))
        return system.dt * np.arange(count + 1)
    decay = np.maximum(-poles.real, 1e-300)
    # Modes that are hard to tell apart fall as t^k exp(-a t): some more lives.
    end = (deep + 3 * system.n_states) / decay.min()
    parts = [np.linspace(0.0, end * 0.5**k, _PARTS) for k in range(40) if end * 0.5**k > 1e-3 / (
        np.abs(poles).max())]  # fmt: skip
    for pole, life in zip(poles, (deep + 3 * system.n_states) / decay, strict=True):
        if pole.imag > 0:
            points = min(int(_PERIOD * life * pole.imag / (2 * np.pi)) + 2, _MOST)
            parts.append(np.linspace(0.0, life, points))
    return np.unique(np.concatenate(parts))


def _exact(system: Realization, steady: float) -> Callable[[float], float]:
    """The response at any one time over its steady state."""

    def y(t: float) -> float:
        x = exponential(system.A, system.B, t)[:, system.n_states :]
        return float((system.C @ x + system.D)[0, 0]) / steady

    return y


def _root(f: Callable[[float], float], a: float, b: float) -> float:
    fa, fb = f(a), f(b)
    if fa == 0 or fa * fb > 0:  # at the end, to the rounding of two ways to the response
        return a if abs(fa) <= abs(fb) else b
    return float(so.brentq(f, a, b, xtol=4 * EPS * b, rtol=8 * EPS))


def _first(
    t: np.ndarray, y: np.ndarray, level: float, exact: Callable[[float], float] | None
) -> float:
    reached = np.flatnonzero(y >= level)
    if not reached.size:
        return float("nan")
    k = int(reached[0])
    if k == 0 or exact is None:
        return float(t[k])
    return _root(lambda s: exact(s) - level, float(t[k - 1]), float(t[k]))


def _extreme(
    t: np.ndarray, y: np.ndarray, exact: Callable[[float], float] | None
) -> tuple[float, float]:
    """Largest value and when, sharpened between the neighbours of the largest on the grid."""
    k = int(np.argmax(y))
    if exact is None or k in (0, len(t) - 1):
        return float(y[k]), float(t[k])
    value = exact(float(t[k]))
    sign = 1.0 if np.isclose(value, y[k], rtol=1e-6, atol=1e-9) else -1.0
    found = so.minimize_scalar(
        lambda s: -sign * exact(float(s)),
        bounds=(t[k - 1], t[k + 1]), method="bounded", options={"xatol": 1e-9 * t[k]},
    )  # fmt: skip
    return max(float(-found.fun), float(y[k])), float(found.x)
