"""Explicit Euler, the reference for the full-order model, and its stability limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellsys.arguments import checked
from cellsys.integrate.stepping import Stepper, check_step
from cellsys.overdamped import OverdampedSystem
from cellsys.system import OdeSystem
from cellsys.units import shaped_array


@checked
@dataclass(frozen=True, kw_only=True)
class ExplicitEuler:
    """x+ = x + step f(t, x), first order, stable for step < 2/|lambda|.

    Parameters
    ----------
    step : float
        Largest step, s; intervals between samples are cut into equal steps below it.
        `stability_limit(system)` gives the bound.
    """

    step: float

    def __post_init__(self) -> None:
        check_step("ExplicitEuler", self.step)

    def start(
        self, system: OdeSystem, t0: float, x0: np.ndarray, rng: np.random.Generator
    ) -> Stepper:
        """A stepper at (t0, x0)."""
        return _ExplicitStepper(system, t0, x0, rng, self.step)


class _ExplicitStepper(Stepper):
    def take_step(self, t: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
        system = self.system
        if isinstance(system, OverdampedSystem):
            self.x, happened = system.between_steps(t, self.x, dt, self.rng)
            self.events.extend(happened)
        eta, u = system.eta(t, self.x), system.u(t, self.x)
        self.statistics["rhs"] += 1
        self.x = self.x + dt * (system.W_x @ self.x + system.W_eta @ eta + u)
        return eta, u


@checked
def stability_limit(system: OverdampedSystem, t: float = 0.0, x: np.ndarray | None = None) -> float:
    """Largest stable explicit Euler step 2 / lambda_max(C^-1 K), s.

    K is the system's own majorant, so the limit is on the safe side. Power iteration, 200
    steps from a fixed start; the Rayleigh quotient then is within a few percent from below,
    hence the factor 1.05.

    Raises
    ------
    ParameterError
        When the system has no majorant.
    """
    state = system.x0 if x is None else shaped_array(x, "x", system.x0.shape)
    drag = system.drag()
    largest = 0.0
    for block in system.majorant(t, state, 0.0):
        c = drag[block.entries[:, 0]]
        free = np.isfinite(c)
        if not free.any():
            continue
        v = np.random.default_rng(0).standard_normal(c.size) * free
        scale = np.where(free, 1.0 / np.sqrt(np.where(free, c, 1.0)), 0.0)
        matrix, value = block.matrix(), 0.0
        for _ in range(200):
            v /= np.linalg.norm(v)
            w = scale * (matrix @ (scale * v))
            value, v = float(v @ w), w
            if not np.any(w):
                break
        largest = max(largest, 1.05 * value)
    for item in system.low_rank(t, state):
        c = drag[item.entries]
        largest += item.stiffness * float(np.sum(item.direction**2 / c))
    return np.inf if largest == 0.0 else 2.0 / largest
