"""`Exponential`: exact in the linear part, any order in the slow part.

With a tolerance it works on systems that say which part is linear and which is slow
(`semilinear()`, closed loops on latent models): long windows of collocation in the slow states,
then all samples by matrix products. With a step it is an exponential Runge-Kutta method of
order 1 to 4 for any system x' = W_x x + N(t, x) [Cox and Matthews 2002].
"""

from __future__ import annotations

import time as clock
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import ParameterError
from cellsys.integrate.capabilities import NamesLinearPart
from cellsys.integrate.exponential_steps import ExponentialStepper
from cellsys.integrate.propagation import average_commands, sample, spacing
from cellsys.integrate.semilinear import DenseFlow, ModalFlow, Semilinear
from cellsys.integrate.solution import Solution
from cellsys.integrate.splitting import Splitting
from cellsys.integrate.stepping import check_step
from cellsys.integrate.windows import Path, WindowSolver
from cellsys.system import OdeSystem


@checked
@dataclass(frozen=True, kw_only=True)
class Exponential:
    """Exponential integrator: give rtol and atol, or a step and an order.

    Parameters
    ----------
    rtol, atol : float, optional
        Collocation over long windows; polynomial in the slow states, exact in the linear part.
        The error of a window stays below rtol |y| + atol. Needs a system with `semilinear()`.
    step : float, optional
        Largest step, s, of a fixed-step exponential Runge-Kutta method, for any system. For
        constant polarity its result is exact for any step.
    order : {1, 2, 3, 4}
        Order of the fixed-step method in the part that is not linear; 2 or 4 on coupled cells,
        whose exact flows are composed (`Splitting`).

    Raises
    ------
    ParameterError
        When neither or both kinds of accuracy are given.

    Notes
    -----
    A whose eigenvectors lose more digits than the tolerance allows is not diagonalised: its
    exponentials are then computed by scaling and squaring, which takes longer.
    """

    rtol: float | None = None
    atol: float | None = None
    step: float | None = None
    order: int = 4

    finds_events: ClassVar[bool] = False
    estimates: ClassVar[str] = "the same windows with four nodes more"

    def __post_init__(self) -> None:
        tolerances = (self.rtol, self.atol)
        if self.step is not None:
            check_step("Exponential", self.step)
            if tolerances != (None, None):
                raise ParameterError("Exponential takes rtol and atol, or a step, not both")
        else:
            for name, value in zip(("rtol", "atol"), tolerances, strict=True):
                if value is None or not (np.isfinite(value) and value > 0):
                    raise ParameterError(
                        f"Exponential.{name} must be > 0, got {value!r}; give rtol, atol or step"
                    )
        if self.order not in (1, 2, 3, 4):
            raise ParameterError(f"Exponential.order must be 1, 2, 3 or 4, got {self.order!r}")

    def of_cells(self) -> Splitting:
        """The method on coupled cells: their exact flows composed, to order 6 or as given.

        Raises
        ------
        ParameterError
            When a fixed step comes with the order 1 or 3.
        """
        if self.step is None:
            return Splitting(rtol=self.rtol, atol=self.atol)
        return Splitting(step=self.step, order=self.order)

    def solve(
        self, system: OdeSystem, t: np.ndarray, x0: np.ndarray, *, averages: bool = True
    ) -> Solution:
        """Integrate over the grid `t`; `averages` of eta and u cost a little more."""
        if self.step is not None:
            return ExponentialStepper(system, self.step, self.order).solve(t, x0, averages)
        if not isinstance(system, NamesLinearPart):
            raise ParameterError(
                "Exponential(rtol=, atol=) needs a system that names its linear part (a closed "
                "loop on a latent model); give step= and order= for any other system"
            )
        return self._solve_windows(system.semilinear(), t, x0, averages)

    def _solve_windows(
        self, system: Semilinear, t: np.ndarray, x0: np.ndarray, averages: bool
    ) -> Solution:
        began = clock.perf_counter()
        rtol, atol = float(self.rtol), float(self.atol)  # type: ignore[arg-type]
        precise = system.modal.loss < 0.01 * (rtol + atol)
        flow: ModalFlow | DenseFlow = system.modal if precise else system.dense
        s = _nodes(rtol + atol)
        solver = WindowSolver(system, flow, s, rtol, atol)
        w, y = flow.start(x0[system.fast]), x0[system.slow]
        n, T = len(x0), len(t)
        x = np.empty((T, n))
        # Overflow of an unstable linear part is reported by the solver with its time.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            path = Path(edges=[float(t[0])], lengths=[], y=[], w=[w])
            if T > 1:
                path = solver.run(float(t[0]), float(t[-1]), spacing(t) or 1.0, w, y)
                sample(system, flow, path, t, s, 0.1 * (rtol + atol), x)
            else:
                x[0] = x0
        x[0] = x0
        u = self._averages(system, path, t, s, x) if averages else None
        statistics = {
            **path.counts,
            "solve_time": clock.perf_counter() - began,
            "coordinates": "modal" if flow is system.modal else "dense",
        }

        def estimate() -> np.ndarray:
            error = np.zeros(n)
            if T > 1:
                finer = WindowSolver(system, flow, s + 4, 0.1 * rtol, 0.1 * atol)
                error[system.slow], error[system.fast] = solver.again(path, finer)
            return error

        eta = np.zeros((max(T - 1, 0), 0)) if averages else None
        return Solution(x=x, eta=eta, u=u, statistics=statistics, estimate=estimate)

    @staticmethod
    def _averages(
        system: Semilinear, path: Path, t: np.ndarray, s: int, x: np.ndarray
    ) -> np.ndarray:
        u = np.zeros((max(len(t) - 1, 0), x.shape[1]))
        if len(t) > 1:
            c = average_commands(system, path, t, s)
            u[:, system.fast] = c @ system.B.T + system.b
            u[:, system.slow] = np.diff(x[:, system.slow], axis=0) / np.diff(t)[:, None, None]
        return u


def _nodes(tolerance: float) -> int:
    """Nodes of a window: more of them pay when the tolerance is tight."""
    for bound, nodes in ((3e-3, 8), (3e-5, 12), (3e-7, 16)):
        if tolerance > bound:
            return nodes
    return 20
