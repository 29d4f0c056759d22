"""Linear cells on one shared field: poles, certificate, plant, runs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.contracts import Integrator
from cellsys.drawable import Drawable
from cellsys.errors import MemoryBudgetError, ParameterError
from cellsys.loop import PolarityLaw
from cellsys.population.headings import steering
from cellsys.population.poleset import PoleSet, pole_set
from cellsys.population.ported.placement import Placement
from cellsys.population.ported.plant import linear_plant
from cellsys.population.verdict import CoupledStability, judge
from cellsys.ports.footprint import RestPassivity, dense_stiffness, field_passivity
from cellsys.ports.ports import CellPort, PortPassivity
from cellsys.shown import Shown
from cellsys.spectra.integrators import apart_from, said_apart
from cellsys.trajectory import Trajectory

if TYPE_CHECKING:
    import control

DENSE_LIMIT = 4000


@dataclass(frozen=True, eq=False)
class PortCertificate(Shown):
    """Why the whole is stable for every K and every placement, or which part fails.

    Attributes
    ----------
    cell : PortPassivity
    field : RestPassivity
    strict : float
        How fast the free cell at least contracts in its metric, 1/s (or 1 - |A|_P^2 per step); > 0
        means bounded under bounded inputs.
    """

    cell: PortPassivity
    field: RestPassivity
    strict: float

    @property
    def holds(self) -> bool:
        """Both parts are passive for certain."""
        return self.cell.certified and self.field.certified

    def __str__(self) -> str:
        return f"{self.cell}; {self.field}"


@checked
@dataclass(frozen=True, eq=False)
class PortedCells(Drawable):
    """K cells on one field, linear. Made by `couple(port, coupling=LoadPorts(...))`.

    Attributes
    ----------
    model : CellPort
    coupling : LoadPorts
    controller : PolarityLaw or None
    """

    model: CellPort
    coupling: Placement
    controller: PolarityLaw | None = None
    normalise: bool = True

    _figure: ClassVar[str] = "coupled_cells"

    @property
    def n_cells(self) -> int:
        """K."""
        return len(self.coupling.positions)

    @property
    def order(self) -> int:
        """m of one cell."""
        return self.model.order

    @property
    def n_states(self) -> int:
        """K m + order of the field."""
        return self.n_cells * self.order + int(self.coupling.field.order)

    @cached_property
    def passivity(self) -> PortPassivity:
        """Of the cell's port."""
        return self.model.passivity()

    @cached_property
    def certificate(self) -> PortCertificate:
        """Passivity of every part."""
        cell = self.passivity
        return PortCertificate(cell, field_passivity(self.coupling.field), -cell.contraction)

    @cached_property
    def gathers(self) -> np.ndarray:
        """E_k of every cell, (K, n_f, order)."""
        c, port = self.coupling, self.coupling.port
        if port is None:
            raise ParameterError("the cells have no port on the field: give LoadPorts(..., port=)")
        return np.array(
            [
                port.gather(c.field, x, float(a))
                for x, a in zip(c.positions, c.headings, strict=True)
            ]
        )

    @cached_property
    def route(self) -> str:
        """Which route is taken, and why."""
        if not np.any(self.model.C):
            return "cascade: the cells drive the matrix and feel nothing, K copies of one cell"
        if self.n_states <= DENSE_LIMIT:
            return f"dense: one field block, K m + order = {self.n_states} <= {DENSE_LIMIT}"
        return f"certificate only: K m + order = {self.n_states} > {DENSE_LIMIT}"

    def _afford(self, what: str) -> None:
        if self.n_states > DENSE_LIMIT:
            raise MemoryBudgetError(
                f"{what} makes a dense matrix of K m + order = {self.n_states} > {DENSE_LIMIT} "
                "rows; stability() certifies any number of cells without it, fewer modes of the "
                "field or fewer cells make it possible"
            )

    @cached_property
    def _assembled(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        self._afford("the assembled system")
        K, m, cell, field = self.n_cells, self.order, self.model, self.coupling.field
        Kq, C_e, n = dense_stiffness(field), float(field.drag), int(field.order)
        E = self.gathers
        A = np.kron(np.eye(K), cell.A)
        # C E_k and E_k^T F, all cells below and beside each other
        CE = np.einsum("mf,kfq->kmq", cell.C, E).reshape(K * m, n)
        EF = np.einsum("kfq,fm->qkm", E, cell.F).reshape(n, K * m)
        if cell.dt is None:
            G, D = -Kq / C_e, EF / C_e
            M = np.block([[A + CE @ D, CE @ G], [D, G]])
            given = np.vstack([CE, np.eye(n)]) / C_e
            return M, np.vstack([np.eye(K * m), np.zeros((n, K * m))]), given
        dt = cell.dt
        through = 0.5 * (EF @ CE) / dt
        left = (C_e / dt) * np.eye(n) + Kq - through
        one = np.eye(K * m)
        on_z, on_q, on_g = (
            0.5 * EF @ (one + A),
            (C_e / dt) * np.eye(n) - through,
            0.5 * EF,
        )
        solved = sla.solve(left, np.hstack([on_z, on_q, on_g, np.eye(n)]))
        q_z, q_q, q_g, q_l = np.split(solved, [K * m, K * m + n, 2 * K * m + n], axis=1)
        M = np.block([[A + CE @ q_z / dt, CE @ (q_q - np.eye(n)) / dt], [q_z, q_q]])
        return M, np.vstack([one + CE @ q_g / dt, q_g]), np.vstack([CE @ q_l / dt, q_l])

    @property
    def whole(self) -> tuple[np.ndarray, np.ndarray]:
        """(M, G) of x' (or x+) = M x + G g: x = [z_1 .. z_K, q], g (K m) = b + B u of each."""
        M, G, _ = self._assembled
        return M, G

    @property
    def given_loads(self) -> np.ndarray:
        """What loads (order,), pN, on the field's coordinates add to x' (or x+) of `whole`."""
        return self._assembled[2]

    def matrix(self) -> np.ndarray:
        """The assembled matrix: of x' = M x, or of a step x+ = M x; x = [z_1 .. z_K, q]."""
        return self.whole[0]

    def _continuous(self, values: np.ndarray) -> np.ndarray:
        if self.model.dt is None:
            return values
        with np.errstate(divide="ignore"):
            log = np.log(np.asarray(values, complex))
        return log.real / self.model.dt + 1j * (log.imag / self.model.dt)

    @cached_property
    def _poles(self) -> PoleSet:
        note = f"LoadPorts, {self.route.split(':')[0]} route"
        if self.route.startswith("cascade"):
            K_field, C_e = dense_stiffness(self.coupling.field), float(self.coupling.field.drag)
            rates = sla.eigvalsh(K_field) / C_e
            if self.model.dt is not None:
                rates = np.log1p(self.model.dt * rates) / self.model.dt  # implicit Euler
            own = self._continuous(sla.eigvals(self.model.A))
            return pole_set([(own, self.n_cells, np.nan), (-rates, 1, np.nan)], note, None)
        return pole_set([(self._continuous(sla.eigvals(self.matrix())), 1, np.nan)], note, None)

    def pole_set(self) -> PoleSet:
        """Poles of cells and field with multiplicities, 1/s."""
        return self._poles

    def poles(self) -> np.ndarray:
        """Every pole (K m + order,), 1/s, by falling real part."""
        return self._poles.expanded()

    def stability(self) -> CoupledStability:
        """Certificate when every part is passive, else the poles of this placement.

        The verdict "stable for every K and every placement" is about shapes, loads and field;
        the centroids integrate and are not part of it.
        """
        if self.certificate.holds:
            poles = (
                self._poles
                if self.n_states <= DENSE_LIMIT
                else pole_set(
                    [(self._continuous(sla.eigvals(self.model.A)), self.n_cells, np.nan)],
                    "poles of the free cells; the coupled ones are not computed at this size",
                    None,
                )
            )
            bounded = (
                "bounded under bounded inputs"
                if self.certificate.strict > 0
                else "inputs may add up without bound: the free cell does not contract strictly"
            )
            return CoupledStability(
                verdict="stable for every K and every placement",
                reason=f"cells and matrix are passive at their ports ({self.certificate}); "
                f"{bounded}; centroids integrate and are set apart",
                spectral_abscissa=poles.abscissa,
                abscissa_error=0.0,
                numerical_abscissa=self.passivity.contraction,
                integrators=0,
                poles=poles,
                route=self.route,
            )
        found = judge(self.matrix(), dt=0.0 if self.model.dt is None else float(self.model.dt))
        said = {
            "unstable": f"this placement grows at {found.abscissa:.4g} 1/s",
            "stable": f"this placement decays, at {-found.abscissa:.4g} 1/s or faster",
        }.get(
            found.verdict,
            f"the largest real part of this placement, {found.abscissa:.3g} 1/s, is known to +- "
            f"{found.error:.1e} only",
        )
        return CoupledStability(
            verdict=apart_from(found.verdict, found.integrators),
            reason=f"no certificate ({self.certificate}); {said}{said_apart(found.integrators)}",
            spectral_abscissa=found.abscissa,
            abscissa_error=found.error,
            numerical_abscissa=found.numerical,
            integrators=found.integrators,
            poles=self._poles,
            route=self.route,
        )

    def plant(
        self,
        *,
        points: np.ndarray | None = None,
        offset: Literal["input", "drop"] = "input",
    ) -> control.StateSpace:
        """Cells and field as a named `control.StateSpace`, dt = 0 or the step of the cells.

        Inputs are the commands of every cell, loads on the matrix (pN) and ``one``; outputs the
        states and the displacement of the matrix (um).

        Parameters
        ----------
        points : (P, 2) or (P, 3), optional
            um. Loads act and displacements are read at the surface node nearest to each:
            ``load1_x, ...`` and ``matrix1_x, ...``.
        offset : {"input", "drop"}
            What the offsets of the cells become: a last input ``one``, constant 1, or nothing.
        """
        return linear_plant(self, points, offset)

    def interconnect(self) -> control.InterconnectedSystem:
        """Cells, field, controllers, commands and sensors as a diagram of python-control.

        Its states are z, q and p, its outputs z, p and d of every cell and the field; nothing
        comes from outside. Started from `diagram_start` its `input_output_response` is
        `simulate`, step for step for cells with a step of their own.

        Raises
        ------
        ParameterError
            For cells without headings or sensor.
        """
        from cellsys.population.ported.ported_run import ported_diagram

        self._afford("interconnect()")
        return ported_diagram(self)

    @property
    def diagram_start(self) -> np.ndarray:
        """State of `interconnect()` at the start: z and q, then p."""
        from cellsys.population.ported.ported_run import initial, ported_loop

        return initial(self, steering(ported_loop(self)), None, None, None)

    def simulate(
        self,
        t: np.ndarray,
        integrator: Integrator | None = None,
        *,
        z0: np.ndarray | None = None,
        p0: np.ndarray | None = None,
        q0: np.ndarray | None = None,
    ) -> Trajectory:
        """Run cells and field; states ``z`` (K, m), ``q`` and, with a controller, ``p`` (K, 3).

        Continuous cells: as in `CoupledCells.simulate`, exact flows composed by `Exponential`
        (and without integrator, where nothing turns), any other on the whole system. Cells with a
        step: one exchange at the midpoint per step, on the grid of dt, commands held over each;
        an integrator is refused.
        """
        from cellsys.population.ported.ported_run import run_ported

        return run_ported(self, t, integrator, z0, p0, q0)

    def __str__(self) -> str:
        return (
            f"{self.n_cells} cells on a field of order {self.coupling.field.order}, m = "
            f"{self.order}\n  route   {self.route}\n  {self.certificate}"
        )
