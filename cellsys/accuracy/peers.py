"""Other programs on the same problem, called directly so that nothing of ours slows them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from cellsys.accuracy.setups import CostProblem, Setup
from cellsys.arguments import checked
from cellsys.errors import IntegrationError

Method = Literal["RK23", "RK45", "DOP853", "Radau", "BDF", "LSODA"]
Rhs = Callable[[float, np.ndarray], np.ndarray]


@checked
def solve_ivp_peer(method: Method, tolerances: Sequence[float], rhs: Rhs | None = None) -> Setup:
    """scipy's `solve_ivp` by one of its methods; `rhs` replaces the system's own.

    Raises (when solved)
    --------------------
    IntegrationError
        When scipy reports a failure.
    """
    from scipy.integrate import solve_ivp

    def solve(problem: CostProblem, tolerance: float) -> np.ndarray:
        t = problem.t
        found = solve_ivp(
            problem.system.rhs if rhs is None else rhs,
            (t[0], t[-1]),
            problem.start,
            method=method,
            t_eval=t,
            rtol=tolerance,
            atol=tolerance,
        )
        if not found.success:
            raise IntegrationError(
                f"scipy {method}: {found.message}",
                time=float(found.t[-1]) if len(found.t) else float(t[0]),
                state_norm=0.0,
                step=0.0,
            )
        return found.y.T

    return Setup(name=f"scipy {method}", solve=solve, settings=tuple(tolerances))


@checked
def input_output_response(tolerances: Sequence[float], rhs: Rhs | None = None) -> Setup:
    """python-control's `input_output_response` with its default method (RK45)."""

    def solve(problem: CostProblem, tolerance: float) -> np.ndarray:
        import control

        law = problem.system.rhs if rhs is None else rhs

        def update(t: float, x: np.ndarray, u: np.ndarray, params: object) -> np.ndarray:
            return law(t, x)

        n = problem.system.states.size
        plant = control.nlsys(update, None, inputs=1, states=n, outputs=n, dt=0)
        found = control.input_output_response(
            plant,
            problem.t,
            0.0,
            problem.start,
            solve_ivp_kwargs={"rtol": tolerance, "atol": tolerance},
        )
        return found.states.T

    return Setup(name="python-control", solve=solve, settings=tuple(tolerances))
