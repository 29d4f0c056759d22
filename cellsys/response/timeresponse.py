"""Step, impulse and forced responses by matrix exponentials: no step-size error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.drawable import Drawable
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.response.realization import EPS, Realization, balancing, realization
from cellsys.response.sampling import exponential


@checked
@dataclass(frozen=True, eq=False)
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


def _times(system: Realization, t: Any) -> np.ndarray:
    if t is None:
        return _automatic(system)
    array = np.asarray(t, dtype=float)
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


def _automatic(system: Realization) -> np.ndarray:
    """To seven time constants of the slowest mode that is not an integrator; 501 points."""
    if not system.n_states:
        return np.arange(11) * (system.dt or 0.1)
    A = balancing(system.A)[0]
    values = sla.eigvals(A)
    if system.is_discrete:
        values = np.log(np.where(np.abs(values) < 1e-12, 1e-12, values)) / system.dt
    floor = 1e-8 * max(float(np.abs(values).max()), 1e-300)
    rates = np.abs(values.real)
    rates = rates[rates > floor]
    turns = np.abs(values.imag)
    end = 7.0 / rates.min() if rates.size else 10.0 / max(float(turns.max()), 0.1)
    if system.is_discrete:
        return np.arange(int(np.clip(np.ceil(end / system.dt), 10, 5000)) + 1) * system.dt
    return np.linspace(0.0, end, 501)


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


def _finite(x: np.ndarray, t: np.ndarray) -> np.ndarray:
    bad = ~np.isfinite(x.reshape(len(x), -1)).all(axis=1)
    if np.any(bad):
        raise DataError(
            f"the response overflows at t = {t[np.argmax(bad)]:.6g} s: an unstable mode; shorten t"
        )
    return x


@checked
def step_response(sys: LinearSystem, t: np.ndarray | None = None) -> TimeResponse:
    """Response to a unit step of each input, from rest.

        x(t) = int_0^t exp(A s) ds B,   y = C x + D

    Parameters
    ----------
    sys : control.StateSpace or tuple of arrays
    t : array (k,), optional
        Rising, s; on sampling instants of a discrete system. Default: seven time constants.

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
    BudgetError
        As for `poles`.

    References
    ----------
    Van Loan, IEEE Trans. Automatic Control 23 (1978) 395.
    """
    system = realization(sys).dense()
    t = _times(system, t)
    n, m = system.n_states, system.n_inputs
    grid, lead = _from_zero(t)
    if system.is_discrete:
        count = round(grid[-1] / system.dt) + 1
        x = _steps(system, grid, np.zeros((n, m)), np.broadcast_to(np.eye(m), (count, m, m)))
    else:
        x = _march(system, grid, np.zeros((n, m)), np.broadcast_to(np.eye(m), (len(grid), m, m)),
                   False)
    x = _finite(x[lead:], t)
    return TimeResponse(t, system.C @ x + system.D, x, "step", system.inputs, system.outputs,
                        system.dt)


@checked
def impulse_response(sys: LinearSystem, t: np.ndarray | None = None) -> TimeResponse:
    """Response to a unit impulse of each input, from rest.

        y(t) = C exp(A t) B      (the impulse D delta(t) itself is left out in continuous time);
        y_0 = D, y_k = C A^(k-1) B in discrete time (a unit sample)

    Parameters
    ----------
    sys : control.StateSpace or tuple of arrays
    t : array (k,), optional
        Rising, s; on sampling instants of a discrete system. Default: seven time constants.

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
    BudgetError
        As for `poles`.

    References
    ----------
    Van Loan, IEEE Trans. Automatic Control 23 (1978) 395.
    """
    system = realization(sys).dense()
    t = _times(system, t)
    n, m = system.n_states, system.n_inputs
    grid, lead = _from_zero(t)
    if system.is_discrete:
        drive = np.zeros((round(grid[-1] / system.dt) + 1, m, m))
        drive[0] = np.eye(m)
        x = _finite(_steps(system, grid, np.zeros((n, m)), drive)[lead:], t)
        y = system.C @ x + system.D @ drive[np.rint(t / system.dt).astype(int)]
    else:
        x = _finite(_march(system, grid, np.array(system.B), None, False)[lead:], t)
        y = system.C @ x
    return TimeResponse(t, y, x, "impulse", system.inputs, system.outputs, system.dt)


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
    BudgetError
        As for `poles`.

    References
    ----------
    Van Loan, IEEE Trans. Automatic Control 23 (1978) 395.
    """
    system = realization(sys).dense()
    t = _times(system, t)
    n, m = system.n_states, system.n_inputs
    drive = np.zeros((len(t), m)) if u is None else np.asarray(u, dtype=float)
    drive = drive[:, None] if drive.ndim == 1 and m == 1 else drive
    x = np.zeros(n) if x0 is None else np.asarray(x0, dtype=float)
    if drive.shape != (len(t), m):
        raise DimensionError(f"u must have shape ({len(t)}, {m}), got {drive.shape}")
    if x.shape != (n,):
        raise DimensionError(f"x0 must have shape ({n},), got {x.shape}")
    for name, array in (("u", drive), ("x0", x)):
        if not np.all(np.isfinite(array)):
            raise DataError(f"{name} holds NaN or inf")
    if system.is_discrete:
        if len(t) > 1 and np.any(np.abs(np.diff(t) / system.dt - 1) > 1e-6):
            raise ParameterError("a discrete forced response needs one sample per step")
        states = _steps(system, t - t[0], x, drive)
    else:
        states = _march(system, t, x, drive if m else None, linear)
    states = _finite(states, t)
    y = states @ system.C.T + drive @ system.D.T
    return TimeResponse(t, y, states, "forced", system.inputs, system.outputs, system.dt)


def _from_zero(t: np.ndarray) -> tuple[np.ndarray, int]:
    """t with 0 put in front if it is missing, and how many entries that added."""
    return (t, 0) if t[0] <= EPS else (np.concatenate([[0.0], t]), 1)
