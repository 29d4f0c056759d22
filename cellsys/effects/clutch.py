"""Motor clutches of one cell on the nodes of the matrix in reach; parameters in `adhesion`.

    n' = k_on s (1 - n) - k_off n
    S' = n (sum_j w_ij v_j - (sum_j w_ij) v_i + v_m e_i) - k_off S

One law for every matrix. A `Foothold` gives the weights w, the share s of k_on that finds a
matrix, and in how many axes the clutch pulls: in the plane of a disc, in space in a gel. e_i
points away from the middle of the cell.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from cellsys.effects import clutch_kernels as kernels
from cellsys.effects.anchorage import Anchorage
from cellsys.effects.bond_laws import ClutchLaw
from cellsys.effects.footing import Foothold, NodalLoad, Weights
from cellsys.effects.matrix import MATRIX, FibreElement
from cellsys.effects.protocol import CellBody, Configuration, Element, Port, Stiffness
from cellsys.effects.tangent import diagonal
from cellsys.laws.clutch import reinforced_rate
from cellsys.system import Block


class ClutchElement(Anchorage):
    """Clutches of one cell: what the cell loses the matrix gains, by the same weights.

    Unbinding sees |k_b S + r|, r the loads of other elements that `carry` these clutches, and
    happens at k_off0 (1 + alpha k_h/(k + k_h)), k the stiffness of the matrix under the clutch.
    """

    def __init__(self, effect: ClutchLaw, cell: CellBody, footing: Foothold) -> None:
        self.effect, self.footing = effect, footing
        self.name = f"{cell.name}.{effect.name}"
        self.array = cell.name
        n = len(cell.membrane.position)
        self.ports = (
            Port(cell.name, self.name),
            footing.port(effect.name),
        )
        self.strength, self.stretch = f"{cell.name}.bond_strength", f"{cell.name}.bond_stretch"
        self.internal = (
            Block(self.strength, (n,), "1", role="component", kind="internal"),
            Block(self.stretch, (n, footing.axes), "um", role="component", kind="internal"),
        )
        self._load = NodalLoad(footing.matrix)
        self._carried: tuple[Callable[[Configuration], np.ndarray], ...] = ()
        self._fibres: FibreElement | None = None
        self._off_rates = np.full(n, effect.off_rate)

    def connect(self, built: Sequence[Element]) -> None:
        if self.effect.reinforcement > 0.0:
            self._fibres = next((e for e in built if isinstance(e, FibreElement)), None)

    def carry(self, load: Callable[[Configuration], np.ndarray]) -> None:
        """Unbinding sees the load too."""
        self._carried = (*self._carried, load)

    def forget(self) -> None:
        self._load.forget()

    def _weights(self, s: Configuration) -> Weights:
        return self.footing.weights(s)

    def strengths(self, s: Configuration) -> np.ndarray:
        """n (n,)."""
        return s.internal[self.strength]

    def pulls(self, s: Configuration) -> np.ndarray:
        """k_b S (n, 2), in a gel (n, 3), pN."""
        return self.effect.stiffness * s.internal[self.stretch]

    def _loads(self, s: Configuration) -> np.ndarray:
        """|k_b S + r| (n,), pN."""
        key = self.name + ".load"
        if key not in s.cache:
            stretch = s.internal[self.stretch]
            load = np.empty(len(stretch))
            if self._carried:
                total = self._carried[0](s)
                for further in self._carried[1:]:
                    total = total + further(s)
                kernels.total_loads(stretch, total, self.effect.stiffness, load)
            else:
                kernels.own_loads(stretch, self.effect.stiffness, load)
            s.cache[key] = load
        return s.cache[key]

    def off_rates(self, s: Configuration) -> np.ndarray:
        """Unloaded unbinding k_off0 (n,) of every clutch, 1/s."""
        if self._fibres is None:
            return self._off_rates
        key = self.name + ".off"
        if key not in s.cache:
            e = self.effect
            index, weight, count = self._weights(s)
            stiffness = self._fibres.nodal(s)["stiffness"]
            under = np.empty(len(count))
            kernels.gather_scalar(stiffness, index, weight, count, under)
            under /= np.maximum(self.footing.hold(s), 1e-12)
            s.cache[key] = reinforced_rate(
                e.off_rate, under, e.reinforcement, e.reinforcement_stiffness
            )
        return s.cache[key]

    def _on_rates(self, s: Configuration) -> np.ndarray:
        key = self.name + ".on"
        if key not in s.cache:
            s.cache[key] = self.footing.on_rates(s, self.effect)
        return s.cache[key]

    def efforts(self, s: Configuration, out: tuple[np.ndarray, ...]) -> None:
        e = self.effect
        kernels.clutch_loads(
            s.nodes[self.array],
            s.nodes[MATRIX],
            s.internal[self.strength],
            s.internal[self.stretch],
            *self._weights(s),
            self.footing.hold(s),
            e.stiffness,
            e.zipper,
            *out,
        )

    def energy(self, s: Configuration) -> float:
        """Zipper energy only: the stretch follows velocities, not positions; none in a gel."""
        if self.footing.axes == 3:
            return 0.0
        index, weight, count = self._weights(s)
        z = s.nodes[self.array][:, 2].copy()
        z -= (weight * s.nodes[MATRIX][index, 2]).sum(axis=1)
        n = s.internal[self.strength] * (count > 0)
        return 0.5 * self.effect.zipper * float(n @ z**2)

    def rates(self, s: Configuration, v: dict[str, np.ndarray], out: tuple) -> None:
        axes = self.footing.axes
        slip = np.empty((len(v[self.array]), axes))
        kernels.gather(v[MATRIX], *self._weights(s), slip)
        slip -= self.footing.hold(s)[:, None] * v[self.array][:, :axes]
        e = self.effect
        kernels.clutch_rates(
            s.nodes[self.array],
            s.internal[self.strength],
            s.internal[self.stretch],
            self._on_rates(s),
            slip,
            self._loads(s),
            self.off_rates(s),
            e.force_scale,
            e.retrograde_speed,
            *out,
        )

    def advance(self, s: Configuration, end: Configuration, dt: float) -> None:
        self._follow(s, s, end, dt)

    def advance_by_middle(
        self, s: Configuration, middle: Configuration, end: Configuration, dt: float
    ) -> None:
        self._follow(s, middle, end, dt)

    def _follow(self, s: Configuration, at: Configuration, end: Configuration, dt: float) -> None:
        """The bonds of `end`, by the rates and weights at `at`."""
        e, x = self.effect, s.nodes[self.array]
        slip = np.empty((len(x), self.footing.axes))
        kernels.slip(
            s.nodes[MATRIX],
            end.nodes[MATRIX],
            x,
            end.nodes[self.array],
            *self._weights(at),
            self.footing.hold(at),
            dt,
            slip,
        )
        kernels.clutch_advance(
            at.nodes[self.array],
            s.internal[self.strength],
            s.internal[self.stretch],
            self._on_rates(at),
            slip,
            dt,
            at.internal[self.strength],
            self._loads(at),
            self.off_rates(at),
            e.force_scale,
            e.retrograde_speed,
            end.internal[self.strength],
            end.internal[self.stretch],
        )

    def stiffness(self, s: Configuration) -> tuple[Stiffness, ...]:
        e = self.effect
        # Bond strengths grow by at most k_on per second: a margin of 0.2 lasts until the next look.
        n = np.minimum(s.internal[self.strength] + 0.2, 1.0)
        self._load.look(n, self._weights(s))
        if self.footing.axes == 3:
            bound = self._load
            return (
                Stiffness(self.array, (0, 1, 2), lambda: diagonal(e.stiffness * n), None),
                Stiffness(
                    MATRIX, (0, 1, 2), lambda: diagonal(e.stiffness * bound.bound), bound.key
                ),
            )
        greatest = max(e.stiffness, e.zipper)
        return (
            Stiffness(self.array, (0, 1), lambda: diagonal(e.stiffness * n), None),
            Stiffness(self.array, (2,), lambda: diagonal(e.zipper * n), None),
            Stiffness(
                MATRIX, (0, 1, 2), lambda: diagonal(greatest * self._load.bound), self._load.key
            ),
        )
