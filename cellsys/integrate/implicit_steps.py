"""Linearly implicit steps with a kept, over-estimated tangent: what their methods share.

From the extrapolated state x* = x + h v (v the last step's velocity) one correction

    (a C/h + M) delta = F(x*) - C v ,      x+ = x* + delta

is made, with M >= -dF/dx, factorised once and kept while it still bounds the tangent. The
derivative that the method sees at x+ is v + a delta/h: with a = 1 this is (x+ - x)/h, implicit
Euler, and a method of second order differs by its `a` and by how internal states follow. A
further correction starts from x+ instead of x*. Pressure of a closed membrane adds a rank-one
term by the Woodbury identity.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from cellsys.arguments import checked
from cellsys.errors import ParameterError
from cellsys.integrate.stepping import Stepper, check_step
from cellsys.overdamped import MajorantBlock, OverdampedSystem, Placed, Rounded
from cellsys.system import OdeSystem

_STILL = 1e-9  # um/s: nodes that are slower are at rest
_ROUNDING = 1e-9  # of a step: times up to 1e6 s have their digits up to 1e-10 s


@checked
@dataclass(frozen=True, kw_only=True)
class ImplicitMethod:
    """What the linearly implicit methods are told; see `LinearlyImplicit` for the words."""

    step: float
    refresh: int = 30
    corrections: int = 3
    tolerance: float = 0.05
    largest_move: float = 0.2

    def __post_init__(self) -> None:
        name = type(self).__name__
        check_step(name, self.step)
        for item in ("refresh", "corrections"):
            if getattr(self, item) < 1:
                raise ParameterError(f"{name}.{item} must be >= 1, got {getattr(self, item)!r}")
        for item in ("tolerance", "largest_move"):
            if not getattr(self, item) > 0:
                raise ParameterError(f"{name}.{item} must be > 0, got {getattr(self, item)!r}")

    def overdamped(self, system: OdeSystem) -> OverdampedSystem:
        """The system, if it has what an implicit step needs; ParameterError otherwise."""
        if not isinstance(system, OverdampedSystem):
            raise ParameterError(
                f"{type(self).__name__} needs a system with drag and a majorant of its tangent; "
                "use CVODES or ExplicitEuler for this one"
            )
        return system


@dataclass(kw_only=True)
class _Factor:
    """A kept factorisation of C/span + M on one block of states, span = h/a.

    `index` is (k,) for one coordinate, (k, c) for c that share the factorisation; `where` is the
    same as a slice, where the states lie one after the other.
    """

    index: np.ndarray
    where: slice | np.ndarray
    key: object
    span: float
    solve: Callable[[np.ndarray, np.ndarray], None]  # from a whole vector into another one

    def square(self, vector: np.ndarray) -> float:
        """Sum of squares of the block's entries."""
        part = vector[self.where].ravel()
        return part.dot(part)


def _placed(
    solve: Callable[[np.ndarray], np.ndarray], index: np.ndarray
) -> Callable[[np.ndarray, np.ndarray], None]:
    """A solver of a block as one of whole vectors."""
    if isinstance(solve, Placed):
        return solve.placed(index)

    def through(rhs: np.ndarray, out: np.ndarray) -> None:
        out[index] = solve(rhs[index])

    return through


def _nothing(rhs: np.ndarray, out: np.ndarray) -> None:
    """A block that is held moves nowhere."""


