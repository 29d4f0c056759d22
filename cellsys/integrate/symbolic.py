"""CasADi integrators for systems with a symbolic form: CVODES and fixed-step RK4."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from cellsys.errors import IntegrationError, ParameterError
from cellsys.integrate.stepping import check_step
from cellsys.system import Event, OdeSystem


@dataclass(frozen=True, eq=False)
class Solution:
    """Samples x (T, n), interval averages eta and u (T - 1, .), events, statistics."""

    x: np.ndarray
    eta: np.ndarray
    u: np.ndarray
    statistics: dict[str, Any]
    events: list[Event] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class CVODES:
    """Variable-order BDF of SUNDIALS through CasADi.

    Parameters
    ----------
    rtol, atol : float
        Local error per step is kept below rtol |x| + atol; the global error is typically 10 to
        40 times larger. There is no default.
    """

    rtol: float
    atol: float

    def __post_init__(self) -> None:
        for name in ("rtol", "atol"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ParameterError(f"CVODES.{name} must be > 0, got {value!r}")

    def solve(self, system: OdeSystem, t: np.ndarray, x0: np.ndarray) -> Solution:
        """Integrate over the grid `t`; no step crosses a stop point."""
        options = {"reltol": self.rtol, "abstol": self.atol, "max_num_steps": 100_000}
        return _solve(system, t, x0, "cvodes", options, None)


@dataclass(frozen=True, kw_only=True)
class RungeKutta4:
    """Classical Runge-Kutta, order 4, with a fixed step.

    Parameters
    ----------
    step : float
        Largest step, s; each sampling interval is cut into equal steps below it.
    """

    step: float

    def __post_init__(self) -> None:
        check_step("RungeKutta4", self.step)

    def solve(self, system: OdeSystem, t: np.ndarray, x0: np.ndarray) -> Solution:
        """Integrate over the grid `t`; no step crosses a stop point."""
        return _solve(system, t, x0, "rk", {}, self.step)


def _solve(
    system: OdeSystem,
    t: np.ndarray,
    x0: np.ndarray,
    plugin: str,
    options: dict[str, Any],
    step: float | None,
) -> Solution:
    import casadi as ca

    form = system.casadi()
    n, n_eta = system.states.size, system.auxiliaries.size
    began = clock.perf_counter()
    # Time enters as a parameter plus tau in [0, length], so that one integrator serves every
    # interval of the same length.
    start, tau, length = ca.SX.sym("start"), ca.SX.sym("tau"), ca.SX.sym("length")
    now = start + tau * length
    xdot = ca.substitute(form.xdot, form.t, now)
    quad = [ca.substitute(form.eta, form.t, now)] if n_eta else []
    # u is what W_x x + W_eta eta leave of dx/dt.
    rest = xdot - ca.DM(system.W_x.toarray()) @ form.x
    if n_eta:
        rest = rest - ca.DM(system.W_eta.toarray()) @ quad[0]
    problem = {
        "x": form.x,
        "t": tau,
        "p": ca.vertcat(start, length),
        "ode": length * xdot,
        "quad": ca.vertcat(*quad, rest),
    }
    stops = np.unique(np.asarray(system.stop_points(), dtype=float))
    built: dict[int, Any] = {}
    x = np.empty((len(t), n))
    x[0] = x0
    eta, u = np.zeros((max(len(t) - 1, 0), n_eta)), np.zeros((max(len(t) - 1, 0), n))
    steps = 0
    for k in range(len(t) - 1):
        a, b = float(t[k]), float(t[k + 1])
        edges = [a, *stops[(stops > a) & (stops < b)], b]
        state = x[k]
        for c, d in pairwise(edges):
            pieces = 1 if step is None else max(1, int(np.ceil((d - c) / step * (1 - 1e-12))))
            if pieces not in built:
                # CasADi counts finite elements over the whole interval.
                extra = {"number_of_finite_elements": pieces} if step is not None else {}
                built[pieces] = ca.integrator("step", plugin, problem, 0.0, 1.0, options | extra)
            try:
                out = built[pieces](x0=state, p=[c, d - c])
            except RuntimeError as error:
                norm = float(np.linalg.norm(state))
                raise IntegrationError(
                    f"{plugin} failed: {_last_line(error)}", time=c, state_norm=norm, step=d - c
                ) from error
            state = np.asarray(out["xf"], dtype=float).ravel()
            if not np.all(np.isfinite(state)):
                bad = system.states.names[int(np.flatnonzero(~np.isfinite(state))[0])]
                raise IntegrationError(
                    f"{plugin}: state {bad!r} is not finite; use a smaller step or tolerance",
                    time=d,
                    state_norm=float(np.linalg.norm(x[k])),
                    step=d - c if step is None else step,
                )
            q = np.asarray(out["qf"], dtype=float).ravel() * (d - c) / (b - a)
            eta[k] += q[:n_eta]
            u[k] += q[n_eta:]
            steps += pieces
        x[k + 1] = state
    statistics = {"steps": steps, "solve_time": clock.perf_counter() - began}
    return Solution(x, eta, u, statistics)


def _last_line(error: RuntimeError) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1][:200] if lines else "no reason given"
