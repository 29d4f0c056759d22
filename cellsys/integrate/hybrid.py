"""Smooth pieces between events: root-found guards, reset maps, stop points, interval averages.

One call integrates

    dx/dt = f(t, x)  until a guard g(t, x) passes zero,    x+ = reset(t, x-)

A guard is looked at several times in every step on the method's dense output, and its root is
found there to rounding. After a reset, guards that are *already* past zero (which no sign change
will ever show) fire one after another; more than `cascade` of them at one instant, or within a
millionth of the run, is chattering and ends the run with a named error.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from typing import NoReturn, TypeAlias

import numpy as np
import scipy.integrate as integrate
from scipy.optimize import brentq

from cellsys.errors import IntegrationError, ParameterError
from cellsys.integrate.solution import Solution
from cellsys.system import Event, EventFunction, OdeSystem

Rate = Callable[[float, np.ndarray], np.ndarray]
Solver: TypeAlias = integrate.OdeSolver
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
LOOKS = 4  # looks at the guards in one step
_SHARES = np.arange(1, LOOKS + 1) / LOOKS
EPS = float(np.finfo(float).eps)


def solve_hybrid(
    system: OdeSystem,
    t: np.ndarray,
    x0: np.ndarray,
    start: Callable[[Rate, float, np.ndarray, float], Solver],
    *,
    name: str,
    max_steps: int,
    cascade: int,
    averages: bool = True,
) -> Solution:
    """Samples, interval averages and events of a hybrid run over the grid `t`.

    Parameters
    ----------
    start : callable
        ``start(fun, t0, x0, t_bound)`` -> a scipy `OdeSolver`.
    name : str
        The method, for messages.
    max_steps : int
        Most steps of the whole run.
    cascade : int
        Most events at one instant.
    averages : bool
        Whether eta and u are averaged over the sampling intervals.

    Raises
    ------
    IntegrationError
        The method fails, a state is not finite, `max_steps` is spent, or events chatter.
    """
    return _Run(system, t, x0, start, name, max_steps, cascade, averages).solve()


class _Run:
    def __init__(self, system, t, x0, start, name, max_steps, cascade, averages) -> None:
        self.system, self.times, self.start = system, t, start
        self.name, self.max_steps, self.cascade = name, max_steps, cascade
        self.guards: tuple[EventFunction, ...] = tuple(system.events())
        for event in self.guards:
            if event.level and event.direction not in (-1, 1):
                raise ParameterError(f"event {event.name!r}: level needs direction -1 or 1")
        self.stops = np.unique(np.asarray(system.stop_points(), dtype=float))
        n, n_eta, T = system.states.size, system.auxiliaries.size, len(t)
        self.x = np.empty((T, n))
        self.eta = np.zeros((max(T - 1, 0), n_eta))
        self.u = np.zeros((max(T - 1, 0), n))
        self.averages = averages
        self.events: list[Event] = []
        self.state = np.array(x0, dtype=float)
        self.now = float(t[0])
        self.sample = 0
        self.armed = [0.0] * len(self.guards)  # sign on which each guard was last seen
        self.last = [-np.inf] * len(self.guards)
        self.turned = -1  # the guard whose reset turned it back last
        names = ("steps", "rejected", "rhs", "jacobians", "factorisations", "events", "instant")
        self.counts = dict.fromkeys(names, 0)
        self.shortest = np.inf
        self.forced = type(system).u is not OdeSystem.u or system.forcing is not None

    def solve(self) -> Solution:
        began = clock.perf_counter()
        # Overflow shows as inf or NaN, which `_step` reports with the time and the state's name.
        with np.errstate(over="ignore", invalid="ignore"):
            self._settle()
            self._record(self.now, None)
            for stop in [*self.stops[(self.stops > self.now) & (self.stops < self.times[-1])],
                         self.times[-1]]:  # fmt: skip
                while self.now < stop:
                    self._piece(float(stop))
        statistics = {
            **self.counts,
            "shortest_interval": self.shortest,
            "solve_time": clock.perf_counter() - began,
        }
        return Solution(x=self.x, eta=self.eta, u=self.u, statistics=statistics, events=self.events)

    def _piece(self, stop: float) -> None:
        """Integrate to the next event or to `stop`."""
        rhs, before = self.system.rhs, float(np.nextafter(stop, -np.inf))

        def left(t: float, x: np.ndarray) -> np.ndarray:
            # A stage at the stop point itself takes the limit from the left.
            return rhs(t if t < stop else before, x)

        solver = self.start(left, self.now, self.state, stop)
        while solver.status == "running":
            calls = solver.nfev
            message = solver.step()
            self.counts["steps"] += 1
            # An attempt of a Runge-Kutta step calls the right-hand side once a stage.
            attempts = (solver.nfev - calls) // getattr(solver, "n_stages", solver.nfev + 1)
            self.counts["rejected"] += max(attempts - 1, 0)
            if solver.status == "failed":
                self._fail(f"{self.name} failed: {message}", solver)
            if not np.isfinite(solver.y.sum()):
                bad = int(np.flatnonzero(~np.isfinite(solver.y))[0])
                self._fail(
                    f"{self.name}: state {self.system.states.names[bad]!r} is not finite", solver
                )
            if self.counts["steps"] > self.max_steps:
                self._fail(
                    f"{self.name} spent its {self.max_steps} steps; loosen the tolerance, or use "
                    "LSODA or Radau for a stiff system",
                    solver,
                )
            dense = solver.dense_output()
            a, b = float(solver.t_old), float(solver.t)
            found = self._first_root(dense, a, b) if self.guards else None
            end = b if found is None else found[0]
            self._record(end, dense, a)
            if found is not None:
                self._count(solver)
                self.now, self.state = end, np.array(dense(end))
                together = self._together(found[1])
                self._fire(found[1])
                for i in together:
                    event = self.guards[i]  # unless the others' resets took it back
                    if event.guard(self.now, self.state) * event.direction >= 0:
                        self._fire(i)
                return
            self.now = b
        self._count(solver)
        self.now, self.state = stop, np.array(solver.y)

    def _count(self, solver: Solver) -> None:
        self.counts["rhs"] += int(solver.nfev)
        self.counts["jacobians"] += int(solver.njev)
        self.counts["factorisations"] += int(solver.nlu)

    def _first_root(
        self, dense: integrate.DenseOutput, a: float, b: float
    ) -> tuple[float, int] | None:
        """(time, index) of the earliest guard that passes zero in [a, b]."""
        left = a
        times = a + (b - a) * _SHARES
        times[-1] = b
        states = np.ascontiguousarray(dense(times).T)
        for right, x in zip(times, states, strict=True):
            best: tuple[float, int] | None = None
            for i, event in enumerate(self.guards):
                value = event.guard(right, x)
                before = self.armed[i]
                if value * before < 0 and event.direction * before <= 0:
                    root = self._root(i, dense, left, right)
                    if best is None or root < best[0]:
                        best = root, i
                elif value != 0 and value * before <= 0:
                    self.armed[i] = np.sign(value)
            if best is not None:
                return best
            left = right
        return None

    def _root(self, index: int, dense: integrate.DenseOutput, a: float, b: float) -> float:
        event = self.guards[index]

        def guard(s: float) -> float:
            return event.guard(s, dense(s))

        low, high = guard(a), guard(b)
        if low == 0 or low * high > 0:
            # It left zero inside this look: when, if it was seen on its side at all?
            inside = [s for s in a + (b - a) * 0.5 ** np.arange(1, 53) if guard(s) * high < 0]
            if not inside and index == self.turned:
                self.now, self.state = a, np.array(dense(a))
                self._chatter(event, "it comes back within rounding of its own event")
            if not inside:
                return a  # rounding
            a = float(inside[0])
        return float(brentq(guard, a, b, xtol=4 * EPS * max(abs(a), abs(b), 1.0), rtol=4 * EPS))

    def _together(self, index: int) -> list[int]:
        """Other guards that pass zero at this same instant, to rounding."""
        found = []
        for i, event in enumerate(self.guards):
            value = event.guard(self.now, self.state) * self.armed[i]
            falls = event.direction * self.armed[i] <= 0 and self.armed[i] != 0
            if i != index and value <= 0 and falls and not event.level:
                found.append(i)
        return found

    def _just_fired(self, index: int) -> bool:
        return self.now - self.last[index] <= 16 * EPS * max(abs(self.now), 1.0)

    def _side(self, event: EventFunction) -> float:
        """The sign on which a guard leaves its own root: 0 where it simply goes on past zero.

        A reset that turns it back (a bounce) makes it leave on the side it came from. Seen past
        zero after that, it has come back within the step, and fires again.
        """
        x, t = self.state, self.now
        step = 1e-8 * (self.times[-1] - self.times[0])
        after = event.guard(t + step, x + step * self.system.rhs(t, x))
        change = (after - event.guard(t, x)) * event.direction
        return 0.0 if event.reset is None or not change < 0 else -float(event.direction)

    def _fire(self, index: int) -> None:
        event = self.guards[index]
        if self._just_fired(index):
            self._chatter(event, "it comes back within rounding of its own event")
        self.last[index] = self.now
        self._note(event)
        if event.reset is None:
            self.armed[index] = -self.armed[index] if event.direction == 0 else 0.0
        else:
            self.state = self._jump(event)
        self._settle(1, skip=index if event.reset is None or not event.level else -1)

    def _settle(self, fired: int = 0, skip: int = -1) -> None:
        """Fire what is already past zero, then look which side every guard is on."""
        again = True
        while again:
            again = False
            for event in self.guards:
                if event.level and event.guard(self.now, self.state) * event.direction >= 0:
                    fired += 1
                    if fired > self.cascade:
                        self._chatter(event, f"{fired} events at one instant")
                    self.counts["instant"] += 1
                    self._note(event)
                    if event.reset is not None:
                        self.state = self._jump(event)
                        again = True
                        break
        for i, event in enumerate(self.guards):
            if i != skip and self._just_fired(i) and not event.level:
                self.armed[i] = 0.0  # another one at the same instant: it must not fire again
            elif i != skip:
                self.armed[i] = float(np.sign(event.guard(self.now, self.state)))
            elif event.direction != 0:
                self.armed[i] = self._side(event)  # at its own root
                self.turned = i if self.armed[i] else -1

    def _jump(self, event: EventFunction) -> np.ndarray:
        state = np.asarray(event.reset(self.now, self.state), dtype=float)  # type: ignore[misc]
        if state.shape != self.state.shape or not np.all(np.isfinite(state)):
            raise IntegrationError(
                f"reset of event {event.name!r} returned shape {state.shape} or a value that is "
                "not finite",
                time=self.now,
                state_norm=float(np.linalg.norm(self.state)),
                step=0.0,
            )
        return state

    def _note(self, event: EventFunction) -> None:
        if self.events and self.now > self.events[-1].time:
            self.shortest = min(self.shortest, self.now - self.events[-1].time)
        self.events.append(Event(self.now, event.name, ""))
        self.counts["events"] += 1
        recent = self.events[-self.cascade - 1 :]
        window = 1e-6 * (self.times[-1] - self.times[0])
        if len(recent) > self.cascade and recent[-1].time - recent[0].time < window:
            self._chatter(event, f"{self.cascade} events within {window:.3g} s")

    def _chatter(self, event: EventFunction, what: str) -> None:
        raise IntegrationError(
            f"chattering: {what}, the last one {event.name!r}; "
            "separate the thresholds of the guards, or raise `cascade`",
            time=self.now,
            state_norm=float(np.linalg.norm(self.state)),
            step=0.0,
        )

    def _fail(self, message: str, solver: Solver) -> NoReturn:
        finite = solver.y[np.isfinite(solver.y)]
        raise IntegrationError(
            message,
            time=float(solver.t),
            state_norm=float(np.linalg.norm(finite)),
            step=float(getattr(solver, "h_abs", 0.0) or 0.0),
        )

    def _record(self, end: float, dense: integrate.DenseOutput | None, begin: float = 0.0) -> None:
        """Samples up to `end` and the averages of eta and u over [begin, end]."""
        times = self.times
        if dense is None:
            self.x[0] = self.state
            return
        a = float(begin)
        while True:
            last = self.sample == len(times) - 1
            b = end if last else min(end, float(times[self.sample + 1]))
            if b > a and not last and self.averages:
                self._average(dense, a, b)
            if last or times[self.sample + 1] > end:
                return
            self.sample += 1
            self.x[self.sample] = dense(float(times[self.sample]))
            a = b

    def _average(self, dense: integrate.DenseOutput, a: float, b: float) -> None:
        k, system = self.sample, self.system
        weight = 0.5 * (b - a) / (self.times[k + 1] - self.times[k])
        times = 0.5 * (a + b) + 0.5 * (b - a) * _NODES
        states = np.ascontiguousarray(dense(times).T)
        for s, x, w in zip(times, states, _WEIGHTS, strict=True):
            if self.eta.shape[1]:
                self.eta[k] += weight * w * system.eta(s, x)
            if self.forced:
                self.u[k] += weight * w * system.u(s, x)
