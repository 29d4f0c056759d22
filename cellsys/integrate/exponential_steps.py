"""Exponential Runge-Kutta steps of order 1 to 4 for x' = L x + N(t, x).

    order 1   x+ = e^{hL} x + h phi_1(hL) N(t, x)
    order 2-4 the ETD schemes of Cox and Matthews (J. Comput. Phys. 176, 2002, eq. 22-29)

L = W_x is the constant linear part; the phi functions are those of the matrix itself, found once
for every step length in use.
"""

from __future__ import annotations

import time as clock
from itertools import pairwise

import numpy as np
import scipy.linalg as sla

from cellsys.errors import IntegrationError, ParameterError
from cellsys.integrate.solution import Solution
from cellsys.integrate.stepping import cuts
from cellsys.system import OdeSystem

LARGEST = 2000  # states: e^{hL} is a full matrix


def phi_matrices(L: np.ndarray, count: int) -> list[np.ndarray]:
    """phi_0 .. phi_count of a matrix, from one exponential of a larger one.

    exp([[L, I, 0], [0, 0, I], [0, 0, 0]]) has phi_0, phi_1, phi_2 in its first row.
    """
    n = len(L)
    big = np.zeros((n * (count + 1), n * (count + 1)))
    big[:n, :n] = L
    big[:-n, n:] += np.eye(n * count)
    row = sla.expm(big)[:n]
    return [row[:, k * n : (k + 1) * n] for k in range(count + 1)]


_Phis = tuple[list[np.ndarray], list[np.ndarray]]  # of a step, and of half of it


class ExponentialStepper:
    """Fixed steps over the samples of one run."""

    def __init__(self, system: OdeSystem, step: float, order: int) -> None:
        if system.states.size > LARGEST:
            raise ParameterError(
                f"Exponential needs full {system.states.size} x {system.states.size} matrices; "
                f"above {LARGEST} states use RKC or LinearlyImplicit"
            )
        self.system, self.step, self.order = system, step, order
        # Rows and columns of L that are zero need no exponential: phi_k is 1/k! there.
        self.L = system.W_x.toarray()
        self.live = np.flatnonzero(np.any(self.L != 0, axis=0) | np.any(self.L != 0, axis=1))
        self.kept: dict[float, _Phis] = {}
        self.counts = dict.fromkeys(("steps", "rejected", "rhs", "jacobians", "factorisations"), 0)

    def solve(self, t: np.ndarray, x0: np.ndarray, averages: bool) -> Solution:
        """Samples and averages over the grid `t`; no step crosses a stop point."""
        began, system = clock.perf_counter(), self.system
        n, n_eta, T = system.states.size, system.auxiliaries.size, len(t)
        stops = np.unique(np.asarray(system.stop_points(), dtype=float))
        x = np.empty((T, n))
        x[0] = x0
        eta, u = np.zeros((max(T - 1, 0), n_eta)), np.zeros((max(T - 1, 0), n))
        state = np.array(x0, dtype=float)
        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(T - 1):
                times = cuts(float(t[k]), float(t[k + 1]), self.step, stops)
                for a, b in pairwise(times):
                    before, state = state, self._take(float(a), float(b), state)
                    self.counts["steps"] += 1
                    if not np.isfinite(state.sum()):
                        self._fail(before, float(b), float(b - a))
                    if averages:
                        share = (b - a) / (t[k + 1] - t[k])
                        middle = 0.5 * (a + b), 0.5 * (before + state)
                        eta[k] += share * system.eta(*middle)
                        u[k] += share * system.u(*middle)
                x[k + 1] = state
        statistics = {**self.counts, "solve_time": clock.perf_counter() - began}
        return Solution(x=x, eta=eta, u=u, statistics=statistics)

    def _fail(self, before: np.ndarray, t: float, h: float) -> None:
        raise IntegrationError(
            "Exponential: the state is not finite; use a smaller step",
            time=t,
            state_norm=float(np.linalg.norm(before)),
            step=h,
        )

    def _phi(self, h: float) -> _Phis:
        # Steps that differ by rounding share their matrices.
        key = float(f"{h:.13e}")
        if key not in self.kept:
            sub = key * self.L[np.ix_(self.live, self.live)]
            needed = 3 if self.order >= 3 else self.order
            self.kept[key] = phi_matrices(sub, needed), phi_matrices(0.5 * sub, 1)
            self.counts["factorisations"] += 1
        return self.kept[key]

    def _apply(self, matrices: list[np.ndarray], k: int, v: np.ndarray) -> np.ndarray:
        out = v / (1.0, 1.0, 2.0, 6.0)[k]
        out[self.live] = matrices[k] @ v[self.live]
        return out

    def _rest(self, t: float, x: np.ndarray) -> np.ndarray:
        self.counts["rhs"] += 1
        return self.system.W_eta @ self.system.eta(t, x) + self.system.u(t, x)

    def _take(self, a: float, b: float, x: np.ndarray) -> np.ndarray:
        h = b - a
        full, half = self._phi(h)
        # The last stage takes the right-hand side's limit from the left at a stop point.
        end, middle = float(np.nextafter(b, a)), a + 0.5 * h
        N0 = self._rest(a, x)
        Ex = self._apply(full, 0, x)
        euler = Ex + h * self._apply(full, 1, N0)
        if self.order == 1:
            return euler
        if self.order == 2:
            return euler + h * self._apply(full, 2, self._rest(end, euler) - N0)
        Exh = self._apply(half, 0, x)
        x1 = Exh + 0.5 * h * self._apply(half, 1, N0)
        N1 = self._rest(middle, x1)
        if self.order == 3:
            x2 = Ex + h * self._apply(full, 1, 2.0 * N1 - N0)
            N2 = self._rest(end, x2)
            N1 = 2.0 * N1
        else:
            x2 = Exh + 0.5 * h * self._apply(half, 1, N1)
            N2 = self._rest(middle, x2)
            x3 = self._apply(half, 0, x1) + 0.5 * h * self._apply(half, 1, 2.0 * N2 - N0)
            N1, N2 = N1 + N2, self._rest(end, x3)
        # Both end with the Lagrange quadrature of N over the step through 0, h/2 and h.
        return (
            Ex
            + h * self._apply(full, 1, N0)
            + h * self._apply(full, 2, -3.0 * N0 + 2.0 * N1 - N2)
            + h * self._apply(full, 3, 4.0 * N0 - 4.0 * N1 + 4.0 * N2)
        )
