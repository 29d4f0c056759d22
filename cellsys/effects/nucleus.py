"""Nucleus: a smaller, stiffer closed membrane inside the cell, linked to it by filaments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from cellsys.effects.membrane import area_bound, area_forces, line_forces
from cellsys.effects.protocol import (
    CellBody,
    Configuration,
    Effect,
    Element,
    JunctionArray,
    Port,
    Site,
    Stiffness,
    parameter,
)
from cellsys.effects.tangent import diagonal, laplacian
from cellsys.errors import SceneError
from cellsys.geometry.membrane import Membrane, sphere, volume_gradient
from cellsys.system import Block

_NODES = 60  # assumed [notes: mechanics, nucleus]
_LINKS = 3  # filaments from each node of the nucleus: three fix a point in space


@dataclass(frozen=True, kw_only=True)
class Nucleus(Effect):
    """An elastic sphere around the cell's centre, F = -dE/dx, its nodes with a drag of their own.

    Its edges, areas and volume follow the laws of the membrane at other numbers. Every node is
    linked to the three nearest membrane nodes by filaments E = k d^2/2 + k c d^4/(4 L0^2),
    d = L - L0, without load at the start.
    """

    name: ClassVar[str] = "nucleus"
    not_on: ClassVar[dict[str, str]] = {"chain": "a crawler is two masses and has no nucleus"}
    radius: float = parameter(
        "2.5 um",
        "um",
        above=0.0,
        source="assumed [notes: mechanics, nucleus]",
        about="radius at rest",
    )
    drag: float = parameter(
        "1000 pN s/um", "pN s/um", above=0.0,
        source="chosen here [notes: mechanics, nucleus]", about="drag of a node",
    )  # fmt: skip
    line: float = parameter(
        "1000 pN/um",
        "pN/um",
        least=0.0,
        source="assumed [notes: mechanics, nucleus]",
        about="edge spring",
    )
    area: float = parameter(
        "500 pN/um",
        "pN/um",
        least=0.0,
        source="assumed [notes: mechanics, nucleus]",
        about="area modulus",
    )
    modulus: float = parameter(
        "3000 pN/um^2",
        "pN/um^2",
        least=0.0,
        source="assumed [notes: mechanics, nucleus]",
        about="K_V",
    )
    filament: float = parameter(
        "10 pN/um", "pN/um", least=0.0,
        source="chosen here [notes: mechanics, nucleus]", about="spring of a filament",
    )  # fmt: skip
    stiffening: float = parameter(
        "2", least=0.0, source="chosen here [notes: mechanics, nucleus]",
        about="cubic stiffening of edges and filaments",
    )  # fmt: skip

    def body(self, cell: CellBody) -> Membrane:
        """The nucleus of a cell at rest.

        Raises
        ------
        SceneError
            When it does not fit into the cell.
        """
        center = cell.membrane.position.mean(axis=0)
        inner = float(np.linalg.norm(cell.membrane.position - center, axis=1).min())
        if self.radius >= 0.9 * inner:
            raise SceneError(
                f"nucleus.radius = {self.radius:g} um does not fit into {cell.name} of radius "
                f"{inner:.3g} um; keep it below {0.9 * inner:.3g} um"
            )
        return sphere(self.radius, tuple(center), _NODES)

    def arrays(self, site: Site) -> tuple[JunctionArray, ...]:
        at, name = self.body(site.body).position, f"{site.body.name}.nucleus"
        block = Block(f"{name}.position", at.shape, "um")
        return (JunctionArray(name, block, at, np.full(at.shape, self.drag)),)

    def elements(self, site: Site) -> tuple[Element, ...]:
        return (_NucleusElement(self, site.body, self.body(site.body)),)


class _NucleusElement(Element):
    def __init__(self, effect: Nucleus, cell: CellBody, mesh: Membrane) -> None:
        self.effect, self.mesh, self.array = effect, mesh, cell.name
        self.name = self.inner = f"{cell.name}.nucleus"
        self.ports = (Port(cell.name, self.name), Port(self.inner, f"{self.name}.shell"))
        outer, n = cell.membrane.position, len(cell.membrane.position)
        distance, nearest = cKDTree(outer).query(mesh.position, k=_LINKS)
        own = n + np.repeat(np.arange(len(mesh.position)), _LINKS)
        self.links = np.column_stack([np.ravel(nearest), own]).astype(np.int64)
        self.link_length = np.ravel(distance).copy()

    def _forces(self, s: Configuration, outer: np.ndarray, inner: np.ndarray) -> float:
        e, m = self.effect, self.mesh
        x, n = s.nodes[self.inner], len(s.nodes[self.array])
        volume, gradient = self._volume(s)
        inner += -e.modulus * (volume / m.volume - 1.0) * gradient
        energy = 0.5 * e.modulus * (volume - m.volume) ** 2 / m.volume
        energy += line_forces(x, m.edges, m.edge_length, e.line, e.stiffening, inner)
        energy += area_forces(x, m.triangles, m.triangle_area, e.area, 0.0, inner)
        both = np.concatenate([s.nodes[self.array], x])
        force = np.zeros_like(both)
        energy += line_forces(both, self.links, self.link_length, e.filament, e.stiffening, force)
        outer += force[:n]
        inner += force[n:]
        return energy

    def _volume(self, s: Configuration) -> tuple[float, np.ndarray]:
        if self.name not in s.cache:
            gradient = np.empty_like(s.nodes[self.inner])
            volume = volume_gradient(s.nodes[self.inner], self.mesh.triangles, gradient)
            s.cache[self.name] = volume, gradient
        return s.cache[self.name]

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        self._forces(s, *out)

    def energy(self, s: Configuration) -> float:
        return self._forces(
            s, np.zeros_like(s.nodes[self.array]), np.zeros_like(s.nodes[self.inner])
        )

    def low_rank(self, s: Configuration) -> tuple[tuple[str, float, np.ndarray], ...]:
        if self.effect.modulus == 0.0:
            return ()
        return ((self.inner, self.effect.modulus / self.mesh.volume, self._volume(s)[1]),)

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        """Filaments by |a - b|^2 <= 2 |a|^2 + 2 |b|^2 on both ends, the shell as a membrane."""
        e, n = self.effect, len(s.nodes[self.array])
        both = np.concatenate([s.nodes[self.array], s.nodes[self.inner]])
        length = np.linalg.norm(both[self.links[:, 1]] - both[self.links[:, 0]], axis=1)
        excess = ((length - self.link_length) / self.link_length) ** 2
        weight = 2.0 * e.filament * (1.0 + 3.0 * e.stiffening * excess)
        load = np.bincount(self.links.ravel(), np.repeat(weight, 2), len(both))
        return (
            Stiffness(self.array, (0, 1, 2), lambda: diagonal(load[:n]), None),
            Stiffness(self.inner, (0, 1, 2), lambda: self._bound(s, load[n:]), None),
        )

    def _bound(self, s: Configuration, load: np.ndarray) -> sp.csc_array:
        e, m, x = self.effect, self.mesh, s.nodes[self.inner]
        length = np.linalg.norm(x[m.edges[:, 1]] - x[m.edges[:, 0]], axis=1)
        excess = ((length - m.edge_length) / m.edge_length) ** 2
        lines = laplacian(len(x), m.edges, e.line * (1.0 + 3.0 * e.stiffening * excess))
        areas = laplacian(len(x), *area_bound(x, m.triangles, m.triangle_area, e.area, 0.0))
        return lines + areas + diagonal(load)
