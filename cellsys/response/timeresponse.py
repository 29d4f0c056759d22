"""Step, impulse and forced responses by matrix exponentials: no step-size error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.drawable import Drawable
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.response.sampling import exponential
from cellsys.response.timeaxis import automatic_times
from cellsys.spectra.realization import EPS, Realization, realization
from cellsys.units import real_array


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class TimeResponse(Drawable):
    """Outputs over time.

    Attributes
    ----------
    t : array (k,)
        s.
    y : array (k, p) for a forced response, (k, p, m) for step and impulse responses
        In the latter, the response to each input on its own.
    x : array (k, n) or (k, n, m)
        States.
    kind : str
        ``"step"``, ``"impulse"`` or ``"forced"``.
    inputs, outputs : tuple of str
    dt : float
        0, or the sampling time, s.
    """

    _figure: ClassVar[str] = "time_response"
    t: np.ndarray
    y: np.ndarray
    x: np.ndarray
    kind: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float

    def __str__(self) -> str:
        end = f", 0 .. {self.t[-1]:.4g} s" if len(self.t) else ""
        return f"{self.kind} response, {len(self.outputs)} outputs, {len(self.t)} times{end}"


def _times(system: Realization, t: np.ndarray | None) -> np.ndarray:
    if t is None:
        return automatic_times(system)
    array = real_array(t, "t")
    if array.ndim != 1 or not len(array):
        raise DimensionError(f"t must be one-dimensional and not empty, got shape {array.shape}")
    if not np.all(np.isfinite(array)):
        raise DataError("t holds NaN or inf")
    if array[0] < 0 or np.any(np.diff(array) <= 0):
        raise ParameterError("t must rise from a first time >= 0 s")
    if system.is_discrete:
        steps = array / system.dt
        if np.any(np.abs(steps - np.rint(steps)) > 1e-6):
            raise ParameterError(f"t must lie on multiples of the sampling time {system.dt:g} s")
    return array


def _march(
    system: Realization, t: np.ndarray, x: np.ndarray, drive: np.ndarray | None, linear: bool
) -> np.ndarray:
    """States (k, ...) at t from x at t[0], with input samples drive (k, m, ...) at t."""
    out = np.empty((len(t), *x.shape))
    out[0] = x
    n, m = system.n_states, system.n_inputs
    B = system.B
    if linear and drive is not None:  # input = u_k + slope s: one more integrator per input
        A = np.block([[system.A, B], [np.zeros((m, n + m))]])
        B = np.vstack([np.zeros((n, m)), np.eye(m)])
    else:
        A = system.A
    known: dict[float, np.ndarray] = {}
    for k in range(len(t) - 1):
        h = t[k + 1] - t[k]
        key = float(f"{h:.12e}")
        if key not in known:
            if len(known) > 64:
                known.clear()
            known[key] = exponential(A, B if drive is not None else B[:, :0], h)
        F = known[key]
        if drive is None:
            x = F @ x
        elif linear:
            full = F @ np.concatenate([x, drive[k], (drive[k + 1] - drive[k]) / h])
            x = full[:n]
        else:
            x = F @ np.concatenate([x, drive[k]])
        out[k + 1] = x
    return out


def _steps(system: Realization, t: np.ndarray, x: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """Discrete states at the sampling instants t; `drive` (steps, m, ...) holds every step."""
    at = np.rint(t / system.dt).astype(int)
    out = np.empty((len(t), *x.shape))
    row = 0
    for k in range(at[-1] + 1):
        if k == at[row]:
            out[row] = x
            row += 1
        if k < at[-1]:
            x = system.A @ x + system.B @ drive[k]
    return out


def _free(
    transition: Callable[[float], np.ndarray], steps: np.ndarray, x: np.ndarray
) -> np.ndarray:
    """x, and what it becomes after each of the steps (k,): by powers of the matrix of each run of
    equal steps, which doubles what is known, up to 512 steps at a time.
    """
    out = np.empty((len(steps) + 1, *x.shape))
    out[0] = x
    digits = np.array([float(f"{h:.12e}") for h in steps]) if len(steps) < 5000 else steps
    ends = np.append(np.flatnonzero(np.diff(digits) != 0) + 1, len(steps))
    known: dict[float, np.ndarray] = {}
    i = 0
    for j in ends if len(steps) else ():
        key = float(f"{steps[i]:.12e}")
        if key not in known:
            if len(known) > 64:
                known.clear()
            known[key] = transition(float(steps[i]))
        power, width, reach = known[key], 1, 1
        while i + width <= j:  # out[i : i + width] is known, power takes `reach` steps
            take = min(reach, int(j) + 1 - i - width)
            from_ = i + width - reach
            out[i + width : i + width + take] = power @ out[from_ : from_ + take]
            width += take
            if reach < 512 and width == 2 * reach and i + width <= j:
                power, reach = power @ power, width
        i = int(j)
    return out


def _checked(t: np.ndarray, *arrays: np.ndarray) -> None:
    """DataError with the first time at which something is not finite."""
    bad = np.zeros(len(t), bool)
    for array in arrays:
        bad |= ~np.isfinite(array.reshape(len(array), -1)).all(axis=1)
    if np.any(bad):
        raise DataError(
            f"the response overflows at t = {t[np.argmax(bad)]:.6g} s: an unstable mode; shorten t"
        )


@checked
def step_response(sys: LinearSystem, t: np.ndarray | None = None) -> TimeResponse:
    """Response to a unit step of each input, from rest.

        x(t) = int_0^t exp(A s) ds B,   y = C x + D

    Parameters
    ----------
    sys : control.StateSpace or tuple of arrays
    t : array (k,), optional
        Rising, s; on sampling instants of a discrete system. Default: `automatic_times`.

    Returns
    -------
    TimeResponse
        ``.y`` (k, p, m).

    Raises
    ------
    ParameterError, DimensionError
        t does not rise from >= 0 or misses the sampling instants.
    DataError
        NaN or inf in, or the response overflows.
    MemoryBudgetError
        As for `poles`.

    References
    ----------
    Van Loan, IEEE Trans. Automatic Control 23 (1978) 395.
    """
    system = realization(sys).dense()
    t = _times(system, t)
    n, m = system.n_states, system.n_inputs
    grid, lead = _from_zero(t)
    with np.errstate(over="ignore", invalid="ignore"):
        held = np.eye(n + m)  # the inputs are states that stay

        def transition(h: float) -> np.ndarray:
            if system.is_discrete:
                held[:n, :n], held[:n, n:] = system.A, system.B
                return np.linalg.matrix_power(held, round(h / system.dt))
            held[:n] = exponential(system.A, system.B, h)
            return held.copy()

        start = np.vstack([np.zeros((n, m)), np.eye(m)])
        x = _free(transition, np.diff(grid), start)[lead:, :n]
        y = system.C @ x + system.D
    _checked(t, x, y)
    return TimeResponse(
        t=t, y=y, x=x, kind="step", inputs=system.inputs, outputs=system.outputs, dt=system.dt
    )


@checked
def impulse_response(sys: LinearSystem, t: np.ndarray | None = None) -> TimeResponse:
    """Response to a unit impulse of each input, from rest.

        y(t) = C exp(A t) B      (the impulse D delta(t) itself is left out in continuous time);
        y_0 = D, y_k = C A^(k-1) B in discrete time (a unit sample)

    Parameters
    ----------
    sys : control.StateSpace or tuple of arrays
    t : array (k,), optional
        Rising, s; on sampling instants of a discrete system. Default: `automatic_times`.

    Returns
    -------
    TimeResponse
        ``.y`` (k, p, m).

    Raises
    ------
    ParameterError, DimensionError
        t does not rise from >= 0 or misses the sampling instants.
    DataError
        NaN or inf in, or the response overflows.
    MemoryBudgetError
        As for `poles`.

    References
    ----------
    Van Loan, IEEE Trans. Automatic Control 23 (1978) 395.
    """
    system = realization(sys).dense()
    t = _times(system, t)
    grid, lead = _from_zero(t)
    with np.errstate(over="ignore", invalid="ignore"):
        if system.is_discrete:
            at = np.rint(t / system.dt).astype(int)
            strides = np.diff(np.concatenate([[1], at[at > 0]])).astype(float)
            x = np.zeros((len(at), *system.B.shape))
            x[at > 0] = _free(
                lambda k: np.linalg.matrix_power(system.A, int(k)), strides, np.array(system.B)
            )[1:]
            y = system.C @ x + np.where(at > 0, 0.0, 1.0)[:, None, None] * system.D
        else:

            def transition(h: float) -> np.ndarray:
                return exponential(system.A, system.B[:, :0], h)

            x = _free(transition, np.diff(grid), np.array(system.B))[lead:]
            y = system.C @ x
    _checked(t, x, y)
    return TimeResponse(
        t=t, y=y, x=x, kind="impulse", inputs=system.inputs, outputs=system.outputs, dt=system.dt
    )


@checked
def forced_response(
    sys: LinearSystem,
    t: np.ndarray,
    u: np.ndarray | None = None,
    *,
    x0: np.ndarray | None = None,
    linear: bool = True,
) -> TimeResponse:
    """Response to inputs given by their samples, from an initial state.

    Parameters
    ----------
    sys : control.StateSpace or tuple of arrays
    t : array (k,)
        Rising, s; the initial state holds at t[0]. On sampling instants of a discrete system,
        one sample for every step.
    u : array (k, m) or (k,), optional
        Input samples; zero when left out.
    x0 : array (n,), optional
        Initial state; zero when left out.
    linear : bool
        Inputs run straight between samples (exact for those), else they are held constant.

    Returns
    -------
    TimeResponse
        ``.y`` (k, p).

    Raises
    ------
    ParameterError, DimensionError
        t does not rise, or shapes do not fit.
    DataError
        NaN or inf in, or the response overflows.
    MemoryBudgetError
        As for `poles`.

    References
    ----------
    Van Loan, IEEE Trans. Automatic Control 23 (1978) 395.
    """
    system = realization(sys).dense()
    t = _times(system, t)
    n, m = system.n_states, system.n_inputs
    drive = np.zeros((len(t), m)) if u is None else real_array(u, "u")
    drive = drive[:, None] if drive.ndim == 1 and m == 1 else drive
    x = np.zeros(n) if x0 is None else real_array(x0, "x0")
    if drive.shape != (len(t), m):
        raise DimensionError(f"u must have shape ({len(t)}, {m}), got {drive.shape}")
    if x.shape != (n,):
        raise DimensionError(f"x0 must have shape ({n},), got {x.shape}")
    for name, array in (("u", drive), ("x0", x)):
        if not np.all(np.isfinite(array)):
            raise DataError(f"{name} holds NaN or inf")
    with np.errstate(over="ignore", invalid="ignore"):
        if system.is_discrete:
            if len(t) > 1 and np.any(np.abs(np.diff(t) / system.dt - 1) > 1e-6):
                raise ParameterError("a discrete forced response needs one sample per step")
            states = _steps(system, t - t[0], x, drive)
        else:
            states = _march(system, t, x, drive if m else None, linear)
        y = states @ system.C.T + drive @ system.D.T
    _checked(t, states, y)
    return TimeResponse(
        t=t,
        y=y,
        x=states,
        kind="forced",
        inputs=system.inputs,
        outputs=system.outputs,
        dt=system.dt,
    )


def _from_zero(t: np.ndarray) -> tuple[np.ndarray, int]:
    """t with 0 put in front if it is missing, and how many entries that added."""
    return (t, 0) if t[0] <= EPS else (np.concatenate([[0.0], t]), 1)
