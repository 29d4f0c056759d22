"""CasADi integrators for systems with a symbolic form: CVODES, IDAS, collocation, RK4.

One integrator object serves all samples of a smooth piece, so that a multistep method keeps its
order and step from sample to sample; a new piece begins at every stop point.
"""

from __future__ import annotations

import time as clock
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import Integrator
from cellsys.errors import IntegrationError, ParameterError
from cellsys.integrate.capabilities import FixedSteps, HasParameters, SymbolicMethod
from cellsys.integrate.solution import Solution
from cellsys.integrate.stepping import check_step, steps_of
from cellsys.system import OdeSystem
from cellsys.units import real_number

if TYPE_CHECKING:
    from casadi import Function

_LEAST = 1e-15  # relative error of a step; below it SUNDIALS calls tolerances too small


@checked
@dataclass(frozen=True, kw_only=True)
class CVODES:
    """Variable-order BDF of SUNDIALS through CasADi.

    Parameters
    ----------
    rtol, atol : float
        What the global error is meant to stay near: rtol |x| + atol. The errors of BDF steps add
        up to hundreds of what one step may leave, so each is held to a hundredth of this
        (`local`), as few as half the steps more; `Trajectory.error` shows what came of it.
        There is no default.
    max_steps : int
        Most steps between two samples.
    """

    rtol: float
    atol: float
    max_steps: int = 100_000

    plugin: ClassVar[str] = "cvodes"
    local: ClassVar[float] = 0.01  # share of the tolerances that one step may leave

    def __post_init__(self) -> None:
        _check_tolerances(self)

    def solve(
        self, system: OdeSystem, t: np.ndarray, x0: np.ndarray, *, averages: bool = True
    ) -> Solution:
        """Integrate over the grid `t`; no step crosses a stop point."""
        return solve_symbolic(self, system, t, x0, averages)

    def options(self, span: float) -> dict[str, float]:
        """CasADi's options for a piece of `span` seconds."""
        return _controls(self)


@checked
@dataclass(frozen=True, kw_only=True)
class IDAS:
    """Variable-order BDF of SUNDIALS for implicit systems, through CasADi.

    Parameters are those of `CVODES`. Where it cannot start or go on it fails with an
    `IntegrationError` that gives CasADi's reason.
    """

    rtol: float
    atol: float
    max_steps: int = 100_000

    plugin: ClassVar[str] = "idas"
    local: ClassVar[float] = 0.01

    def __post_init__(self) -> None:
        _check_tolerances(self)

    def solve(
        self, system: OdeSystem, t: np.ndarray, x0: np.ndarray, *, averages: bool = True
    ) -> Solution:
        """Integrate over the grid `t`; no step crosses a stop point."""
        return solve_symbolic(self, system, t, x0, averages)

    def options(self, span: float) -> dict[str, float]:
        """CasADi's options for a piece of `span` seconds."""
        return _controls(self)


@checked
@dataclass(frozen=True, kw_only=True)
class Collocation:
    """Radau collocation with a fixed step, implicit and L-stable, of order 2 s - 1.

    Parameters
    ----------
    step : float
        Largest step, s.
    stages : int
        Collocation points s of a step, 1 to 9.
    """

    step: float
    stages: int = 3

    plugin: ClassVar[str] = "collocation"

    def __post_init__(self) -> None:
        check_step("Collocation", self.step)
        if not 1 <= self.stages <= 9:
            raise ParameterError(f"Collocation.stages must be 1 to 9, got {self.stages!r}")

    @property
    def order(self) -> int:
        """2 s - 1."""
        return 2 * self.stages - 1

    def solve(
        self, system: OdeSystem, t: np.ndarray, x0: np.ndarray, *, averages: bool = True
    ) -> Solution:
        """Integrate over the grid `t`; no step crosses a stop point."""
        return solve_symbolic(self, system, t, x0, averages)

    def options(self, span: float) -> dict[str, float | str | dict[str, float]]:
        """CasADi's options for a piece of `span` seconds."""
        return {
            "number_of_finite_elements": _pieces(span, self.step),
            "interpolation_order": self.stages,
            "collocation_scheme": "radau",
            "rootfinder_options": {"abstol": 1e-13},
        }


