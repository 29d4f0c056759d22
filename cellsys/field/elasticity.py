"""The matrix alone: stored energy, forces and tangent of the elements that act on it only.

    U(u) = sum over fibres k l0^2 G(strain) + foundation,      F = -dU/du,      Hess U = -dF/du

Law and loops are those of the full-order model (`FibreElement`, `cellsys.laws.fibre`); nothing is
written a second time, so inclusion, gradient, buckling, stiffening and foundation are what the
scene says.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from cellsys.effects.fibre_bending import BendingElement, bend_forces
from cellsys.effects.matrix import MATRIX, FibreElement
from cellsys.effects.protocol import Configuration
from cellsys.errors import ParameterError, SceneError
from cellsys.geometry.disc import StiffnessAssembly
from cellsys.laws.sensing import fibre_ends, nodal_mean
from cellsys.mechanics.spreading import SpreadingSystem
from cellsys.trajectory import Trajectory

_STATE = "matrix.displacement"
_LINEAR = f"{MATRIX}.foundation"
_BENDING = f"{MATRIX}.fibre_bending"
_H = 1e-5  # um: step of the differences of the bending forces, whose angles change over 1 um


class MatrixEnergy:
    """Energy of the matrix of a built scene as a function of nodal displacements (n, 3), um.

    Parameters
    ----------
    system : SpreadingSystem
        ``cs.build(scene)``; only its matrix and the elements on the matrix alone are used.

    Raises
    ------
    SceneError
        A scene without a matrix, with a matrix but no elasticity, on a chain, or with an effect
        that gives the matrix states or motions of its own (creep, degradation, external strain).
    """

    def __init__(self, system: SpreadingSystem) -> None:
        if system.matrix is None:
            raise SceneError(
                "this scene has no matrix, so there is no field to reduce; add [matrix] and "
                "effects.matrix_elasticity"
            )
        own = [
            e
            for e in system.elements
            if e.ports and all(p.array == MATRIX for p in (*e.ports, *e.inputs))
        ]
        fibres = [e for e in own if isinstance(e, FibreElement)]
        if not fibres:
            raise SceneError(
                "this scene's matrix has no elasticity: a load would move it for ever; "
                "add effects.matrix_elasticity"
            )
        for e in [*own, *(e for e in system.elements if any(h.array == MATRIX for h in e.holds))]:
            if e is not fibres[0] and e.name not in (_LINEAR, _BENDING):
                raise SceneError(
                    f"{e.name} gives the matrix states or motions of its own, which a field of "
                    "displacements alone does not carry; leave it out, or run the full-order model"
                )
        self.disc = system.matrix
        self._fibres = fibres[0]
        self._others = tuple(e for e in own if e is not self._fibres)
        self.own_blocks = frozenset(p.block for e in own for p in e.ports)
        self._elements = tuple(own)
        self.rest = np.array(self.disc.position)
        self.n = len(self.rest)
        self.free = np.flatnonzero(~np.repeat(self.disc.clamped, 3))
        self.drag = float(system.drag()[system.states.slice(_STATE)][self.free][0])
        self._assembly: StiffnessAssembly | None = None

    def _at(self, u: np.ndarray) -> Configuration:
        return Configuration(0.0, {MATRIX: u}, {})

    def energy(self, u: np.ndarray) -> float:
        """U, pN um, at displacements u (n, 3)."""
        s = self._at(u)
        return float(sum(e.energy(s) for e in self._elements))

    def force(self, u: np.ndarray) -> np.ndarray:
        """F = -dU/du (n, 3), pN."""
        total = np.zeros_like(u)
        s = self._at(u)
        self._fibres.efforts(s, (total,))
        for element in self._others:
            part = np.zeros_like(u)
            element.efforts(s, (part,))
            total += part
        return total

    def tangent(
        self, u: np.ndarray, slope: float | None = None, *, tension_only: bool = False
    ) -> sp.csc_array:
        """Hess U (3n, 3n), pN/um; clamped nodes not yet removed.

        A fibre of stiffness k, slope g' and tension T gives k g' n n^T + (T/l)(I - n n^T); T < 0
        makes it indefinite. With `slope` every fibre has that slope and no tension: a fixed
        over-estimate for a modified Newton method. `tension_only` leaves T < 0 out: semidefinite.
        """
        d = self.disc
        if self._assembly is None:
            self._assembly = StiffnessAssembly(self.n, d.fibres)
        x = self.rest + u
        s = self._at(u)
        if slope is None:
            along, tension = self._fibres.slopes(s)
            if tension_only:
                tension = np.maximum(tension, 0.0)
            ends = x[d.fibres[:, 1]] - x[d.fibres[:, 0]]
            across = tension / np.sqrt((ends**2).sum(axis=1) + 1e-12)
        else:
            along, across = np.full(len(d.fibres), float(slope)), np.zeros(len(d.fibres))
        K = self._assembly(x, along * d.stiffness, across)
        for element in self._others:
            if isinstance(element, BendingElement):
                K = K + bending_tangent(element, u)
                continue
            # A linear law: the bound it states for the integrator is its stiffness itself.
            for part in element.stiffness(s):
                on = np.zeros(3)
                on[list(part.axes)] = 1.0
                K = K + sp.kron(part.matrix(), sp.diags_array(on))
        return sp.csc_array(K)

    def fibre_stiffness(self, u: np.ndarray) -> np.ndarray:
        """Mean over the fibres at each node of k max(g', 1) (n,), pN/um, for a graded cue."""
        fibres = self.disc.fibres
        return nodal_mean(fibres, self._fibres.unbuckled(self._at(u)), fibre_ends(self.n, fibres))

    def nodal(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """``virial`` and ``stiffness`` (n,) of the fibres at displacements u (n, 3)."""
        return self._fibres.nodal(self._at(u))

    def loads(self, run: Trajectory, at: str = "average") -> np.ndarray:
        """Loads on the matrix in a run (T - 1, n, 3), pN, one for each sampling interval.

        "average": over the interval, as logged. "end": at its end, half-way between this average
        and the next (the last one extrapolated). The matrix follows its load within seconds, so
        an implicit step under the average arrives half an interval late; under the end value not.
        Everything that acts on the matrix (adhesions, external loads) except its own elasticity
        and foundation, and except what the stepping left over (``step_residual``).
        """
        if at not in ("average", "end"):
            raise ParameterError(f"at must be 'average' or 'end', got {at!r}")
        if run.W_eta is None:
            raise ParameterError("run carries no junction matrix: its loads cannot be told")
        rows = run.states.slice(_STATE)
        total = self.drag * np.asarray(run.u)[:, rows]
        W = self.drag * sp.csc_array(run.W_eta)[rows]
        for block in run.auxiliaries:
            if block.name in self.own_blocks or block.name == "step_residual":
                continue
            piece = run.auxiliaries.slice(block.name)
            part = W[:, piece]
            if part.nnz:
                total = total + np.asarray(run.eta)[:, piece] @ part.T
        if at == "end" and len(total) > 1:
            total = np.concatenate(
                [0.5 * (total[:-1] + total[1:]), 1.5 * total[-1:] - 0.5 * total[-2:-1]]
            )
        return total.reshape(len(total), self.n, 3)


def bending_tangent(element: BendingElement, u: np.ndarray) -> sp.csc_array:
    """Hess of the bending energy (3n, 3n), pN/um, by central differences of `bend_forces`.

    Every triple of nodes is set apart, so that 18 evaluations give all 9 x 9 blocks at once.
    """
    triples = element.triples
    m = len(triples)
    apart = np.arange(3 * m).reshape(m, 3)
    rest, at = element.disc.position[triples].reshape(-1, 3), u[triples].reshape(-1, 3)
    unused = np.empty(m)
    blocks = np.empty((m, 9, 9))
    for k in range(9):
        sides = []
        for sign in (1.0, -1.0):
            moved, force = at.copy(), np.zeros((3 * m, 3))
            moved[k // 3 :: 3, k % 3] += sign * _H
            bend_forces(rest, moved, apart, element.angle, element.modulus, force, unused)
            sides.append(force.reshape(m, 9))
        blocks[:, :, k] = (sides[1] - sides[0]) / (2.0 * _H)
    blocks = 0.5 * (blocks + blocks.transpose(0, 2, 1))
    dof = (3 * triples[:, :, None] + np.arange(3)).reshape(m, 9)
    where = np.repeat(dof, 9, axis=1).ravel(), np.tile(dof, (1, 9)).ravel()
    return sp.csc_array(sp.coo_array((blocks.ravel(), where), shape=(u.size, u.size)))
