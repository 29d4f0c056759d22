"""Coupled cells come apart: an exact linear flow with headings held, and headings that turn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from cellsys.loop import ClosedLoop
from cellsys.population.headings import commands, sensed, steering, turn
from cellsys.population.poleset import PoleSet
from cellsys.system import Block, SymbolicForm

if TYPE_CHECKING:
    import casadi as ca


class NamedCoupling(Protocol):
    """A coupling with a name."""

    @property
    def name(self) -> str:
        """What messages call it."""


class BlamedCells(Protocol):
    """What an error says of cells that grow beyond all bounds."""

    @property
    def n_cells(self) -> int:
        """K."""

    @property
    def coupling(self) -> NamedCoupling:
        """Which coupling."""

    def pole_set(self) -> PoleSet:
        """Whose abscissa is the growth rate."""


class LinearFlow(Protocol):
    """Exact flow of cells under held commands, and what their sensors read of its state."""

    n_inputs: int

    def flow(self, x: np.ndarray, c: np.ndarray, h: float) -> np.ndarray:
        """x after h with the commands c (K, n_c) held."""

    def sense(self, x: np.ndarray) -> np.ndarray:
        """S_d z (K, 3)."""


class CellFlows:
    """The two exact flows of coupled cells, for `Splitting`.

    Parameters
    ----------
    cells : CoupledCells or PortedCells
        For its name, number and growth rate in an error.
    flow : LinearFlow
    loop : ClosedLoop or None
        None: nothing turns.
    shape : tuple
        Of the linear flow's state, first in that of the system.
    """

    def __init__(
        self, cells: BlamedCells, flow: LinearFlow, loop: ClosedLoop | None, shape: tuple[int, ...]
    ) -> None:
        self.cells, self.linear, self.loop, self.shape = cells, flow, loop, shape
        self.turns, self.size = loop is not None, int(np.prod(shape))
        self.still = np.zeros((cells.n_cells, flow.n_inputs))

    def parts(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State of the linear flow, and p (K, 3), (K, 0) where nothing turns."""
        K = self.cells.n_cells
        p = x[self.size :].reshape(K, 3) if self.turns else np.zeros((K, 0))
        return x[: self.size].reshape(self.shape), p

    def whole(self, plant: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Inverse of `parts`."""
        return np.concatenate([plant.ravel(), p.ravel()])

    def drift(self, plant: np.ndarray, p: np.ndarray, h: float) -> np.ndarray:
        """The linear flow over h with p held."""
        c = self.still if self.loop is None else commands(self.loop, p)
        return self.linear.flow(plant, c, h)

    def sensed(self, plant: np.ndarray) -> np.ndarray:
        """d (K, 3); of cells with a loop."""
        return sensed(steering(self.loop), self.linear.sense(plant))

    def turn(self, plant: np.ndarray, p: np.ndarray, h: float) -> np.ndarray:
        """Every polarity turned exactly with the cells held."""
        return turn(steering(self.loop).controller, p, self.sensed(plant), h)

    def blame(self) -> str:
        """The growth rate, or that no pole grows."""
        rate = self.cells.pole_set().abscissa
        if rate > 0:
            return (
                f"the coupled system is unstable and grows at {rate:.6g} 1/s "
                f"({self.cells.coupling.name}, {self.cells.n_cells} cells); stability() names the "
                "blocks"
            )
        return "the run is not finite although no pole grows: ill-conditioned poles"


def polarities(n_cells: int) -> Block:
    """State block of every cell's polarity."""
    return Block("p", (n_cells, 3), "1", role="controller", kind="internal")


def symbolic_cells(
    loop: ClosedLoop | None,
    n_cells: int,
    rate: tuple[np.ndarray, np.ndarray, np.ndarray],
    read: tuple[np.ndarray, np.ndarray],
) -> SymbolicForm[ca.MX]:
    """CasADi form of x' = M x + D c(p) + b with one loop on each cell.

    Parameters
    ----------
    loop : ClosedLoop or None
        None: c = 0 and no p.
    n_cells : int
    rate : M (n, n), D (n, K n_c), b (n,)
    read : T (K m, n), offset (K m,)
        z = T x + offset of all cells, one after the other.
    """
    import casadi as ca

    M, D, b = rate
    n, t = len(M), ca.MX.sym("t")
    if loop is None:
        x = ca.MX.sym("x", n)
        return SymbolicForm(t, x, _dm(M) @ x + ca.DM(b), ca.MX.zeros(0, 1))
    x = ca.MX.sym("x", n + 3 * n_cells)
    T, offset = read
    m = len(T) // n_cells
    one_z, one_p = ca.SX.sym("z", m), ca.SX.sym("p", 3)
    turning = loop.controller.rate(one_p, loop.sensed(one_z))
    one = ca.Function("cell", [one_z, one_p], [ca.vcat([loop.commands(one_p)]), ca.vcat([turning])])
    every = one.map(n_cells)
    z = _dm(T) @ x[:n] + ca.DM(offset)
    c, turns = every(ca.reshape(z, m, n_cells), ca.reshape(x[n:], 3, n_cells))
    xdot = ca.vertcat(_dm(M) @ x[:n] + _dm(D) @ ca.vec(c) + ca.DM(b), ca.vec(turns))
    return SymbolicForm(t, x, xdot, ca.MX.zeros(0, 1))


def _dm(matrix: np.ndarray) -> ca.DM:
    import casadi as ca

    return ca.sparsify(ca.DM(matrix))