@checked
@dataclass(frozen=True, kw_only=True)
class RungeKutta4:
    """Classical Runge-Kutta, order 4, with a fixed step.

    Parameters
    ----------
    step : float
        Largest step, s; each sampling interval is cut into equal steps below it.
    """

    step: float

    plugin: ClassVar[str] = "rk"
    order: ClassVar[int] = 4

    def __post_init__(self) -> None:
        check_step("RungeKutta4", self.step)

    def solve(
        self, system: OdeSystem, t: np.ndarray, x0: np.ndarray, *, averages: bool = True
    ) -> Solution:
        """Integrate over the grid `t`; no step crosses a stop point."""
        return solve_symbolic(self, system, t, x0, averages)

    def options(self, span: float) -> dict[str, float]:
        """CasADi's options for a piece of `span` seconds."""
        return {"number_of_finite_elements": _pieces(span, self.step)}


def _controls(method: CVODES | IDAS) -> dict[str, float]:
    rtol = max(method.local * method.rtol, _LEAST)
    return {"reltol": rtol, "abstol": method.local * method.atol, "max_num_steps": method.max_steps}


def _check_tolerances(method: CVODES | IDAS) -> None:
    for name in ("rtol", "atol", "max_steps"):
        value = getattr(method, name)
        if not real_number(value, f"{type(method).__name__}.{name}") > 0:
            raise ParameterError(f"{type(method).__name__}.{name} must be > 0, got {value!r}")
    if method.rtol < 10 * _LEAST:
        raise ParameterError(
            f"{type(method).__name__}.rtol must be >= {10 * _LEAST:g}, fifty roundings, got "
            f"{method.rtol!r}"
        )


def _pieces(span: float, step: float) -> int:
    return steps_of(span, step)


def solve_symbolic(
    method: SymbolicMethod, system: OdeSystem, t: np.ndarray, x0: np.ndarray, averages: bool
) -> Solution:
    """Samples of `system` at `t` by one of the methods above.

    Raises
    ------
    IntegrationError
        CasADi's integrator fails, or a state is not finite.
    NotSymbolicError
        The system has no symbolic form.
    """
    T, n, n_eta = len(t), system.states.size, system.auxiliaries.size
    began = clock.perf_counter()
    x = np.empty((T, n))
    x[0] = state = x0
    running = np.zeros((T, n_eta + n))
    counts: dict[str, int | None] = dict.fromkeys(
        ("steps", "rejected", "rhs", "jacobians", "factorisations"), 0
    )
    built = 0.0
    for edges, inside in pieces(t, np.asarray(system.stop_points(), dtype=float)):
        state = x[inside[0]] if edges[0] == t[inside[0]] else state
        start = clock.perf_counter()
        F = integrator_of(method, system, edges, averages)
        built += clock.perf_counter() - start
        found, sums = _call(method, system, F, edges, state)
        state = found[-1]
        if averages:
            # A piece may begin or end between samples: sums of both parts add up.
            running[inside[0] + 1 :] += sums[-1]
            at = np.searchsorted(edges, t[inside[1] : inside[2]])
            running[inside[1] : inside[2]] += sums[at - 1] - sums[-1]
        rows = np.flatnonzero(np.isin(edges, t[inside[1] : inside[2]]))
        rows = rows[rows > 0]
        x[inside[1] : inside[2]] = found[rows - 1]
        for name, more in _counts(F, method, edges).items():
            so_far = counts[name]
            counts[name] = None if more is None or so_far is None else so_far + more
    eta = u = None
    if averages:
        mean = np.diff(running, axis=0) / np.diff(t)[:, None]
        eta, u = mean[:, :n_eta], mean[:, n_eta:]
    took = clock.perf_counter() - began
    statistics = {**counts, "construction_time": built, "solve_time": took - built}
    return Solution(x=x, eta=eta, u=u, statistics=statistics)


def pieces(t: np.ndarray, stops: np.ndarray) -> list[tuple[np.ndarray, tuple[int, int, int]]]:
    """Smooth pieces of the grid: (times from edge to edge, (sample at or before, first, end)).

    Samples first..end-1 lie in (start, end] of the piece.
    """
    if len(t) < 2:
        return []
    inner = np.unique(stops[(stops > t[0]) & (stops < t[-1])])
    edges = np.concatenate([[t[0]], inner, [t[-1]]])
    out = []
    for a, b in pairwise(edges):
        first, end = np.searchsorted(t, a, side="right"), np.searchsorted(t, b, side="right")
        times = np.unique(np.concatenate([[a], t[first:end], [b]]))
        out.append((times, (int(first) - 1, int(first), int(end))))
    return out


