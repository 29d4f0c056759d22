"""The l = 0 cell of a gel: a rigid sphere with one clutch strength and one stretch.

    n' = k_on s (1 - n) - k_off n,      S' = n (<e_i . sum_j w_ij v_j> + v_m) - k_off S

s and <.> are means over the nodes of the sphere, e_i points outward at node i, and its force on the
gel is -k_b S sum_i w_ij e_i: the clutch of the full-order cell [notes: matrix, gel] with the same
stretch in every direction. It enters the gel as an impedance: its stretch follows the gel, its
surface pushes back. Nothing is trained.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.arguments import checked
from cellsys.effects import clutch_kernels as kernels
from cellsys.effects.bond_laws import ClutchLaw
from cellsys.effects.embedded import EmbeddedFooting
from cellsys.effects.matrix import MATRIX
from cellsys.effects.protocol import CellBody, Configuration, Element, JunctionArray, Port
from cellsys.errors import SceneError
from cellsys.geometry.network import FibreNetwork
from cellsys.laws.clutch import unbinding_rate
from cellsys.mechanics.spreading import SpreadingSystem
from cellsys.system import Block


@checked
@dataclass(frozen=True)
class RadialCell:
    """Two states in place of the cells of a full-order system in a gel; see the module's text."""

    _made_by: ClassVar[str] = "cs.RadialCell()"

    def of(self, system: SpreadingSystem) -> SpreadingSystem:
        """The system with its cells replaced: the same gel, the same clutch and contact.

        States: ``cellK.position`` (held), ``matrix.displacement``, ``cellK.bond_strength`` (1,) and
        ``cellK.bond_stretch`` (1,) um.

        Parameters
        ----------
        system : SpreadingSystem
            ``cs.build(scene)`` of a scene in a gel.

        Raises
        ------
        SceneError
            A system without a gel or without cells, or cells without a motor clutch.
        """
        matrix = system.matrix
        if matrix is None or matrix.flat or not system.cells:
            raise SceneError(
                "a RadialCell lies in a gel: give it cs.build(scene) of a scene with cells and "
                "matrix.kind = 'gel'"
            )
        names = {cell.body.name for cell in system.cells}
        kept = [e for e in system.elements if not e.name.startswith(tuple(f"{n}." for n in names))]
        clutches = []
        for cell in system.cells:
            law = next((e for e in cell.effects.values() if isinstance(e, ClutchLaw)), None)
            if law is None:
                raise SceneError(f"{cell.body.name} has no focal_adhesion, which pulls on the gel")
            clutches.append(_RadialClutch(law, cell.body, matrix))
        arrays = []
        for array in system.arrays:
            if array.name in names:
                cell = next(c for c in system.cells if c.body.name == array.name)
                start = cell.body.membrane.position
                arrays.append(array._replace(start=start, drag=np.full(start.shape, np.inf)))
            elif array.name == MATRIX:
                arrays.append(array)
        first = [e for e in kept if {p.array for p in e.ports} <= {MATRIX}]
        shared = [e for e in kept if e not in first and _reaches(e, arrays)]
        return SpreadingSystem(system.cells, matrix, (*first, *clutches, *shared), tuple(arrays))


def _reaches(element: Element, arrays: list[JunctionArray]) -> bool:
    """Whether it acts on a gel: contact of its nodes, not that of cells with each other."""
    there = {port.array for port in element.ports}
    return MATRIX in there and there <= {array.name for array in arrays}


class _RadialClutch(Element):
    """One clutch for all nodes of a rigid sphere."""

    def __init__(self, law: ClutchLaw, cell: CellBody, matrix: FibreNetwork) -> None:
        self.law, self.array = law, cell.name
        self.name = f"{cell.name}.{law.name}"
        self.footing = EmbeddedFooting(cell.name, matrix, law.reach)
        self.ports = (Port(cell.name, self.name), self.footing.port(law.name))
        self.strength, self.stretch = f"{cell.name}.bond_strength", f"{cell.name}.bond_stretch"
        self.internal = (
            Block(self.strength, (1,), "1", role="component", kind="internal"),
            Block(self.stretch, (1,), "um", role="component", kind="internal"),
        )
        x = cell.membrane.position - cell.membrane.position.mean(axis=0)
        self.outward = x / np.linalg.norm(x, axis=1, keepdims=True)

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        kernels.clutch_loads(
            s.nodes[self.array],
            s.nodes[MATRIX],
            np.ones(len(self.outward)),
            float(s.internal[self.stretch][0]) * self.outward,
            *self.footing.weights(s),
            self.footing.hold(s),
            self.law.stiffness,
            0.0,
            *out,
        )

    def rates(
        self, s: Configuration, v: dict[str, np.ndarray], out: tuple[np.ndarray, ...]
    ) -> None:
        slip = np.empty_like(self.outward)
        kernels.gather(v[MATRIX], *self.footing.weights(s), slip)
        drive = float(np.einsum("ij,ij->", slip, self.outward)) / len(slip)
        n, stretch = s.internal[self.strength][0], s.internal[self.stretch][0]
        law = self.law
        on = float(self.footing.on_rates(s, law).mean())
        off = unbinding_rate(n, law.stiffness * abs(stretch), law.off_rate, law.force_scale)
        out[0][0] = on * (1.0 - n) - off * n
        out[1][0] = n * (drive + law.retrograde_speed) - off * stretch
