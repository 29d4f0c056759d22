"""One implicit Euler step as a minimisation, by quasi-Newton with one kept factorisation.

    q+ = argmin Phi(q),    Phi(q) = C |q - q_0|^2 / (2 dt) + U(q) - f . q

Its stationary point is the step C (q - q_0)/dt = F(q) + f. A step is accepted only if
U(q+) - U(q_0) <= f . (q+ - q_0): the field is passive step by step, whether U is convex or not
(buckled fibres make it indefinite), and whatever residual is left.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from cellsys.errors import IntegrationError

# Secant pairs: steps s, changes of the gradient y, and s . y.
Pairs = deque[tuple[np.ndarray, np.ndarray, float]]
Solve = Callable[[np.ndarray], np.ndarray]
_PAIRS = 12  # kept secant pairs
_HALVINGS = 12  # of one step length
_ROUND = 12  # corrections with one fresh tangent
_ROUNDING = 1e-11  # of the energies in play: what sums over thousands of fibres lose


@dataclass(frozen=True, kw_only=True)
class StepInfo:
    """How one implicit step went.

    Attributes
    ----------
    iterations : int
        Force evaluations.
    residual : float
        |C (q+ - q)/dt - F(q+) - f| over the largest of the three terms at the start.
    halvings : int
        Step lengths that had to be shortened.
    fresh : int
        Fresh tangents factorised because the kept one was not good enough.
    work, gain : float
        f . (q+ - q) and U(q+) - U(q), pN um; gain <= work.
    """

    iterations: int
    residual: float
    halvings: int
    fresh: int
    work: float
    gain: float


@dataclass(kw_only=True)
class StepMemory:
    """What one step may hand to the next of the same size: secant pairs, last state, last move.

    It saves evaluations and changes a result only within the tolerance.
    """

    pairs: Pairs = field(default_factory=lambda: deque(maxlen=_PAIRS))
    dt: float | None = None
    q: np.ndarray | None = None
    force: np.ndarray | None = None
    energy: float = 0.0
    move: np.ndarray | None = None

    def at(self, q: np.ndarray) -> bool:
        """Whether force and energy kept here belong to q."""
        return self.q is not None and np.array_equal(self.q, q)


@dataclass(frozen=True, kw_only=True)
class StepProblem:
    """The functions a step needs: energy, force, solve with the kept and with a fresh tangent."""

    drag: float
    energy: Callable[[np.ndarray], float]
    force: Callable[[np.ndarray], np.ndarray]
    kept: Callable[[np.ndarray], np.ndarray]
    fresh: Callable[[np.ndarray], Callable[[np.ndarray], np.ndarray]]


def _direction(g: np.ndarray, pairs: Pairs, solve: Solve) -> np.ndarray:
    """-H g, H the inverse Hessian of the kept factorisation and the secant pairs (L-BFGS)."""
    a, d = [], -g
    for s, y, sy in reversed(pairs):
        a.append((s @ d) / sy)
        d = d - a[-1] * y
    d = solve(d)
    for (s, y, sy), weight in zip(pairs, reversed(a), strict=True):
        d = d + (weight - (y @ d) / sy) * s
    return d


class _Descent:
    """State of one step under way."""

    def __init__(
        self, p: StepProblem, q0: np.ndarray, load: np.ndarray, dt: float, memory: StepMemory
    ) -> None:
        self.p, self.q0, self.load, self.dt, self.memory = p, q0, load, dt, memory
        known = memory.force if memory.at(q0) else None
        self.F0 = p.force(q0) if known is None else known
        self.U0 = p.energy(q0) if known is None else memory.energy
        self.evaluations, self.halvings, self.fresh = int(known is None), 0, 0
        if memory.dt != dt:
            memory.pairs.clear()
        self.scale = max(float(np.linalg.norm(load)), float(np.linalg.norm(self.F0)), 1e-12)

    def gradient(self, q: np.ndarray, F: np.ndarray) -> np.ndarray:
        return (self.p.drag / self.dt) * (q - self.q0) - F - self.load

    def evaluate(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        F = self.p.force(q)
        self.evaluations += 1
        return F, self.gradient(q, F)

    def balance(self, q: np.ndarray) -> tuple[float, float, float, bool]:
        """Energy at q, gain, work, and whether the gain is at most the work."""
        U = self.p.energy(q)
        gain, work = U - self.U0, float(self.load @ (q - self.q0))
        return U, gain, work, gain <= work + _ROUNDING * (abs(U) + abs(self.U0) + abs(work))

    def phi(self, q: np.ndarray) -> float:
        """Phi(q) - Phi(q_0)."""
        _, gain, work, _ = self.balance(q)
        return 0.5 * self.p.drag / self.dt * float((q - self.q0) @ (q - self.q0)) + gain - work

    def search(
        self,
        q: np.ndarray,
        F: np.ndarray,
        tolerance: float,
        cap: int,
        solve: Solve,
        monotone: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Quasi-Newton from q until the residual is below tolerance or the cap is met.

        At least one correction is made: it costs little and leaves far less than the tolerance.
        `monotone` lets Phi fall at every correction, at the price of an energy each.
        """
        pairs = self.memory.pairs
        g = self.gradient(q, F)
        height = self.phi(q) if monotone else 0.0
        for k in range(cap):
            size = float(np.linalg.norm(g)) / self.scale
            if (size <= tolerance and k) or size == 0.0 or not np.isfinite(size):
                break
            d = _direction(g, pairs, solve)
            slope = float(g @ d)
            if not slope < 0.0:
                pairs.clear()
                d = solve(-g)
                slope = float(g @ d)
            length = 1.0
            for _ in range(_HALVINGS):
                trial = q + length * d
                F_t, g_t = self.evaluate(trial)
                end = float(g_t @ d)
                if monotone:
                    reached = self.phi(trial)
                    rounding = _ROUNDING * (abs(self.U0) + abs(height))
                    good = reached <= height + 1e-4 * length * slope + rounding
                else:
                    # Not past the minimum along d by more than the start was before it.
                    good = end <= -0.9 * slope
                if good:
                    break
                self.halvings += 1
                length *= float(np.clip(slope / (slope - end), 0.1, 0.5)) if end > 0 else 0.5
            if monotone:
                height = reached
            s, y = trial - q, g_t - g
            sy = float(s @ y)
            if sy > 1e-10 * float(np.linalg.norm(s) * np.linalg.norm(y)):
                pairs.append((s, y, sy))
            q, F, g = trial, F_t, g_t
        return q, F, float(np.linalg.norm(g)) / self.scale


