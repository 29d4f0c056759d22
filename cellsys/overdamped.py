"""`OverdampedSystem`: nodes with drag and internal states that follow them.

What a linearly implicit integrator needs beyond the right-hand side of an `OdeSystem`: drag,
over-estimates of the tangent, stiff directions, states that are advanced by themselves.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np
import scipy.sparse as sp

from cellsys.system import Event, OdeSystem


class MajorantBlock(NamedTuple):
    """An over-estimate of the tangent: SPD `matrix()` (k, k) on each column of `entries` (k, c).

    `factor(matrix)`, if given, returns a solver for these; `matrix` is called when `key` changes.
    """

    name: str
    entries: np.ndarray
    matrix: Callable[[], sp.csc_array]
    key: object
    factor: Callable[[sp.csc_array], Callable] | None = None


@runtime_checkable
class Placed(Protocol):
    """A solver that reads and writes entries of longer vectors itself, without copies."""

    def placed(self, index: np.ndarray) -> Callable[[np.ndarray, np.ndarray], None]:
        """``solve(rhs, out)`` of the entries `index` (k,) or (k, c)."""


@runtime_checkable
class Rounded(Protocol):
    """A solver that has a faster one, right to some 1e-7."""

    def rounded(self) -> Callable[[np.ndarray], np.ndarray]:
        """That one."""


class RankOne(NamedTuple):
    """A stiff direction k g g^T (pressure of a closed membrane), g (k,) on the states `entries`."""

    entries: np.ndarray
    stiffness: float
    direction: np.ndarray


class OverdampedSystem(OdeSystem, ABC):
    """An `OdeSystem` of nodes with drag, and of internal states that follow them.

        C dx_i/dt = F_i(x)      nodes, through nodal force ports (constant W_eta = I/C)
        ds/dt = r(x, v, s)      internal states (bonds, polarity), rates in blocks of eta

    It gives a linearly implicit integrator what it needs beyond the right-hand side.
    """

    _made_by: ClassVar[str] = "cs.build(scene) of a disc; its tangent has a majorant"

    @abstractmethod
    def drag(self) -> np.ndarray:
        """Drag of each state (n,), pN s/um; 0 marks internal states, inf clamped nodes."""

    @abstractmethod
    def efforts(self, t: float, x: np.ndarray) -> np.ndarray:
        """Like `eta`, with the blocks that hold rates of internal states left at zero."""

    def rate(self, x: np.ndarray, eta: np.ndarray, u: np.ndarray) -> np.ndarray:
        """W_x x + W_eta eta + u (n,), in a new array."""
        return self.W_eta @ eta + u + (self.W_x @ x if self.W_x.nnz else 0.0)

    def laws(self, t: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """eta, u and the rate that they give, W_x x + W_eta eta + u."""
        eta, u = self.eta(t, x), self.u(t, x)
        return eta, u, self.rate(x, eta, u)

    def forget(self) -> None:
        """Drop what is kept between looks at the tangent: a run must not see an earlier one."""

    @abstractmethod
    def internal_blocks(self) -> tuple[tuple[slice, slice], ...]:
        """(slice of x, slice of eta) of every internal state and its rate."""

    @abstractmethod
    def advance_internal(self, t: float, x: np.ndarray, x_new: np.ndarray, dt: float) -> None:
        """Fill the internal states of `x_new`, given its node positions and the old state."""

    def advance_by_middle(
        self, t: float, x: np.ndarray, middle: np.ndarray, x_new: np.ndarray, dt: float
    ) -> None:
        """Like `advance_internal` to second order; `middle` is what is foreseen of half a step on.

        By default Richardson's extrapolation of `advance_internal`: twice the result of two
        halves, less that of the whole step.
        """
        self.advance_internal(t, x, x_new, dt)
        whole = [x_new[states].copy() for states, _ in self.internal_blocks()]
        self.advance_internal(t, x, middle, 0.5 * dt)
        self.advance_internal(t + 0.5 * dt, middle, x_new, 0.5 * dt)
        for (states, _), once in zip(self.internal_blocks(), whole, strict=True):
            x_new[states] = 2.0 * x_new[states] - once

    @abstractmethod
    def majorant(self, t: float, x: np.ndarray, dt: float) -> tuple[MajorantBlock, ...]:
        """Sparse SPD over-estimates of -dF/dx; together they cover every node state once."""

    def low_rank(self, t: float, x: np.ndarray) -> tuple[RankOne, ...]:
        """Stiff directions to be added to the majorant by the Woodbury identity."""
        return ()

    def between_steps(
        self, t: float, x: np.ndarray, dt: float, rng: np.random.Generator
    ) -> tuple[np.ndarray, tuple[Event, ...]]:
        """Discrete changes (binding, rupture) at the start of a step: new state and events."""
        return x, ()
