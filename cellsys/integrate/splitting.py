"""`Splitting`: two exact flows composed, for a linear plant with a controller that turns.

    x' = M x + G c(p),    p' = kappa p x (d(x) x p)

Two exact flows: x with p held, p with x held. Their symmetric composition S(h) = X(h/2) P(h)
X(h/2) has an error expansion in even powers of h, so runs of 1, 2 and 3 pieces of a step are
extrapolated to order 6 (local error h^7); the difference to the order-4 value (local error h^5)
controls the step. [Hairer, Lubich, Wanner 2006, II.4, V.2; Deuflhard 1983]
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import Integrator
from cellsys.errors import IntegrationError, ParameterError
from cellsys.integrate.capabilities import SplitFlows, Splits
from cellsys.integrate.estimate import estimate_by, estimate_of
from cellsys.integrate.stepping import SampledRun, check_step, steps_of
from cellsys.system import OdeSystem
from cellsys.trajectory import ErrorEstimate
from cellsys.units import real_number

_LARGEST = 1e100  # growth over the start at which a run is reported as unstable
_HALVINGS = 40


@checked
@dataclass(frozen=True, kw_only=True)
class Splitting:
    """Exact flows of coupled cells composed: give rtol and atol, or a step.

    Without any of them it serves where nothing turns, and one exact flow is the whole run.

    Parameters
    ----------
    rtol, atol : float, optional
        Bound the error of each step of the method of order 6.
    step : float, optional
        Largest step, s.
    order : {2, 4, 6}
        Of the composition with a fixed step.

    Raises
    ------
    ParameterError
        When only one tolerance is given, or tolerances and a step.
    """

    rtol: float | None = None
    atol: float | None = None
    step: float | None = None
    order: int = 6

    def __post_init__(self) -> None:
        tolerances = (self.rtol, self.atol)
        if self.step is not None:
            check_step("Splitting", self.step)
            if tolerances != (None, None):
                raise ParameterError("Splitting takes rtol and atol, or a step, not both")
        elif tolerances != (None, None):
            for name, value in zip(("rtol", "atol"), tolerances, strict=True):
                if value is None or not real_number(value, f"Splitting.{name}") > 0:
                    raise ParameterError(
                        f"Splitting.{name} must be > 0, got {value!r}; give both, or a step"
                    )
        if self.order not in (2, 4, 6):
            raise ParameterError(
                f"the order of composed exact flows is 2, 4 or 6, got {self.order!r}"
            )
        if self.step is None and self.order != 6:
            raise ParameterError("with rtol and atol the order of Splitting is 6; give a step")

    def start(
        self, system: OdeSystem, t0: float, x0: np.ndarray, rng: np.random.Generator
    ) -> SplitStepper:
        """A stepper at (t0, x0).

        Raises
        ------
        ParameterError
            When the system does not come apart into exact flows, or turns and no accuracy is
            given.
        """
        return SplitStepper(self, system, t0, x0, rng, self._flows(system))

    def _flows(self, system: OdeSystem) -> SplitFlows:
        if not isinstance(system, Splits):
            raise ParameterError(
                f"Splitting composes the exact flows of coupled cells, and a "
                f"{type(system).__name__} has none; use Exponential, DOP853, LSODA or CVODES"
            )
        flows = system.splitting()
        if flows.turns and self.rtol is None and self.step is None:
            raise ParameterError(
                "cells with a controller need an integrator that carries rtol and atol "
                "(Exponential, DOP853, Radau, LSODA, CVODES) or a step (Exponential, RungeKutta4)"
            )
        return flows

    def estimator(
        self,
        system: OdeSystem,
        t: np.ndarray,
        x: np.ndarray,
        again: Callable[[Integrator, np.ndarray], np.ndarray],
    ) -> Callable[[], ErrorEstimate]:
        """Estimate of a run of samples x (T, n); ``again(method, times)`` runs it anew.

        Where nothing turns the flow is exact, and what differs in two flows for one is rounding.
        """
        if self._flows(system).turns:
            return estimate_of(self, x, lambda second: again(second, t), None)
        halves = np.sort(np.concatenate([t, 0.5 * (t[1:] + t[:-1])]))
        return estimate_by(x, lambda: again(self, halves)[::2], "exact flow, two for one")


class SplitStepper(SampledRun):
    """A run over two exact flows."""

    def __init__(
        self,
        method: Splitting,
        system: OdeSystem,
        t0: float,
        x0: np.ndarray,
        rng: np.random.Generator,
        flows: SplitFlows,
    ) -> None:
        super().__init__(system, t0, x0, rng, np.inf if method.step is None else method.step)
        self.flows, self.fixed, self.order = flows, method.step, method.order
        self.rtol, self.atol = method.rtol or 1.0, method.atol or 1.0
        self.statistics = {"steps": 0, "rejected": 0}
        self.halvings = 0
        self._take_apart()
        self.limit = _LARGEST * max(1.0, float(np.linalg.norm(self.plant)))

    def _take_apart(self) -> None:
        self.plant, self.p = self.flows.parts(self.x)
        self.length = np.linalg.norm(self.p, axis=1)

    def memory(self) -> dict[str, np.ndarray]:
        """The step in use and the bound of the run."""
        return {"split": np.array([self.halvings, self.limit])}

    def restore(self, memory: dict[str, np.ndarray]) -> None:
        """Take back what `memory` gave."""
        self.halvings, self.limit = int(memory["split"][0]), float(memory["split"][1])
        self._take_apart()

    def advance(self, t1: float) -> tuple[np.ndarray, np.ndarray]:
        """Move to t1; u is the mean rate, for the system has no other part."""
        t0, before = self.t, self.x
        self._move(t0, float(t1))
        self.t, self.x = float(t1), self.flows.whole(self.plant, self.p)
        return np.zeros(self.system.auxiliaries.size), (self.x - before) / (t1 - t0)

    def _move(self, t0: float, t1: float) -> None:
        if not self.flows.turns:
            with np.errstate(over="ignore", invalid="ignore"):
                self.plant = self.flows.drift(self.plant, self.p, t1 - t0)
            self.statistics["steps"] += 1
            self._check(t0, t1)
        elif self.fixed is not None:
            n = steps_of(t1 - t0, self.fixed)
            for i in range(n):
                self.plant, self.p, _ = self._extrapolated((t1 - t0) / n)
                self.statistics["steps"] += 1
                self._check(t0 + (t1 - t0) * i / n, t0 + (t1 - t0) * (i + 1) / n)
        else:
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
                        time=t0, state_norm=float(np.linalg.norm(self.plant)), step=h,
                    )  # fmt: skip
                continue
            self.plant, self.p = x, p
            self.statistics["steps"] += 1
            done += 2 ** (_HALVINGS - j)
            # Twice the step has 32 times the error (local order 5), and must start on its grid.
            if error < 0.02 and j > 0 and done % 2 ** (_HALVINGS - j + 1) == 0:
                j -= 1
        self.halvings = j

    def _pieces(self, h: float, n: int) -> tuple[np.ndarray, np.ndarray]:
        """n symmetric compositions of h/n."""
        x, p, flows = self.plant, self.p, self.flows
        step = h / n
        x = flows.drift(x, p, 0.5 * step)
        for i in range(n):
            p = flows.turn(x, p, step)
            # Two half steps with the same p are one whole step.
            x = flows.drift(x, p, step if i < n - 1 else 0.5 * step)
        return x, p

    def _extrapolated(self, h: float) -> tuple[np.ndarray, np.ndarray, float]:
        with np.errstate(over="ignore", invalid="ignore"):
            pieces = [self._pieces(h, n) for n in range(1, self.order // 2 + 1)]
            if self.order == 2:
                return *pieces[0], 0.0
            parts = []
            for each in zip(*pieces, strict=True):
                a, b = each[:2]
                low = b + (b - a) / 3.0
                high = low if self.order == 4 else each[2] + (each[2] - b) * 0.8
                parts.append((high + (high - low) * 0.125, high - low))
            (x, dx), (p, dp) = parts
            p *= (self.length / np.linalg.norm(p, axis=1))[:, None]
            error = np.inf
            if np.all(np.isfinite(dx)) and np.all(np.isfinite(dp)):
                weight = self.atol + self.rtol * np.maximum(np.abs(x), np.abs(self.plant))
                square = float(((dx / weight) ** 2).sum())
                square += float(((dp / (self.atol + self.rtol * self.length[:, None])) ** 2).sum())
                error = np.sqrt(square / (dx.size + dp.size))
        return x, p, error

    def _check(self, t0: float, t1: float, x: np.ndarray | None = None) -> None:
        x = self.plant if x is None else x
        with np.errstate(over="ignore", invalid="ignore"):
            size = float(np.linalg.norm(x))
        if size <= self.limit:
            return
        raise IntegrationError(
            self.flows.blame(),
            time=t1,
            state_norm=size if np.isfinite(size) else np.inf,
            step=t1 - t0,
        )