def integrator_of(
    method: Integrator | SymbolicMethod, system: OdeSystem, times: np.ndarray, averages: bool
) -> Function:
    """CasADi integrator from times[0] to the other times; kept with the system.

    Outputs: ``xf`` (n, T - 1) and, with `averages`, the running integrals ``qf`` of eta and u.
    """
    import casadi as ca

    if not isinstance(method, SymbolicMethod):
        raise ParameterError(
            f"{type(method).__name__} has no derivatives; use CVODES, IDAS, Collocation or "
            "RungeKutta4"
        )
    kept = system.__dict__.setdefault("_integrators", {})
    key = (repr(method), averages, times.tobytes())
    if key not in kept:
        form = system.casadi()
        # A stage at the end of a piece takes the limit from the left.
        last = ca.fmin(form.t, float(np.nextafter(times[-1], times[0])))
        xdot, law = ca.substitute([form.xdot, form.eta], [form.t], [last])
        problem = {"x": form.x, "t": form.t, "ode": xdot}
        if form.p is not None:
            problem["p"] = form.p
        if averages:
            n_eta = system.auxiliaries.size
            rest = xdot - ca.DM(system.W_x.toarray()) @ form.x
            if n_eta:
                rest = rest - ca.DM(system.W_eta.toarray()) @ law
            problem["quad"] = ca.vertcat(*([law] if n_eta else []), rest)
        options = {**method.options(float(times[-1] - times[0])), "show_eval_warnings": False}
        if len(kept) >= 8:
            kept.pop(next(iter(kept)))
        kept[key] = ca.integrator(
            "piece", method.plugin, problem, float(times[0]), times[1:].tolist(), options
        )
    return kept[key]


def _call(
    method: SymbolicMethod, system: OdeSystem, F: Function, times: np.ndarray, state: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    values = {}
    if isinstance(system, HasParameters) and F.size1_in("p"):
        values["p"] = system.parameter_values
    name, norm = type(method).__name__, float(np.linalg.norm(state))
    span = float(times[-1] - times[0])
    try:
        out = F(x0=state, **values)
    except RuntimeError as error:
        raise IntegrationError(
            f"{name} failed: {_last_line(error)}", time=times[0], state_norm=norm, step=span
        ) from error
    x = np.asarray(out["xf"], dtype=float).T
    if not np.all(np.isfinite(x)):
        row = int(np.flatnonzero(~np.isfinite(x).all(axis=1))[0])
        bad = system.states.names[int(np.flatnonzero(~np.isfinite(x[row]))[0])]
        raise IntegrationError(
            f"{name}: state {bad!r} is not finite; use a smaller step or tolerance",
            time=float(times[row + 1]),
            state_norm=float(np.linalg.norm(x[row - 1])) if row else norm,
            step=getattr(method, "step", span),
        )
    return x, np.asarray(out["qf"], dtype=float).T


def _counts(F: Function, method: SymbolicMethod, times: np.ndarray) -> dict[str, int | None]:
    found = F.stats()
    if "nsteps" in found:
        # Every linear set-up evaluates the Jacobian and factorises it.
        names = {
            "steps": "nsteps",
            "rejected": "netfails",
            "rhs": "nfevals",
            "jacobians": "nlinsetups",
            "factorisations": "nlinsetups",
        }
        return {name: int(found.get(theirs, 0)) for name, theirs in names.items()}
    if not isinstance(method, FixedSteps) or method.step is None:
        return dict.fromkeys(("steps", "rejected", "rhs", "jacobians", "factorisations"))
    span = float(times[-1] - times[0])
    h = span / _pieces(span, method.step)
    steps = int(np.ceil(np.diff(times) / h * (1 - 1e-12)).sum())
    if method.plugin == "rk":
        return {"steps": steps, "rhs": 4 * steps}
    # How often Newton's method of a collocation step calls them CasADi does not tell.
    return {"steps": steps, "rhs": None, "jacobians": None, "factorisations": None}


def _last_line(error: RuntimeError) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1][:200] if lines else "no reason given"
