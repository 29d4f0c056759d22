"""Membrane: elastic lines and areas, cortical tension."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from cellsys.compiled import compiled
from cellsys.effects.protocol import (
    CellBody,
    Configuration,
    Effect,
    Element,
    Port,
    Site,
    Stiffness,
    parameter,
)
from cellsys.effects.tangent import laplacian

_SOFT = 1e-6  # um^2 (um^4 for squared areas): keeps lengths and normals away from 0/0


@compiled
def line_forces(x, edges, rest, stiffness, cubic, force):
    """Forces of nonlinear springs E = k d^2/2 + k c d^4/(4 L0^2), d = L - L0; returns E."""
    energy = 0.0
    for e in range(edges.shape[0]):
        i, j = edges[e, 0], edges[e, 1]
        d0, d1, d2 = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        length = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2 + _SOFT)
        stretch = length - rest[e]
        c = cubic / (rest[e] * rest[e])
        tension = stiffness * stretch * (1.0 + c * stretch * stretch) / length
        energy += stiffness * stretch * stretch * (0.5 + 0.25 * c * stretch * stretch)
        force[i, 0] += tension * d0
        force[i, 1] += tension * d1
        force[i, 2] += tension * d2
        force[j, 0] -= tension * d0
        force[j, 1] -= tension * d1
        force[j, 2] -= tension * d2
    return energy


@compiled
def area_forces(x, triangles, rest, stiffness, tension, force):
    """Forces of E = sum A0 k_a h(A/A0) + gamma A over triangles; returns E.

    h(J) = (J - 1)^2/2 for J >= 1 and (1/J - 1)^2/2 below: twice differentiable, and no triangle
    can be squeezed to nothing (tension alone would collapse it).
    """
    energy = 0.0
    for t in range(triangles.shape[0]):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        b0, b1, b2 = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        c0, c1, c2 = x[k, 0] - x[i, 0], x[k, 1] - x[i, 1], x[k, 2] - x[i, 2]
        n0, n1, n2 = b1 * c2 - b2 * c1, b2 * c0 - b0 * c2, b0 * c1 - b1 * c0
        double = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2 + _SOFT)
        J = 0.5 * double / rest[t]
        if J >= 1.0:
            pull = stiffness * (J - 1.0)
            energy += 0.5 * stiffness * rest[t] * (J - 1.0) ** 2
        else:
            pull = stiffness * (J - 1.0) / (J * J * J)
            energy += 0.5 * stiffness * rest[t] * (1.0 / J - 1.0) ** 2
        energy += tension * rest[t] * J
        # dA/dx_k = unit normal x (opposite edge) / 2
        s = -0.5 * (pull + tension) / double
        n0, n1, n2 = s * n0, s * n1, s * n2
        fj0, fj1, fj2 = c1 * n2 - c2 * n1, c2 * n0 - c0 * n2, c0 * n1 - c1 * n0
        fk0, fk1, fk2 = n1 * b2 - n2 * b1, n2 * b0 - n0 * b2, n0 * b1 - n1 * b0
        force[j, 0] += fj0
        force[j, 1] += fj1
        force[j, 2] += fj2
        force[k, 0] += fk0
        force[k, 1] += fk1
        force[k, 2] += fk2
        force[i, 0] -= fj0 + fk0
        force[i, 1] -= fj1 + fk1
        force[i, 2] -= fj2 + fk2
    return energy


def area_bound(
    x: np.ndarray, triangles: np.ndarray, rest: np.ndarray, stiffness: float, tension: float
) -> tuple[np.ndarray, np.ndarray]:
    """Edge weights whose graph Laplacian bounds the tangent of `area_forces`.

    With T = dE/dA and g_k = dA/dx_k, which sum to zero, (sum of g_k.d_k)^2 is at most the sum over
    edges of |g_k - g_l|^2 |d_k - d_l|^2 / 3. The change of g_k is bounded by T/2 in the plane and
    by the same inequality for the gradients of the shape functions out of it.

    Returns (pairs (3 n_triangles, 2), weights (3 n_triangles,)), pN/um.
    """
    corner = x[triangles]
    opposite = corner[:, [2, 0, 1]] - corner[:, [1, 2, 0]]
    area = 0.5 * np.sqrt((np.cross(opposite[:, 0], opposite[:, 1]) ** 2).sum(axis=1) + _SOFT)
    J = area / rest
    low = np.minimum(J, 1.0)
    pull = stiffness * np.where(J >= 1.0, J - 1.0, (low - 1.0) / low**3) + tension
    second = stiffness / rest * np.where(J >= 1.0, 1.0, (3.0 - 2.0 * low) / low**4)
    pairs, weights = [], []
    for k, m in ((0, 1), (1, 2), (2, 0)):
        spread = ((opposite[:, k] - opposite[:, m]) ** 2).sum(axis=1)
        bound = spread / 12.0 * (second + np.maximum(pull, 0.0) / area) + 0.5 * np.abs(pull)
        pairs.append(triangles[:, [k, m]])
        weights.append(bound)
    return np.concatenate(pairs), np.concatenate(weights)


def _edge_lengths(x: np.ndarray, edges: np.ndarray) -> np.ndarray:
    return np.sqrt(((x[edges[:, 1]] - x[edges[:, 0]]) ** 2).sum(axis=1) + _SOFT)


@dataclass(frozen=True)
class MembraneElasticity(Effect):
    """Elastic membrane: springs along edges and areas of triangles, F = -dE/dx."""

    name: ClassVar[str] = "membrane_elasticity"
    not_on: ClassVar[dict[str, str]] = {"chain": "a crawler is two masses and has no membrane"}
    line: float = parameter(
        "100 pN/um",
        "pN/um",
        least=0.0,
        source="working set [notes: mechanics, membrane]",
        about="edge spring k_l",
    )
    stiffening: float = parameter(
        "2",
        least=0.0,
        source="calibrated here [notes: mechanics, membrane]",
        about="cubic stiffening of the edges",
    )
    area: float = parameter(
        "50 pN/um",
        "pN/um",
        least=0.0,
        source="working set [notes: mechanics, membrane]",
        about="area modulus k_a",
    )

    def elements(self, site: Site) -> tuple[Element, ...]:
        return (_MembraneElement(self, site.body),)


class _MembraneElement(Element):
    def __init__(self, effect: MembraneElasticity, cell: CellBody) -> None:
        self.effect, self.mesh = effect, cell.membrane
        self.name = f"{cell.name}.{effect.name}"
        self.array = cell.name
        self.ports = (Port(cell.name, self.name),)

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        e, m, x = self.effect, self.mesh, s.nodes[self.array]
        line_forces(x, m.edges, m.edge_length, e.line, e.stiffening, out[0])
        area_forces(x, m.triangles, m.triangle_area, e.area, 0.0, out[0])

    def energy(self, s: Configuration) -> float:
        e, m, x = self.effect, self.mesh, s.nodes[self.array]
        scrap = np.zeros_like(x)
        return line_forces(x, m.edges, m.edge_length, e.line, e.stiffening, scrap) + area_forces(
            x, m.triangles, m.triangle_area, e.area, 0.0, scrap
        )

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        return (Stiffness(self.array, (0, 1, 2), lambda: self._bound(s), None),)

    def _bound(self, s: Configuration) -> sp.csc_array:
        key = self.name + ".bound"
        if key not in s.cache:
            e, m, x = self.effect, self.mesh, s.nodes[self.array]
            length = _edge_lengths(x, m.edges)
            excess = ((length - m.edge_length) / m.edge_length) ** 2
            weight = e.line * (1.0 + 3.0 * e.stiffening * excess)
            pairs, weights = area_bound(x, m.triangles, m.triangle_area, e.area, 0.0)
            s.cache[key] = laplacian(
                len(x), np.concatenate([m.edges, pairs]), np.concatenate([weight, weights])
            )
        return s.cache[key]


@dataclass(frozen=True)
class CorticalTension(Effect):
    """Constant surface tension of the cortex, E = gamma A."""

    name: ClassVar[str] = "cortical_tension"
    not_on: ClassVar[dict[str, str]] = {
        "chain": "a crawler has no membrane; stiffness of [[cells]] draws it together"
    }
    tension: float = parameter(
        "150 pN/um",
        "pN/um",
        least=0.0,
        source="working set [notes: mechanics, cortical tension]",
        about="surface tension gamma",
    )

    def elements(self, site: Site) -> tuple[Element, ...]:
        return (_TensionElement(self, site.body),)


class _TensionElement(Element):
    def __init__(self, effect: CorticalTension, cell: CellBody) -> None:
        self.effect, self.mesh = effect, cell.membrane
        self.name = f"{cell.name}.{effect.name}"
        self.array = cell.name
        self.ports = (Port(cell.name, self.name),)

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        m = self.mesh
        area_forces(
            s.nodes[self.array], m.triangles, m.triangle_area, 0.0, self.effect.tension, out[0]
        )

    def energy(self, s: Configuration) -> float:
        m, x = self.mesh, s.nodes[self.array]
        return area_forces(
            x, m.triangles, m.triangle_area, 0.0, self.effect.tension, np.zeros_like(x)
        )

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        return (Stiffness(self.array, (0, 1, 2), lambda: self._bound(s), None),)

    def _bound(self, s: Configuration) -> sp.csc_array:
        key = self.name + ".bound"
        if key not in s.cache:
            m, x = self.mesh, s.nodes[self.array]
            s.cache[key] = laplacian(
                len(x), *area_bound(x, m.triangles, m.triangle_area, 0.0, self.effect.tension)
            )
        return s.cache[key]