def _lu(matrix: sp.csc_array) -> Callable[[np.ndarray], np.ndarray]:
    """SuperLU in its symmetric mode."""
    factor = spla.splu(
        sp.csc_matrix(matrix),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    return factor.solve


class ImplicitStepper(Stepper):
    """A run by linearly implicit Euler; methods of another order replace `weight` and the like."""

    system: OverdampedSystem
    rounds = False  # whether a correction may be right to some 1e-7 only

    def __init__(
        self,
        method: ImplicitMethod,
        system: OverdampedSystem,
        t0: float,
        x0: np.ndarray,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(system, t0, x0, rng, method.step)
        self.method = method
        self.drag = system.drag()
        self.moving = np.isfinite(self.drag) & (self.drag > 0)
        self.force_scale = np.where(self.moving, self.drag, 0.0)
        self.is_moving = self.moving.astype(float)
        self.velocity = np.zeros(system.states.size)
        self.kinks = frozenset(self.stops.tolist())
        self.kept_dt, self.kept_over = 0.0, (self.force_scale, self.is_moving)
        self.factors: dict[str, _Factor] = {}
        self.since_look = method.refresh
        system.forget()

    def memory(self) -> dict[str, np.ndarray]:
        # The next interval starts with a fresh look at the tangent, here and after a resume.
        self.since_look = self.method.refresh
        self.factors.clear()
        self.system.forget()
        return {"velocity": self.velocity}

    def restore(self, memory: dict[str, np.ndarray]) -> None:
        self.velocity = memory["velocity"].copy()

    # What a method of another order replaces

    def weight(self, t: float, x: np.ndarray, dt: float, happened: bool) -> float:
        """The method's `a` of the step from (t, x), which may follow a discrete change."""
        return 1.0

    def predicted(self, t: float, x: np.ndarray, dt: float) -> np.ndarray:
        """x*, in a new array; after a kink the last velocity says nothing."""
        return x.copy() if t in self.kinks else x + dt * self.velocity

    def add_history(self, rate: np.ndarray) -> None:
        """Add what the method's derivative owes to earlier steps to F/C - a (x+ - x)/h."""

    def advance_internal(self, t: float, x: np.ndarray, end: np.ndarray, dt: float) -> None:
        """Fill the internal states of `end`, whose nodes are given."""
        self.system.advance_internal(t, x, end, dt)

    def law_time(self, t: float) -> float:
        """When the laws of a step that ends at t are evaluated."""
        return t

    def accepted(
        self, x: np.ndarray, eta: np.ndarray, u: np.ndarray, velocity: np.ndarray, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Averages of eta and u over a step that is taken from x, from those at its end."""
        self.velocity = velocity
        return eta, u

    # The step

    def _look(self, t: float, x: np.ndarray, dt: float, span: float) -> None:
        for block in self.system.majorant(t, x, dt):
            kept = self.factors.get(block.name)
            if kept is None or kept.key != block.key or not _same(kept.span, span):
                self.factors[block.name] = self._factorise(block, span)
                self.statistics["jacobians"] += 1
                self.statistics["factorisations"] += 1
        self.since_look = 0

    def _factorise(self, block: MajorantBlock, span: float) -> _Factor:
        keep = self.moving[block.entries[:, 0]]
        index = block.entries[keep]
        if not index.size:  # all of it is held
            return _Factor(index=index, where=slice(0, 0), key=block.key, span=span, solve=_nothing)
        matrix = block.matrix()
        if not keep.all():
            matrix = sp.csc_array(matrix)[:, keep][keep]
        matrix = sp.csc_array(matrix + sp.diags_array(self.drag[index[:, 0]] / span))
        solve = (block.factor or _lu)(matrix)
        if self.rounds and isinstance(solve, Rounded):
            solve = solve.rounded()
        if index.shape[1] == 1:
            index = index[:, 0]
        first = int(index.min(initial=0))
        in_line = np.array_equal(index.ravel(), np.arange(first, first + index.size))
        where = slice(first, first + index.size) if in_line else index
        whole = _placed(solve, index)
        return _Factor(index=index, where=where, key=block.key, span=span, solve=whole)

    def _solve(self, rhs: np.ndarray, low_rank: tuple) -> np.ndarray:
        """(C/span + M + sum of k g g^T)^-1 rhs by kept factors and the Woodbury identity.

        u - Z (K^-1 + G^T Z)^-1 G^T u with u = M^-1 rhs, Z = M^-1 G.
        """
        out = np.zeros_like(rhs)
        for factor in self.factors.values():
            if factor.index.size:
                factor.solve(rhs, out)
                self.statistics["solves"] += 1
        if not low_rank:
            return out
        G = np.zeros((len(low_rank), rhs.size))
        Z = np.zeros_like(G)
        for g, z, item in zip(G, Z, low_rank, strict=True):
            g[item.entries] = item.direction
            for factor in self.factors.values():
                if factor.index.size and g[factor.where].any():
                    factor.solve(g, z)
        small = G @ Z.T
        for k, item in enumerate(low_rank):
            small[k, k] += 1.0 / item.stiffness
        seen = G @ out
        if len(seen) == 1:
            return out - (seen[0] / small[0, 0]) * Z[0]
        return out - sla.solve(small, seen, assume_a="pos") @ Z

    def take_step(self, t: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
        done = self._try(t, dt)
        if done is not None:
            return done
        self.statistics["rejected"] += 1
        if dt < 2.0**-10 * self.step:
            self.fail(
                t,
                dt,
                f"{type(self.method).__name__}: a node moves more than largest_move = "
                f"{self.method.largest_move:g} um even in a step halved ten times; use a smaller "
                "step, or start nearer to rest",
            )
        # Two halves, so that the logged average still belongs to the whole step.
        eta_1, u_1 = self.take_step(t, 0.5 * dt)
        eta_2, u_2 = self.take_step(t + 0.5 * dt, 0.5 * dt)
        return 0.5 * (eta_1 + eta_2), 0.5 * (u_1 + u_2)

    def _try(self, t: float, dt: float) -> tuple[np.ndarray, np.ndarray] | None:
        system, start = self.system, self.x
        x, happened = system.between_steps(t, start, dt, self.rng)
        span = dt / self.weight(t, x, dt, bool(happened))
        if self.since_look >= self.method.refresh or happened or self._span_changed(span):
            self._look(t, x, dt, span)
        self.since_look += 1
        end = self.predicted(t, x, dt)
        t_end, (inertia, per_second) = self.law_time(t + dt), self._over(dt)
        for correction in range(self.method.corrections):
            self.advance_internal(t, x, end, dt)
            eta, u = system.efforts(t_end, end), system.u(t_end, end)
            self.statistics["rhs"] += 1
            residual = system.rate(end, eta, u)
            if not isfinite(np.add.reduce(residual)):
                if correction:
                    return None  # corrections run away from a step that is too long
                self._not_finite(residual, t_end, dt)
            move = end - x
            # C (F/C - v - a delta/h), in place: the rate is not needed again.
            residual -= move / span
            self.add_history(residual)
            residual *= self.force_scale
            delta = self._solve(residual, system.low_rank(t_end, end))
            end = end + delta
            move += delta
            # What is left over, and the force that moved the nodes, both in place.
            delta *= self.force_scale / span if span != dt else inertia
            residual -= delta
            move *= inertia
            if self._explained(residual, move):
                break
        velocity = end - x
        velocity *= per_second
        largest = dt * float(np.maximum.reduce(np.abs(velocity), initial=0.0))
        if largest > self.method.largest_move and isfinite(largest):
            return None
        self.advance_internal(t, x, end, dt)
        self.events.extend(happened)
        self.x = end
        eta, u = self.accepted(x, eta, u, velocity, dt)
        if self.averages:
            for states, rates in system.internal_blocks():
                eta[rates] = (end[states] - x[states]) / dt
        return eta, u

    def _over(self, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Drag over dt and 1/dt of the states that move; kept while dt stays."""
        if self.kept_dt != dt:
            self.kept_dt, self.kept_over = dt, (self.force_scale / dt, self.is_moving / dt)
        return self.kept_over

    def _not_finite(self, rate: np.ndarray, t: float, dt: float) -> None:
        bad = np.flatnonzero(~np.isfinite(rate))
        name = self.system.states.names[bad[0]] if bad.size else "some state"
        method = type(self.method).__name__
        self.fail(t, dt, f"{method}: the rate of {name} is not finite; use a smaller step")

    def _explained(self, left: np.ndarray, force: np.ndarray) -> bool:
        """Whether every block leaves at most `tolerance` of its force unexplained."""
        for factor in self.factors.values():
            rest = factor.square(left)
            if rest > self.method.tolerance**2 * factor.square(force):
                # Nodes at rest leave rounding over, which no correction explains.
                if rest > _STILL**2 * factor.square(self.force_scale):
                    return False
        return True

    def _span_changed(self, span: float) -> bool:
        for factor in self.factors.values():
            if not _same(factor.span, span):
                return True
        return False


def _same(a: float, b: float) -> bool:
    """Whether two spans differ by the rounding of their ends only."""
    return abs(a - b) <= _ROUNDING * b
