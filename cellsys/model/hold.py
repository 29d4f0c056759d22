"""Between the generator of a step and a continuous affine model (zero-order hold)."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import scipy.linalg as sla

from cellsys.errors import DataError, DimensionError, IntegrationError, ParameterError
from cellsys.units import real_array

Affine = tuple[np.ndarray, np.ndarray, np.ndarray]


def hold(A: np.ndarray, B: np.ndarray, b: np.ndarray, dt: float) -> Affine:
    """(A_d, B_d, b_d) of z+ = A_d z + B_d c + b_d for z' = A z + B c + b with c held over dt s."""
    m, k = A.shape[0], B.shape[1] + 1
    whole = np.zeros((m + k, m + k))
    whole[:m, :m], whole[:m, m:-1], whole[:m, -1] = A, B, b
    step = sla.expm(dt * whole)
    return step[:m, :m], step[:m, m:-1], step[:m, -1]


def to_continuous(A: np.ndarray, B: np.ndarray, b: np.ndarray, dt: float) -> Affine:
    """Continuous (A_c, B_c, b_c) whose zero-order hold over dt is z+ = z + dt (A z + B c + b).

    log [[I + dt A, dt B, dt b], [0, I]] / dt.

    Raises
    ------
    ParameterError
        Where I + dt A has an eigenvalue on the closed negative real axis (no real continuous
        model steps like that), or the logarithm is inaccurate.
    """
    m = A.shape[0]
    step = np.eye(m) + dt * A
    eigenvalues: np.ndarray = sla.eigvals(step)
    bad = (eigenvalues.real <= 0) & (
        np.abs(eigenvalues.imag) <= 1e-12 * np.abs(eigenvalues).max(initial=1.0)
    )
    if bad.any():
        raise ParameterError(
            f"no continuous model: I + dt A has {int(bad.sum())} eigenvalue(s) <= 0, the first "
            f"{eigenvalues[bad][0].real:.3g}; use plant(discrete=True) or a lower order"
        )
    extra = np.column_stack([B, b])
    k = extra.shape[1]
    whole = np.block([[step, dt * extra], [np.zeros((k, m)), np.eye(k)]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # its accuracy is measured below
        log = sla.logm(whole)
    if np.iscomplexobj(log):
        log = log.real
    if np.linalg.norm(sla.expm(log) - whole) > 1e-6 * np.linalg.norm(whole):
        raise ParameterError(
            "the matrix logarithm of this step is inaccurate; use plant(discrete=True)"
        )
    log = log / dt
    return log[:m, :m], log[:m, m : m + k - 1], log[:m, -1]


def check_roll_out(
    order: int,
    n_commands: int,
    own_step: float | None,
    z0: np.ndarray,
    u: np.ndarray | None,
    t: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Start, times, commands (T - 1, n_c) and steps per interval of a roll-out, checked.

    `own_step` is the step of a step model in s, None for a continuous model.
    """
    z0, t = real_array(z0, "z0"), real_array(t, "t")
    if z0.shape != (order,):
        raise DimensionError(f"z0 must have shape ({order},), got {z0.shape}")
    if t.ndim != 1 or not t.size:
        raise DimensionError(f"t must be (T,) with at least one time, got shape {t.shape}")
    if not (np.all(np.isfinite(z0)) and np.all(np.isfinite(t))):
        raise DataError("z0 or t holds NaN or inf")
    steps = np.diff(t)
    if np.any(steps <= 0):
        raise DataError("t must increase")
    c = np.zeros((len(steps), n_commands))
    if u is not None:
        given = real_array(u, "u")
        if given.shape not in ((n_commands,), (len(steps), n_commands)):
            raise DimensionError(
                f"u must be ({len(steps)}, {n_commands}) or ({n_commands},), got {given.shape}"
            )
        c[:] = given
    if not np.all(np.isfinite(c)):
        raise DataError("u holds NaN or inf")
    repeats = np.ones(len(steps), int)
    if own_step is not None:
        with np.errstate(over="ignore"):
            counts = steps / own_step
        if np.any(counts >= 2.0**53):
            raise ParameterError(
                f"t spans {counts.max():.3g} steps of {own_step:g} s in one interval, more than "
                "the 9e15 that can be counted; take nearer times"
            )
        repeats = np.round(counts).astype(int)
        if np.any(np.abs(counts - repeats) > 1e-6) or np.any(repeats < 1):
            raise ParameterError(
                f"t must lie on the model's grid of {own_step:g} s; got intervals from "
                f"{steps.min():g} to {steps.max():g} s"
            )
    return z0, t, c, repeats


_MANY = 1000  # steps between two samples from which on powers of A are cheaper than steps


def _powers(A: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """A^n and I + A + ... + A^(n-1), by squaring [[A, I], [0, I]]."""
    m = len(A)
    whole = np.eye(2 * m)
    whole[:m, :m], whole[:m, m:] = A, np.eye(m)
    power = np.linalg.matrix_power(whole, n)
    return power[:m, :m], power[:m, m:]


# Overflow ends in inf or NaN, which is turned into an error.
@np.errstate(over="ignore", invalid="ignore")
def roll(
    z0: np.ndarray,
    c: np.ndarray,
    t: np.ndarray,
    repeats: np.ndarray,
    matrices: Callable[[float], Affine],
    growth: Callable[[], float],
) -> np.ndarray:
    """Samples (T, m) of z+ = A z + B c_k + b, applied `repeats[k]` times in interval k.

    `matrices(dt)` gives (A, B, b) for an interval of dt seconds; it is asked once per length.

    Raises
    ------
    IntegrationError
        Beyond 1e150 times the start; `growth()` (1/s) is named.
    """
    steps = np.diff(t)
    out = np.empty((len(t), len(z0)))
    out[0] = z0
    limit = 1e150 * max(1.0, float(np.abs(z0).max(initial=0.0)))
    spare, drives, step = np.empty(len(z0)), np.empty((len(steps), len(z0))), {}
    many: dict[float, tuple[np.ndarray, np.ndarray]] = {}
    lengths = np.round(steps, 9)
    for dt in np.unique(lengths):
        rows = np.flatnonzero(lengths == dt)
        step[dt], B, b = matrices(float(steps[rows[0]]))
        drives[rows] = c[rows] @ B.T + b
    for k, repeat in enumerate(repeats):
        A, z = step[lengths[k]], out[k + 1]
        np.dot(A, out[k], out=z)
        z += drives[k]
        if repeat > _MANY:
            if lengths[k] not in many:
                many[lengths[k]] = _powers(A, int(repeat))
            power, total = many[lengths[k]]
            z[:] = power @ out[k] + total @ drives[k]
        else:
            for _ in range(repeat - 1):
                np.dot(A, z, out=spare)
                np.add(spare, drives[k], out=z)
        if k % 64 == 0 or k == len(repeats) - 1:
            largest = float(np.abs(z).max(initial=0.0))
            if not largest < limit:
                raise IntegrationError(
                    f"the latent model diverges: spectral abscissa {growth():.3g} 1/s; "
                    "use a lower order or a shorter horizon",
                    time=float(t[k + 1]),
                    state_norm=largest if np.isfinite(largest) else float("inf"),
                    step=float(steps[k]),
                )
    return out
