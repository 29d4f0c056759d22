"""`SymbolicLoop`: a loop as CasADi expressions with names, and the steps that shooting takes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg as sla
from scipy.sparse.csgraph import connected_components

from cellsys.contracts import Integrator
from cellsys.errors import ParameterError
from cellsys.integrate.symbolic import SymbolicMethod
from cellsys.shown import Shown
from cellsys.units import real_number

if TYPE_CHECKING:
    import casadi as ca


@dataclass(frozen=True, eq=False, kw_only=True)
class SymbolicLoop(Shown):
    """A loop as CasADi expressions. Made by `cs.symbolic`.

    Attributes
    ----------
    states, inputs, parameters, outputs : tuple of str
        Names of the entries of x, u, p and y.
    x, u, p, t : casadi.MX
        Symbols; t is s since contact, which only a plant on a clock looks at.
    rhs, y : casadi.MX
        dx/dt, or x a step later where `dt` is a number; and the outputs z, p, d of every cell
        and, where it is known, its place (um).
    dt : float or None
        s, of a loop with a step of its own.
    linear : (n, n) or None
        The constant matrix of the linear part of `rhs`, whose flow `step` takes exactly; None
        where it holds parameters. `rest` is that of `rhs` which it is not.
    place : casadi.MX or None
        Places of all cells (2 K, 1), um, where they are known.
    moved : casadi.MX or None
        The part of `rhs` without polarities, of a loop with a step of its own.
    wide : bool
        Whole vectors are summed over (the nodes of a sensor's map): not to be written out in
        scalars.
    x0, u0, p0 : arrays
        The loop's own start, inputs (amplitude 1, heading at the start, loads 0) and parameters.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    x: ca.MX
    u: ca.MX
    p: ca.MX
    t: ca.MX
    rhs: ca.MX
    y: ca.MX
    dt: float | None = None
    linear: np.ndarray | None = None
    rest: ca.MX | None = None
    place: ca.MX | None = None
    moved: ca.MX | None = None
    wide: bool = False
    x0: np.ndarray
    u0: np.ndarray
    p0: np.ndarray
    _kept: dict[object, ca.Function] = field(default_factory=dict, repr=False)

    def function(self) -> ca.Function:
        """(x, u, p) -> (rhs, y); of a loop with a step of its own (x, u, p, t) -> (xf, y)."""
        import casadi as ca

        symbols, names = [self.x, self.u, self.p], ["x", "u", "p"]
        if self.dt is not None:
            symbols, names = [*symbols, self.t], [*names, "t"]
        rate = "rhs" if self.dt is None else "xf"
        return ca.Function("loop", symbols, [self.rhs, self.y], names, [rate, "y"])

    def integrator(self, method: Integrator, step: float) -> ca.Function:
        """CasADi's integrator over `step` seconds with u and p held: ``F(x0=, u=, p=)["xf"]``.

        Raises
        ------
        ParameterError
            For a method without derivatives: CVODES, IDAS, Collocation and RungeKutta4 have them;
            and for a loop with a step of its own.
        """
        import casadi as ca

        self._refuse_steps("integrator()")
        if not isinstance(method, SymbolicMethod):
            raise ParameterError(
                f"{type(method).__name__} has no derivatives; use CVODES, IDAS, Collocation or "
                "RungeKutta4"
            )
        h = _seconds(step)
        problem = {"x": self.x, "u": self.u, "p": self.p, "ode": self.rhs}
        return ca.integrator("loop", method.plugin, problem, 0.0, h, method.options(h))

    def rk4(self, step: float) -> ca.Function:
        """One step of the classical Runge-Kutta method, (x, u, p) -> x a step later."""
        import casadi as ca

        self._refuse_steps("rk4()")
        f, h = ca.Function("f", [self.x, self.u, self.p], [self.rhs]), _seconds(step)
        k1 = f(self.x, self.u, self.p)
        k2 = f(self.x + h / 2 * k1, self.u, self.p)
        k3 = f(self.x + h / 2 * k2, self.u, self.p)
        k4 = f(self.x + h * k3, self.u, self.p)
        after = self.x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return ca.Function("rk4", [self.x, self.u, self.p], [after], ["x", "u", "p"], ["xf"])

    def step(self, span: float) -> ca.Function:
        """(x, u, p, t) -> xf, `span` seconds later with u held: what shooting is made of.

        A loop with a step of its own takes as many as fit. Elsewhere it is one step of order 4
        whose linear part is exact, however stiff (exponential Runge-Kutta of Cox and Matthews,
        J. Comput. Phys. 176, 2002), or, where that part holds parameters, Runge-Kutta steps
        short of the stability limit.

        Raises
        ------
        ParameterError
            `span` is no whole number of the loop's own steps.
        """
        import casadi as ca

        h = _seconds(span)
        if h in self._kept:
            return self._kept[h]
        symbols = [self.x, self.u, self.p, self.t]
        if self.dt is not None:
            count = round(h / self.dt)
            if count < 1 or abs(count * self.dt - h) > 1e-9 * h:
                raise ParameterError(
                    f"span must be a multiple of the loop's step {self.dt:g} s, got {span!r}"
                )
            once = ca.Function("once", symbols, [self.rhs])
            after = self.x
            for i in range(count):
                after = once(after, self.u, self.p, self.t + i * self.dt)
        elif self.linear is None or self.rest is None:
            after = self._explicit(h)
        else:
            after = self._exponential(self.linear, self.rest, h)
        kept = ca.Function("step", symbols, [after], ["x", "u", "p", "t"], ["xf"])
        self._kept[h] = kept
        return kept

    def _explicit(self, h: float) -> ca.MX:
        import casadi as ca

        slope = ca.Function("J", [self.x, self.u, self.p], [ca.jacobian(self.rhs, self.x)])
        size = float(np.linalg.norm(np.asarray(slope(self.x0, self.u0, self.p0)), 2))
        count = max(1, int(np.ceil(2.0 * h * size)))  # the limit of order 4 is 2.8
        once, after = self.rk4(h / count), self.x
        for _ in range(count):
            after = once(after, self.u, self.p)
        return after

    def _exponential(self, L: np.ndarray, rest: ca.MX, h: float) -> ca.MX:
        import casadi as ca

        n, k = len(L), self.x.numel()
        E, one, two, three = _phis(h * L)
        half, phi_half = _phis(0.5 * h * L)[:2]
        N = ca.Function("N", [self.x, self.u, self.p], [ca.vertcat(rest, self.rhs[n:])])

        def act(M: np.ndarray, v: ca.MX, other: float) -> ca.MX:
            # `other`: what M is on the states without a linear part, the polarities.
            return ca.vertcat(ca.mtimes(ca.sparsify(ca.DM(M)), v[:n]), other * v[n:k])

        x, w = self.x, (one - 3 * two + 4 * three, 2 * two - 4 * three, 4 * three - two)
        N0 = N(x, self.u, self.p)
        a = act(half, x, 1.0) + 0.5 * h * act(phi_half, N0, 1.0)
        Na = N(a, self.u, self.p)
        b = act(half, x, 1.0) + 0.5 * h * act(phi_half, Na, 1.0)
        Nb = N(b, self.u, self.p)
        c = act(half, a, 1.0) + 0.5 * h * act(phi_half, 2 * Nb - N0, 1.0)
        sums = (N0, Na + Nb, N(c, self.u, self.p))
        parts = (act(M, v, o) for M, v, o in zip(w, sums, (1 / 6, 1 / 3, 1 / 6), strict=True))
        return act(E, x, 1.0) + h * sum(parts, ca.MX.zeros(k, 1))

    def _refuse_steps(self, what: str) -> None:
        if self.dt is not None:
            raise ParameterError(
                f"{what} is for loops in continuous time; this one steps by {self.dt:g} s: "
                "function() is its step"
            )

    def __str__(self) -> str:
        kind = "" if self.dt is None else f", step {self.dt:g} s"
        return (
            f"symbolic loop: {len(self.states)} states, inputs {list(self.inputs)}, parameters "
            f"{list(self.parameters)}{kind}"
        )


def _phis(M: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """exp, phi_1, phi_2 and phi_3 of M, phi_1(z) = (e^z - 1)/z and so on, block by block.

    Of each block from one exponential of [[M, I, 0, 0], [0, 0, I, 0], ...].
    """
    out = [np.zeros_like(M, dtype=float) for _ in range(4)]
    count, block = connected_components(np.abs(M) > 0, directed=False)
    for k in range(count):
        rows = np.flatnonzero(block == k)
        n, at = len(rows), np.ix_(rows, rows)
        whole = np.zeros((4 * n, 4 * n))
        whole[:n, :n] = M[at]
        whole[: 3 * n, n:] += np.eye(3 * n)
        found = sla.expm(whole)[:n]
        for i, part in enumerate(out):
            part[at] = found[:, i * n : (i + 1) * n]
    return out[0], out[1], out[2], out[3]


def _seconds(step: float) -> float:
    h = real_number(step, "step")
    if not (np.isfinite(h) and h > 0):
        raise ParameterError(f"step must be > 0 s, got {step!r}")
    return h
