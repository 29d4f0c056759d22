"""Exact-flow splitting: many cells, each with its controller and sensor, over one linear flow.

With commands c(p) and sensed directions d(z) the whole is

    x' = M x + G (B c(p) + b),    p' = kappa p x (d(z) x p)

Two exact flows: x with p held, p with z held. Their symmetric composition S(h) = X(h/2) P(h)
X(h/2) has an error expansion in even powers of h, so runs of 1, 2 and 3 pieces of a step are
extrapolated to order 6 (local error h^7); the difference to the order-4 value (local error h^5)
controls the step. [Hairer, Lubich, Wanner 2006, II.4, V.2; Deuflhard 1983]
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from cellsys.errors import IntegrationError, ParameterError
from cellsys.integrate.estimate import estimate_by, estimate_of
from cellsys.population.headings import commands, sensed, turn
from cellsys.trajectory import ErrorEstimate

_LARGEST = 1e100  # growth over the start at which a run is reported as unstable
_HALVINGS = 40


class SplitRun:
    """A run of cells with controllers over an exact linear flow.

    Parameters
    ----------
    cells : CoupledCells or PortedCells
        For its name, number and growth rate in an error.
    flow : EmergentFlow or PortFlow
        flow(x, c, h), sense(x), n_inputs.
    loop : ClosedLoop or None
    x, p : array, (K, 3)
        Start.
    integrator : object with rtol and atol, or step
    """

    def __init__(
        self, cells: Any, flow: Any, loop: Any, x: np.ndarray, p: np.ndarray, integrator: Any
    ) -> None:
        self.cells, self.flow, self.loop, self.x = cells, flow, loop, x
        self.p, self.length = p, np.linalg.norm(p, axis=1)
        self.statistics: dict[str, Any] = {"steps": 0, "rejected": 0}
        self.limit = _LARGEST * max(1.0, float(np.linalg.norm(self.x)))
        self.halvings = 0
        self.rtol, self.atol, self.fixed = _tolerances(integrator, self.loop)

    def direction(self, x: np.ndarray | None = None) -> np.ndarray:
        """d (K, 3) at the state x."""
        return sensed(self.loop, self.flow.sense(self.x if x is None else x))

    def advance(self, t0: float, t1: float) -> None:
        """Move from t0 to t1."""
        if self.loop is None:
            still = np.zeros((self.cells.n_cells, self.flow.n_inputs))
            with np.errstate(over="ignore", invalid="ignore"):
                self.x = self.flow.flow(self.x, still, t1 - t0)
            self.statistics["steps"] += 1
            self._check(t0, t1)
            return
        if self.fixed is not None:
            n = max(1, int(np.ceil((t1 - t0) / self.fixed * (1.0 - 1e-12))))
            for i in range(n):
                self.x, self.p, _ = self._extrapolated((t1 - t0) / n)
                self.statistics["steps"] += 1
                self._check(t0 + (t1 - t0) * i / n, t0 + (t1 - t0) * (i + 1) / n)
            return
        self._controlled(t0, t1)

    def _controlled(self, t0: float, t1: float) -> None:
        # Steps are the interval over powers of two: their exponentials are reused.
        length, done = t1 - t0, 0
        j = self.halvings
        while done < 2**_HALVINGS:
            h = length / 2**j
            x, p, error = self._extrapolated(h)
            self._check(t0 + length * done / 2**_HALVINGS, t1, x)
            if not error <= 1.0:
                j += 1
                self.statistics["rejected"] += 1
                if j > _HALVINGS:
                    raise IntegrationError(
                        "the step of coupled cells cannot be made small enough; loosen rtol and "
                        "atol",
                        time=t0, state_norm=float(np.linalg.norm(self.x)), step=h,
                    )  # fmt: skip
                continue
            self.x, self.p = x, p
            self.statistics["steps"] += 1
            done += 2 ** (_HALVINGS - j)
            # Twice the step has 32 times the error (local order 5), and must start on its grid.
            if error < 0.02 and j > 0 and done % 2 ** (_HALVINGS - j + 1) == 0:
                j -= 1
        self.halvings = j

    def _pieces(self, h: float, n: int) -> tuple[np.ndarray, np.ndarray]:
        """n symmetric compositions of h/n."""
        x, p, loop = self.x, self.p, self.loop
        step = h / n
        x = self.flow.flow(x, commands(loop, p), 0.5 * step)
        for i in range(n):
            p = turn(loop, p, self.direction(x), step)
            # Two half steps with the same p are one whole step.
            x = self.flow.flow(x, commands(loop, p), step if i < n - 1 else 0.5 * step)
        return x, p

    def _extrapolated(self, h: float) -> tuple[np.ndarray, np.ndarray, float]:
        with np.errstate(over="ignore", invalid="ignore"):
            (x1, p1), (x2, p2), (x3, p3) = (self._pieces(h, n) for n in (1, 2, 3))
            parts = []
            for a, b, c in ((x1, x2, x3), (p1, p2, p3)):
                low = b + (b - a) / 3.0
                high = c + (c - b) * 0.8
                parts.append((high + (high - low) * 0.125, high - low))
            (x, dx), (p, dp) = parts
            p *= (self.length / np.linalg.norm(p, axis=1))[:, None]
            error = np.inf
            if np.all(np.isfinite(dx)) and np.all(np.isfinite(dp)):
                weight = self.atol + self.rtol * np.maximum(np.abs(x), np.abs(self.x))
                square = float(((dx / weight) ** 2).sum())
                square += float(((dp / (self.atol + self.rtol * self.length[:, None])) ** 2).sum())
                error = np.sqrt(square / (dx.size + dp.size))
        return x, p, error

    def _check(self, t0: float, t1: float, x: np.ndarray | None = None) -> None:
        x = self.x if x is None else x
        with np.errstate(over="ignore", invalid="ignore"):
            size = float(np.linalg.norm(x))
        if size <= self.limit:
            return
        rate = self.cells.pole_set().abscissa
        if rate > 0:
            reason = (
                f"the coupled system is unstable and grows at {rate:.6g} 1/s "
                f"({self.cells.coupling.name}, {self.cells.n_cells} cells); stability() names the "
                "blocks"
            )
        else:
            reason = "the run is not finite although no pole grows: ill-conditioned poles"
        raise IntegrationError(
            reason, time=t1, state_norm=size if np.isfinite(size) else np.inf, step=t1 - t0
        )


def split_estimate(
    loop: Any, integrator: Any, times: np.ndarray, x: np.ndarray, states: Callable
) -> Callable[[], ErrorEstimate]:
    """Estimate of a `SplitRun` of states x (T, n); ``states(integrator, times)`` runs it again.

    Without controllers its flow is exact and what differs in two flows for one is rounding.
    """
    if loop is not None:
        return estimate_of(integrator, x, lambda second: states(second, times), None)
    halves = np.sort(np.concatenate([times, 0.5 * (times[1:] + times[:-1])]))
    return estimate_by(x, lambda: states(integrator, halves)[::2], "exact flow, two for one")


def _tolerances(integrator: Any, loop: Any) -> tuple[float, float, float | None]:
    """(rtol, atol, fixed step or None) of the integrator object."""
    if loop is None:
        return 1.0, 1.0, None
    if hasattr(integrator, "rtol") and hasattr(integrator, "atol"):
        return float(integrator.rtol), float(integrator.atol), None
    if hasattr(integrator, "step"):
        return 1.0, 1.0, float(integrator.step)
    raise ParameterError(
        "cells with a controller need an integrator object that carries rtol and atol (CVODES, "
        f"DOP853, Radau, LSODA) or a step (RungeKutta4), got {type(integrator).__name__}"
    )
