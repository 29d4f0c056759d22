"""Fibre bending: pairs of fibres that run on through a crosslink resist a change of their angle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from cellsys.compiled import compiled
from cellsys.effects.matrix import MATRIX
from cellsys.effects.protocol import (
    Configuration,
    Effect,
    Element,
    Port,
    Site,
    Stiffness,
    parameter,
)
from cellsys.effects.tangent import laplacian
from cellsys.geometry.network import FibreNetwork

_SOFT = 1e-6  # of |t1 x t2|^2: the angle of two fibres in line has a gradient


@compiled
def bend_forces(rest, u, triples, angle, modulus, force, present):
    """Add the forces of E = sum B/2 (theta - theta0)^2 to `force`; returns E.

    A triple (i, j, k) are two fibres d1 = x_j - x_i, d2 = x_k - x_j; theta is the angle between
    them. Present angles go into `present`.
    """
    energy = 0.0
    p, q, r = np.empty(3), np.empty(3), np.empty(3)
    for n in range(triples.shape[0]):
        i, j, k = triples[n, 0], triples[n, 1], triples[n, 2]
        l1, l2 = 1e-12, 1e-12
        for c in range(3):
            p[c] = rest[j, c] + u[j, c] - rest[i, c] - u[i, c]
            q[c] = rest[k, c] + u[k, c] - rest[j, c] - u[j, c]
            l1 += p[c] * p[c]
            l2 += q[c] * q[c]
        l1, l2 = np.sqrt(l1), np.sqrt(l2)
        cosine = 0.0
        for c in range(3):
            p[c] /= l1
            q[c] /= l2
            cosine += p[c] * q[c]
        r[0] = p[1] * q[2] - p[2] * q[1]
        r[1] = p[2] * q[0] - p[0] * q[2]
        r[2] = p[0] * q[1] - p[1] * q[0]
        sine = np.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2] + _SOFT)
        theta = np.arctan2(sine, cosine)
        present[n] = theta
        moment = modulus[n] * (theta - angle[n])
        energy += 0.5 * moment * (theta - angle[n])
        # d(theta) = (cos d(sin) - sin d(cos))/(sin^2 + cos^2), d(sin) = r.dr/sin
        scale = 1.0 / (sine * sine + cosine * cosine)
        w = cosine / sine
        g10, g20 = q[1] * r[2] - q[2] * r[1], r[1] * p[2] - r[2] * p[1]
        g11, g21 = q[2] * r[0] - q[0] * r[2], r[2] * p[0] - r[0] * p[2]
        g12, g22 = q[0] * r[1] - q[1] * r[0], r[0] * p[1] - r[1] * p[0]
        g1 = (w * g10 - sine * q[0], w * g11 - sine * q[1], w * g12 - sine * q[2])
        g2 = (w * g20 - sine * p[0], w * g21 - sine * p[1], w * g22 - sine * p[2])
        a1 = g1[0] * p[0] + g1[1] * p[1] + g1[2] * p[2]
        a2 = g2[0] * q[0] + g2[1] * q[1] + g2[2] * q[2]
        for c in range(3):
            f1 = moment * scale * (g1[c] - a1 * p[c]) / l1
            f2 = moment * scale * (g2[c] - a2 * q[c]) / l2
            force[i, c] += f1
            force[j, c] += f2 - f1
            force[k, c] -= f2
    return energy


@dataclass(frozen=True)
class FibreBending(Effect):
    """Bending stiffness at crosslinks, E = kappa_b/(2 l) (theta - theta0)^2.

    For every pair of fibres that meet at a node and deviate from a straight line by less than
    `straight`; theta0 is the angle at rest, l the mean of the two lengths at rest
    [notes: matrix, fibre bending].
    """

    name: ClassVar[str] = "fibre_bending"
    acts_on: ClassVar[str] = "matrix"
    needs: ClassVar[tuple[str, ...]] = ("matrix_elasticity",)
    not_on: ClassVar[dict[str, str]] = {"chain": "in one dimension nothing bends"}
    rigidity: float = parameter(
        "19.6 pN um^2", "pN um^2", least=0.0,
        source="derived from assumed d and E_f [notes: matrix, fibre bending]", about="kappa_b",
    )  # fmt: skip
    straight: float = parameter(
        "30 deg", "rad", above=0.0, most=np.pi / 2, source="assumed [notes: matrix, fibre bending]",
        about="deviation below which two fibres run on",
    )  # fmt: skip

    def elements(self, site: Site) -> tuple[Element, ...]:
        return (BendingElement(self, site.network),)


def straight_pairs(disc: FibreNetwork, most: float) -> np.ndarray:
    """Triples (i, j, k), int (m, 3): fibres i-j and j-k that deviate by less than `most`, rad."""
    ends = np.concatenate([disc.fibres, disc.fibres[:, ::-1]])
    ends = ends[np.lexsort((ends[:, 1], ends[:, 0]))]
    start = np.searchsorted(ends[:, 0], np.arange(len(disc.position) + 1))
    found = []
    for j in range(len(disc.position)):
        near = ends[start[j] : start[j + 1], 1]
        d = disc.position[near] - disc.position[j]
        d /= np.linalg.norm(d, axis=1)[:, None]
        a, b = np.nonzero(np.triu(-(d @ d.T) > np.cos(most), 1))
        found.append(np.column_stack([near[a], np.full(len(a), j), near[b]]))
    return np.concatenate(found).astype(np.int64)


class BendingElement(Element):
    """Bending of every pair of fibres that met at a node at rest."""

    def __init__(self, effect: FibreBending, disc: FibreNetwork) -> None:
        self.disc = disc
        self.name = f"{MATRIX}.{effect.name}"
        self.ports = (Port(MATRIX, self.name),)
        self.triples = straight_pairs(disc, effect.straight)
        i, j, k = self.triples.T
        x, m = disc.position, len(self.triples)
        self.lengths = np.linalg.norm(x[j] - x[i], axis=1), np.linalg.norm(x[k] - x[j], axis=1)
        self.modulus = 2.0 * effect.rigidity / (self.lengths[0] + self.lengths[1])
        self.angle, still = np.zeros(m), np.zeros_like(x)
        bend_forces(x, still, self.triples, np.zeros(m), np.zeros(m), still.copy(), self.angle)
        self._weight: np.ndarray | None = None
        self._key = 0

    def _look(self, s: Configuration, force: np.ndarray) -> tuple[float, np.ndarray]:
        theta, rest = np.empty(len(self.triples)), self.disc.position
        energy = bend_forces(
            rest, s.nodes[MATRIX], self.triples, self.angle, self.modulus, force, theta
        )
        return energy, theta

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        self._look(s, out[0])

    def energy(self, s: Configuration) -> float:
        return self._look(s, np.zeros_like(s.nodes[MATRIX]))[0]

    def forget(self) -> None:
        self._weight = None

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        """B (1 + 2 |theta - theta0|) (|d1|/l1 + |d2|/l2)^2, with (a + b)^2 <= 2 a^2 + 2 b^2.

        The second part is the turning of the gradient: of two fibres in line it is at most the
        excess of the angle.
        """
        _, theta = self._look(s, np.zeros_like(s.nodes[MATRIX]))
        weight = 2.0 * self.modulus * (1.0 + 2.0 * np.maximum(theta - self.angle, 0.0))
        kept = self._weight
        if kept is None or np.any(weight > kept):
            kept = self._weight = 1.3 * weight
            self._key += 1
        if not kept.any():
            return ()
        return (Stiffness(MATRIX, (0, 1, 2), partial(self._bound, kept), self._key),)

    def _bound(self, weight: np.ndarray) -> sp.csc_array:
        i, j, k = self.triples.T
        pairs = np.concatenate([np.column_stack([i, j]), np.column_stack([j, k])])
        l1, l2 = self.lengths
        weights = np.concatenate([weight / l1**2, weight / l2**2])
        return laplacian(len(self.disc.position), pairs, weights)
