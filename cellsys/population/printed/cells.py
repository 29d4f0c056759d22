"""`CoupledCells`: K identical cells on one matrix as one linear system with its poles.

route       when
modal       every cell meets every other with one weight: two blocks, any K
graph       symmetric weights: one block per eigenvalue (master stability function)
dense       anything else with K m <= 4000
matrix-free anything else: simulate() and rightmost() only
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import Integrator
from cellsys.drawable import Drawable
from cellsys.errors import MemoryBudgetError
from cellsys.loop import ClosedLoop
from cellsys.model import LatentModel
from cellsys.population.graph import InteractionGraph
from cellsys.population.poleset import PoleSet, pole_set
from cellsys.population.printed.blocks import (
    ModeBlock,
    PrintedForm,
    eigenvalues_of_N,
    kept_directions,
)
from cellsys.population.printed.certainty import block_certainty
from cellsys.population.printed.closed import CoupledLoop, linearize
from cellsys.population.printed.dense import dense_block
from cellsys.population.printed.distinct import distinct_blocks
from cellsys.population.printed.limits import limit_poles
from cellsys.population.printed.maps import field_rows
from cellsys.population.printed.modes import Modes, modes_of
from cellsys.population.printed.plant import cells_diagram, plant_of
from cellsys.population.printed.simulation import run
from cellsys.population.printed.split import FieldSplit, field_split
from cellsys.population.printed.system import CoupledSystem, coupled_system, rightmost_poles
from cellsys.population.verdict import CoupledStability, stability_of
from cellsys.spectra.certainty import PoleCertainty
from cellsys.trajectory import Trajectory

if TYPE_CHECKING:
    import control

DENSE_LIMIT = 4000
POLE_LIMIT = 1_000_000


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class CoupledCells(Drawable):
    """K identical cells coupled through the rows of V that belong to the matrix.

    Made by `couple`. Emergent latent states are z = N z_isolated + offset for the superposition
    forms; `Feedback` starts from the isolated ones.

    Attributes
    ----------
    model : LatentModel
    n_cells : int
    coupling : Superposition, MappedSuperposition or Feedback
    graph : InteractionGraph or None
        None: every cell meets every other with weight 1.
    positions : (K, 2) or (K, 3) or None
        um; they act through the graph only.
    headings : (K,) or None
        Polarity angles at the start, rad; None: all 0.
    loop : ClosedLoop or None
        Controller and sensor of every cell; None when the model has no headings or no sensor.
    """

    model: LatentModel
    n_cells: int
    coupling: PrintedForm
    graph: InteractionGraph | None
    positions: np.ndarray | None
    headings: np.ndarray | None
    loop: ClosedLoop | None

    _figure: ClassVar[str] = "coupled_cells"

    @property
    def order(self) -> int:
        """m of one cell."""
        return self.model.order

    @cached_property
    def matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(A, B, b) of one isolated cell in continuous time."""
        return self.model.continuous_matrices()

    @cached_property
    def field(self) -> np.ndarray:
        """Row indices of V that count as matrix."""
        return field_rows(self.model, self.coupling.rows, self.coupling.name)

    @cached_property
    def rank(self) -> FieldSplit:
        """The rank decision: what counts as purely matrix, what is not determined."""
        return field_split(self.model, self.field, self.coupling.rank_tol, self.coupling.name)

    @cached_property
    def modes(self) -> Modes | None:
        """The split of the interaction; None on the dense and matrix-free routes."""
        return self._split if isinstance(self._split, Modes) else None

    @cached_property
    def _split(self) -> Modes | InteractionGraph:
        return modes_of(self.n_cells, self.graph)

    @cached_property
    def route(self) -> str:
        """Which route is taken, and why."""
        K, m = self.n_cells, self.order
        if self.graph is None or self.graph.uniform is not None:
            return "modal: every cell meets every other alike, one mean and one difference block"
        if self.graph.splits:
            return f"graph: symmetric weights, {K} blocks (master stability function)"
        why = "too many cells for a split" if self.graph.symmetric else "weights not symmetric"
        if K * m <= DENSE_LIMIT:
            return f"dense: {why}, K m = {K * m} <= {DENSE_LIMIT}"
        return f"matrix-free: {why}, K m = {K * m} > {DENSE_LIMIT}"

    def _refuse_matrix_free(self, what: str, works: str) -> None:
        if self.route.startswith("matrix-free"):
            raise MemoryBudgetError(
                f"{what} needs the dense route, limited to K m <= {DENSE_LIMIT}, and the route is "
                f"{self.route}; {works}, or make the weights symmetric (graph route) or all alike "
                "(modal route, any number of cells)"
            )

    # Blocks

    def _rotate(self, modes: Modes) -> bool:
        """Whether x lives in the basis W: a direction is dropped somewhere, or R is not I."""
        if not self.coupling.inverted():
            return False
        if self.coupling.extra(self.order) is not None:
            return True
        return not kept_directions(self.rank, modes.omega).all()

    def blocks(self, *, drop: bool = False) -> list[ModeBlock]:
        """Every block of the split, in the order of `modes.omega`; one on the dense route."""
        self._refuse_matrix_free("blocks()", "simulate() works")
        A = self.matrices[0]
        modes = self._split
        if isinstance(modes, InteractionGraph):
            return [dense_block(self.coupling, self.rank, A, modes, drop=drop)]
        rotate = drop or self._rotate(modes)
        return [
            self.coupling.block(self.rank, A, float(w), rotate=rotate, drop=drop)
            for w in modes.omega
        ]

    @cached_property
    def _kept_blocks(self) -> list[ModeBlock]:
        return self.blocks()

    def _multiplicity(self) -> np.ndarray:
        return np.ones(1, dtype=np.int64) if self.modes is None else self.modes.multiplicity

    def distinct(self, *, drop: bool) -> list[tuple[np.ndarray, int, int, float]]:
        """(matrix without its dropped directions, multiplicity, dropped, omega); equal ones joined.

        Superposition's blocks are all A where nothing is dropped, and one compression of A where
        the same directions are: they are worked out once.
        """
        return distinct_blocks(
            self,
            lambda: self.blocks(drop=True) if drop else self._kept_blocks,
            self._multiplicity(),
            drop=drop,
        )

    @cached_property
    def doubtful(self) -> np.ndarray:
        """|N| of the directions kept that the data do not determine, over all blocks."""
        if not self.coupling.inverted():
            return np.zeros(0)
        if self.modes is None:
            return self._kept_blocks[0].doubtful
        found = []
        for omega in self.modes.omega:
            N, zero = eigenvalues_of_N(self.rank, float(omega))
            low = eigenvalues_of_N(self.rank, float(omega), drop=True)[1]
            found.append(np.abs(N[(np.abs(N) > zero) & (np.abs(N) < low)]))
        return np.concatenate(found)

    # Poles

    @cached_property
    def block_certainty(self) -> tuple[list[PoleCertainty] | None, str]:
        """What the data leave open of the poles of each matrix of `distinct(drop=False)`."""

        def refitted(model: LatentModel) -> list[np.ndarray]:
            return [M for M, _, _, _ in replace(self, model=model).distinct(drop=False)]

        return block_certainty(self.model, self.eigenvalues, refitted)

    def _poles_of(self, *, drop: bool) -> PoleSet:
        parts, dropped, spreads = [], 0, []
        certainty, said = (None, "") if drop else self.block_certainty
        for k, (M, n, zeros, omega) in enumerate(self.distinct(drop=drop)):
            values = (sla.eigvals(M) if len(M) else np.zeros(0)) if drop else self.eigenvalues[k]
            parts.append((values, n, omega))
            spreads.append(np.zeros(0) if certainty is None else certainty[k].spread)
            if zeros:
                parts.append((np.zeros(1), zeros * n, omega))
                spreads.append(np.zeros(1))
                dropped += zeros * n
        alternative = None
        note = f"{self.coupling.name}, {self.route.split(':')[0]} route"
        if dropped:
            note += f"; {dropped} zero poles of purely matrix directions"
        if not drop and self.doubtful.size:
            alternative = self._poles_of(drop=True)
            note += f"; not determined by the data: {self.describe_doubt()}"
        note += f"; {said}" if said else ""
        return pole_set(parts, note, alternative, None if certainty is None else spreads)

    def describe_doubt(self) -> str:
        """The doubtful values in words."""
        d = np.unique(self.doubtful)
        shown = ", ".join(f"{v:.1e}" for v in d[:4]) + (", ..." if d.size > 4 else "")
        return f"|1 + omega lambda| = {shown} lies below 1e-07"

    @cached_property
    def eigenvalues(self) -> list[np.ndarray]:
        """Eigenvalues of each matrix of `distinct(drop=False)`, in its order."""
        blocks = self.distinct(drop=False)
        return [sla.eigvals(M) if len(M) else np.zeros(0) for M, _, _, _ in blocks]

    @cached_property
    def _poles(self) -> PoleSet:
        self._refuse_matrix_free("pole_set()", "rightmost() gives the rightmost ones of Feedback")
        return self._poles_of(drop=False)

    def pole_set(self) -> PoleSet:
        """Distinct poles with multiplicities, for any K; both sets where data do not decide.

        Raises
        ------
        MemoryBudgetError
            On the matrix-free route.
        """
        return self._poles

    def poles(self) -> np.ndarray:
        """Every pole (K m,), 1/s, by falling real part.

        Raises
        ------
        MemoryBudgetError
            When K m > 1e6 (`pole_set` has them with multiplicities), or on the matrix-free route.
        """
        self._refuse_matrix_free("poles()", "rightmost() gives the rightmost ones of Feedback")
        if self.n_cells * self.order > POLE_LIMIT:
            raise MemoryBudgetError(
                f"K m = {self.n_cells * self.order} poles are more than {POLE_LIMIT}; pole_set() "
                "gives the distinct ones with their multiplicities for any K"
            )
        return self._poles.expanded()

    def limit_poles(self) -> np.ndarray:
        """Poles of the mean block as K grows, all cells alike.

        Superposition: eig(A). MappedSuperposition: eig(P^-1 R P A), reached as O(1/K), refused
        where P is singular (poles then grow like K). Feedback: eig(R P A), reached after division
        by K - 1.
        """
        return limit_poles(self)

    def stability(self) -> CoupledStability:
        """Verdict block by block, with the error bounds of the poles; integrators set apart."""
        self._refuse_matrix_free("stability()", "rightmost() works for Feedback")
        return stability_of(self)

    # What other files of the room do with it

    def plant(
        self, coordinates: str | None = None, *, offset: Literal["input", "drop"] = "input"
    ) -> control.StateSpace:
        """The whole as a named `control.StateSpace` (dt = 0, K m <= 4000).

        Inputs are the commands of every cell and ``one``, outputs the emergent latent states z.

        Parameters
        ----------
        coordinates : {"emergent", "isolated"}, optional
            States z as printed, or x with z = T x + offset, which needs no inverse of N. Default
            emergent unless 1 - lambda < 1e-3 somewhere: A would hold |A|/(1 - lambda), and poles
            computed from it would be wrong.
        offset : {"input", "drop"}
            What the offsets of the cells and of z become: a last input ``one``, constant 1, or
            nothing; see `LatentModel.plant`.
        """
        return plant_of(self, self._checked_blocks("plant()"), coordinates, offset)

    def interconnect(self) -> control.InterconnectedSystem:
        """All cells as a diagram of python-control: plant, controllers, commands and sensors.

        Its states are x and p, those of `system`, its outputs z, p and d of every cell; nothing
        comes from outside. Started from ``system.x0`` its `input_output_response` is `simulate`.
        """
        return cells_diagram(self, self._checked_blocks("interconnect()"))

    def _checked_blocks(self, what: str) -> list[ModeBlock]:
        self._refuse_matrix_free(what, "simulate() works")
        if self.n_cells * self.order > DENSE_LIMIT:
            raise MemoryBudgetError(
                f"{what} makes a dense matrix of K m = {self.n_cells * self.order} > {DENSE_LIMIT} "
                "rows; pole_set(), stability() and simulate() work for any K on this route"
            )
        return self._kept_blocks

    def matrix(self) -> np.ndarray:
        """z' = M z + ... as printed, dense (K m, K m); entries grow as 1/(1 - lambda)."""
        found = self._checked_blocks("matrix()")
        if self.modes is None:
            return found[0].emergent
        return self.modes.assemble(np.array([b.emergent for b in found]))

    @property
    def system(self) -> CoupledSystem:
        """The whole as an `OdeSystem` with states z (K, m) and p (K, 3), for any integrator."""
        return coupled_system(self)

    def simulate(
        self,
        t: np.ndarray,
        integrator: Integrator | None = None,
        *,
        z0: np.ndarray | None = None,
        p0: np.ndarray | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Trajectory:
        """Run all cells, each with its own polarity controller and sensor.

        Parameters
        ----------
        t : (T,)
            Sample times, s.
        integrator : Exponential or any other
            `Exponential` composes exact flows on the modal and graph routes (`Splitting`), to
            order 6 with rtol and atol; any other integrates the whole system itself, on every
            route. Not needed without a controller there: the run then is the closed form.
        z0 : (m,) or (K, m), optional
            *Isolated* latent start; default the model's.
        p0 : (K, 3), optional
            Polarities; default from the headings.

        Returns
        -------
        Trajectory
            States ``z`` (K, m), emergent, and ``p`` (K, 3).

        Raises
        ------
        IntegrationError
            With the growth rate, when exact flows grow beyond 1e100 times their start.
        ParameterError
            For an integrator that these cells cannot take, with those that serve.
        """
        return run(self, t, integrator, z0, p0, progress)

    def rightmost(self, count: int = 6) -> np.ndarray:
        """The `count` rightmost poles by Arnoldi iterations, for K m above the dense limit."""
        return rightmost_poles(self, count)

    def linearize(self, at: object = None) -> CoupledLoop:
        """Closed polarity loops of all cells about one common point; see `CoupledLoop`."""
        return linearize(self, at)

    def __str__(self) -> str:
        return (
            f"{self.n_cells} cells, {self.coupling.name}, m = {self.order}\n"
            f"  route   {self.route}\n  matrix  {self.rank}"
        )