def implicit_step(
    p: StepProblem,
    q0: np.ndarray,
    load: np.ndarray,
    dt: float,
    *,
    tolerance: float,
    cap: int,
    memory: StepMemory,
    t: float,
) -> tuple[np.ndarray, StepInfo]:
    """q+ of one implicit Euler step under a load held over dt; see the module's text.

    Starts from the last move repeated; where the kept factorisation does not converge, fresh
    tangents; where the end is not passive, a smaller residual, then a descent of Phi from q_0,
    which is passive by construction. IntegrationError when `cap` evaluations do not suffice.
    """
    state = _Descent(p, q0, load, dt, memory)
    q, F = q0, state.F0
    if memory.move is not None and memory.dt == dt and memory.at(q0):
        q = q0 + memory.move
        F = state.evaluate(q)[0]
    memory.dt = dt

    def renew(
        q: np.ndarray, F: np.ndarray, goal: float, monotone: bool = False
    ) -> tuple[np.ndarray, np.ndarray, float]:
        left = np.inf
        while left > goal and state.evaluations < cap:
            memory.pairs.clear()
            state.fresh += 1
            tries = min(_ROUND, cap - state.evaluations)
            q, F, left = state.search(q, F, goal, tries, p.fresh(q), monotone)
            if not np.isfinite(left):
                q, F = q0, state.F0
        return q, F, left

    q, F, left = state.search(q, F, tolerance, cap // 2, p.kept)
    if not left <= tolerance:
        start = (q, F) if left < 1.0 else (q0, state.F0)
        q, F, left = renew(*start, tolerance)
    U, gain, work, passive = state.balance(q)
    if left <= tolerance and not passive:
        q, F, _ = state.search(q, F, 1e-4 * tolerance, _ROUND, p.kept)
        U, gain, work, passive = state.balance(q)
    if left <= tolerance and not passive:
        q, F, left = renew(q0, state.F0, tolerance, monotone=True)
        U, gain, work, passive = state.balance(q)
    if not (left <= tolerance and passive):
        raise IntegrationError(
            f"implicit step of the matrix field: residual {left:.1e} (bound {tolerance:.0e}), "
            f"energy gained {gain:.4g} pN um of {work:.4g} pN um work, after "
            f"{state.evaluations} evaluations (cap {cap}); take a smaller step or a larger cap",
            time=t,
            state_norm=float(np.linalg.norm(q0)),
            step=dt,
        )
    memory.q, memory.force, memory.energy, memory.move = q, F, U, q - q0
    return q, StepInfo(
        iterations=state.evaluations,
        residual=left,
        halvings=state.halvings,
        fresh=state.fresh,
        work=work,
        gain=gain,
    )
