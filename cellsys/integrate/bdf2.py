"""Linearly implicit BDF2: implicit steps of second order.

Through x_n-1, x_n and x_n + h v, v = (x_n - x_n-1)/h_n, the derivative of the parabola at the
step's end is v itself, and moving the end by delta adds a delta/h to it, with

    a = (1 + 2 w)/(1 + w) ,      w = h/h_n

(3/2 at equal steps). So (a C/h + M) delta = F(x*) - C v at x* = x_n + h v is BDF2 [Hairer, Norsett
& Wanner, Solving ODEs I, III.5] with one correction, for any M; delta is O(h^2), so a kept M costs
no order. On C x' = -k x with M = m k that is stable for every h where m >= 3/4, the bound of
implicit Euler too.

The start of the corrections is free, and what they leave over is smaller from

    x* = x_n + h v + h/2 (v - v') ,

v' the velocity before: half of what a parabola through three points adds. With it every m >= 5/6
is stable; with more than half, M too large by a factor of some tens is not.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nextafter

import numpy as np

from cellsys.arguments import checked
from cellsys.integrate.implicit_steps import ImplicitMethod, ImplicitStepper
from cellsys.integrate.stepping import Stepper
from cellsys.overdamped import OverdampedSystem
from cellsys.system import OdeSystem

_FIRST = 5  # a start's first step is taken in so many: the first of all is of first order
_GROWTH = 5.0 + 1e-6  # longest step in lengths of the last one; beyond it history says nothing
_LEVEL = 1e-6  # share by which a step may be longer than the last one for its bend to count
_JUMP = 1e-6  # share of a rate by which it may differ on the two sides of a stop point


@checked
@dataclass(frozen=True, kw_only=True)
class BDF2(ImplicitMethod):
    """Second-order W-method for overdamped systems: one force evaluation and one solve a step.

    Internal states follow to second order too, by the laws at the step's middle. The velocity is
    kept through kinks of commands; where a law jumps at a stop point, and after a discrete
    change (rupture), one step of first order is taken. What a run logs is the trapezoid of the
    laws at the ends of the steps.

    Parameters
    ----------
    step : float
        Largest step, s.
    refresh : int
        Steps between two looks at the tangent, as in `LinearlyImplicit`.
    corrections : int
        Most corrections of one step.
    tolerance : float
        Share of a block's rate that one step may leave over.
    largest_move : float
        Largest displacement of a node in one step, um; a step beyond it is halved.
    """

    refresh: int = 24
    corrections: int = 8

    @property
    def order(self) -> int:
        """2."""
        return 2

    def start(
        self, system: OdeSystem, t0: float, x0: np.ndarray, rng: np.random.Generator
    ) -> Stepper:
        """A stepper at (t0, x0)."""
        return _SecondOrderStepper(self, self.overdamped(system), t0, x0, rng)


class _SecondOrderStepper(ImplicitStepper):
    rounds = True

    def __init__(
        self,
        method: BDF2,
        system: OverdampedSystem,
        t0: float,
        x0: np.ndarray,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(method, system, t0, x0, rng)
        self.before = 0.0  # length of the last step, s; 0 where there is none to go on from
        self.a, self.bend = 1.0, 0.0
        # What has no velocity of its own, internal states and held nodes, and how it changed last.
        self.rest = np.flatnonzero(~self.moving)
        self.drift = np.zeros(self.rest.size)
        # The velocity before the last one, and the length of its step.
        self.earlier, self.long = np.zeros(system.states.size), 0.0
        self.middle = self.x
        # Laws at the end of the last step; None where they must be evaluated anew.
        self.ended: tuple[np.ndarray, np.ndarray] | None = None
        self.begun: tuple[np.ndarray, np.ndarray] | None = None

    def memory(self) -> dict[str, np.ndarray]:
        out = {**super().memory(), "before": np.array([self.before])}
        out |= {"drift": self.drift, "earlier": self.earlier, "long": np.array([self.long])}
        if self.ended is not None:
            out |= {"ended_eta": self.ended[0], "ended_u": self.ended[1]}
        return out

    def restore(self, memory: dict[str, np.ndarray]) -> None:
        super().restore(memory)
        self.before, self.long = float(memory["before"][0]), float(memory["long"][0])
        self.earlier, self.drift = memory["earlier"].copy(), memory["drift"].copy()
        if "ended_eta" in memory:
            self.ended = memory["ended_eta"].copy(), memory["ended_u"].copy()

    def take_step(self, t: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
        if self.before and (dt > _GROWTH * self.before or (t in self.kinks and self._jumps(t))):
            self.before = self.long = 0.0
            self.velocity, self.drift = np.zeros_like(self.velocity), np.zeros_like(self.drift)
        if self.before:
            return super().take_step(t, dt)
        # A start: the first step of all is of first order, so it is a short one.
        short = dt / _FIRST
        eta, u = super().take_step(t, short)
        eta, u = eta.copy(), u.copy()
        for k in range(1, _FIRST):
            for total, value in zip((eta, u), super().take_step(t + k * short, short), strict=True):
                total += value
        return eta / _FIRST, u / _FIRST

    def weight(self, t: float, x: np.ndarray, dt: float, happened: bool) -> float:
        # Past a stop point, and past a discrete change, the laws have new values.
        anew = self.ended is None or self.system.discrete or t in self.kinks
        if self.averages:
            self.begun = self._laws(nextafter(t, inf), x) if anew else self.ended
        w = 0.0 if happened else (dt / self.before if self.before else 0.0)
        self.a = (1.0 + 2.0 * w) / (1.0 + w)
        # Not where steps grow: a bend that is found in short steps says little about a long one.
        level = 0.0 < w < 1.0 + _LEVEL and self.long
        self.bend = 0.5 * dt * (dt + self.before) / (self.before + self.long) if level else 0.0
        # Internal states follow the laws of the middle, to which the last changes lead; where
        # something switches they say nothing.
        self.middle = x + 0.5 * dt * self.velocity
        if self.system.discrete:
            self.system.advance_internal(t, x, self.middle, 0.5 * dt)
        else:
            self.middle[self.rest] += 0.5 * dt * self.drift
        return self.a

    def predicted(self, t: float, x: np.ndarray, dt: float) -> np.ndarray:
        end = x + dt * self.velocity
        if self.bend:
            end += self.bend * (self.velocity - self.earlier)
        return end

    def law_time(self, t: float) -> float:
        return nextafter(t, -inf) if t in self.kinks else t

    def add_history(self, rate: np.ndarray) -> None:
        if self.a != 1.0:
            rate += (self.a - 1.0) * self.velocity

    def advance_internal(self, t: float, x: np.ndarray, end: np.ndarray, dt: float) -> None:
        self.system.advance_by_middle(t, x, self.middle, end, dt)

    def accepted(
        self, x: np.ndarray, eta: np.ndarray, u: np.ndarray, velocity: np.ndarray, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        self.drift = (self.x[self.rest] - x[self.rest]) / dt
        self.earlier, self.velocity = self.velocity, velocity
        self.before, self.long = dt, self.before
        if self.begun is None:
            return eta, u
        (eta_begun, u_begun), self.ended = self.begun, (eta, u)
        return 0.5 * (eta_begun + eta), 0.5 * (u_begun + u)

    def _laws(self, t: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.statistics["rhs"] += 1
        return self.system.efforts(t, x), self.system.u(t, x)

    def _jumps(self, t: float) -> bool:
        """Whether the rate of a moving node is not the same on the two sides of t."""
        sides = []
        for side in (nextafter(t, -inf), nextafter(t, inf)):
            eta, u = self._laws(side, self.x)
            sides.append(self.is_moving * self.system.rate(self.x, eta, u))
        size = max(float(np.linalg.norm(rate)) for rate in sides)
        return float(np.linalg.norm(sides[1] - sides[0])) > _JUMP * size
