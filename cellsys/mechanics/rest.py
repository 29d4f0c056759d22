"""The start of a cell that keeps its volume: the free cell's equilibrium.

A sphere of a mesh is not where a discrete tension and a pressure balance: nodes of five and of
seven neighbours are left with some 30 pN at gamma = 150 pN/um. What is left moves the nodes by a
tenth of a micrometre against the membrane's own springs, from x = sphere to F(x) = 0:

    x <- x + M^-1 F(x),   M >= -dF/dx the over-estimates that elements state of their tangents,

a descent on the cell's energy, sped up by combining the last steps (Anderson, J. ACM 12, 1965).
F are all forces that the cell exerts on itself: what has an outside, or reaches the matrix or
another cell, is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from cellsys.effects.protocol import Configuration, Element, JunctionArray
from cellsys.errors import SceneError

_LEFT = 1e-11  # greatest force left, as a share of the greatest at the sphere
_ROUNDING = 3e-10  # pN: what forces that cancel leave over is no load
_MOST = 2000  # iterations; some tens are usual
_LOOK = 50  # iterations for which one M is kept
_DEPTH = 12  # steps that are combined


def rested(
    arrays: Sequence[JunctionArray], elements: Sequence[Element], *, lies: bool = True
) -> list[JunctionArray]:
    """The arrays with every cell of a given pressure at rest; elements that `balance` are told.

    A cell that `lies` on something keeps the height of its lowest node.

    Raises
    ------
    SceneError
        When a cell finds no rest.
    """
    out = list(arrays)
    for cell in [array.name for array in arrays if "." not in array.name]:
        own = [a for a in out if a.name == cell or a.name.startswith(f"{cell}.")]
        moved = _rest(cell, own, elements, lies)
        out = [a._replace(start=moved[a.name]) if a.name in moved else a for a in out]
    return out


def _rest(
    cell: str, own: list[JunctionArray], elements: Sequence[Element], lies: bool
) -> dict[str, np.ndarray]:
    """New starts of the cell's arrays; none where nothing asks for a cell at rest."""
    names = {a.name for a in own}
    inner = [
        e
        for e in elements
        if e.ports and not e.outside and all(port.array in names for port in e.ports)
    ]
    internal = {b.name: np.asarray(e.initial(b), float) for e in elements for b in e.internal}
    start = {a.name: np.array(a.start, float) for a in own}
    body = _Body(inner, internal)
    s = body.at(start)
    asked = [e for e in inner if e.balance(s, [other for other in inner if other is not e])]
    # Only springs bring nodes back that slide along the surface.
    springs = [e for e in inner if e.name == f"{cell}.membrane_elasticity"]
    held = any(abs(part.matrix()).sum() > 0.0 for e in springs for part in e.stiffness(s))
    if not (asked and held):
        return {}
    found = body.settle(start, f"volume of {cell}")
    if found is start:
        return {}
    if not lies:
        return found
    sunk = start[cell][:, 2].min() - found[cell][:, 2].min()
    for name, x in found.items():
        if name != f"{cell}.cortex":  # an offset, not a place
            x[:, 2] += sunk
    return found


@dataclass(frozen=True)
class _Body:
    """The elements that act within one cell, and the internal states at the start."""

    elements: Sequence[Element]
    internal: dict[str, np.ndarray]

    def at(self, nodes: dict[str, np.ndarray]) -> Configuration:
        return Configuration(0.0, nodes, self.internal)

    def forces(self, s: Configuration) -> dict[str, np.ndarray]:
        total = {name: np.zeros_like(x) for name, x in s.nodes.items()}
        for element in self.elements:
            out = tuple([np.zeros_like(total[port.array]) for port in element.ports])
            element.efforts(s, out)
            for port, part in zip(element.ports, out, strict=True):
                total[port.array] += part
        return total

    def bounds(self, s: Configuration) -> dict[str, np.ndarray]:
        """M of every array, (3 n, 3 n), plus a thousandth of its mean for the rigid motions."""
        out = {name: np.zeros((x.size, x.size)) for name, x in s.nodes.items()}
        for element in self.elements:
            for part in element.stiffness(s):
                dense = part.matrix().toarray()
                for axis in part.axes:
                    out[part.array][axis::3, axis::3] += dense
                if not part.axes:
                    out[part.array] += dense
            for array, k, direction in element.low_rank(s):
                flat = direction.ravel()
                out[array] += k * np.outer(flat, flat)
        for M in out.values():
            # An array that nothing holds, such as a nucleus without stiffness, stays in place.
            M[np.diag_indices(len(M))] += 1e-3 * np.trace(M) / len(M) or 1.0
        return out

    def settle(self, start: dict[str, np.ndarray], what: str) -> dict[str, np.ndarray]:
        """Nodes where all forces vanish; `start` itself where nothing pulls."""
        s = self.at(start)
        force = self.forces(s)
        size = max(float(np.abs(f).max()) for f in force.values())
        if size <= _ROUNDING:
            return start
        names, x = list(start), np.concatenate([v.ravel() for v in start.values()])
        ends = np.cumsum([v.size for v in start.values()])[:-1]

        def split(flat: np.ndarray) -> dict[str, np.ndarray]:
            parts = np.split(flat, ends)
            return {n: p.reshape(-1, 3) for n, p in zip(names, parts, strict=True)}

        factors: list[tuple[np.ndarray, bool]] = []
        tried: list[np.ndarray] = []
        steps: list[np.ndarray] = []
        for k in range(_MOST):
            if k % _LOOK == 0:
                bounds = self.bounds(s)
                factors, tried, steps = [sla.cho_factor(bounds[n]) for n in names], [], []
            pulls = [force[n].ravel() for n in names]
            step = np.concatenate(
                [sla.cho_solve(f, p) for f, p in zip(factors, pulls, strict=True)]
            )
            tried, steps = [*tried, x][-_DEPTH:], [*steps, step][-_DEPTH:]
            x = x + step
            if len(steps) > 1:
                # The combination of the last steps that would have been the least one.
                change = np.diff(np.array(steps), axis=0).T
                least = sla.lstsq(change, step, cond=1e-10)[0]
                x = x - (np.diff(np.array(tried), axis=0).T + change) @ least
            s = self.at(split(x))
            force = self.forces(s)
            left = max(float(np.abs(f).max()) for f in force.values())
            if not np.isfinite(left) or left > 1e3 * size:
                break
            if left <= max(_LEFT * size, _ROUNDING):
                return s.nodes
        raise SceneError(
            f"{what} finds no equilibrium of the free cell at the start: the greatest force is "
            f"{left:.3g} pN after {k + 1} iterations, {size:.3g} pN at the sphere; lower the "
            "tension, stiffen the membrane, or set volume.pressure = 'zero'"
        )
