"""A matrix field as a system with a step of its own: states q, inputs the loads on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cellsys.contracts import SteppedField
from cellsys.field.descent import StepInfo
from cellsys.integrate.estimate import EULER
from cellsys.integrate.step_runs import StepRun
from cellsys.system import Block, Layout


@dataclass(frozen=True, eq=False)
class FieldSystem:
    """C q' = F(q) + load by implicit Euler steps, the load held over each.

    Parameters
    ----------
    field : SteppedField
        Such as cs.GalerkinField(system).
    dt : float
        s.
    x0 : (order,)
        um.
    """

    field: SteppedField
    dt: float
    x0: np.ndarray

    @property
    def states(self) -> Layout:
        """``field.modes`` (order,), um."""
        return Layout([Block("field.modes", (self.field.order,), "um", role="field")])

    @property
    def better_by(self) -> tuple[str, float]:
        """How `better` is better; the error of implicit Euler over its distance to half steps."""
        return "half the step", EULER

    def better(self) -> FieldSystem:
        """Half the step."""
        return replace(self, dt=0.5 * self.dt)

    def begin(self) -> FieldRun:
        """A run, whose steps remember each other."""
        return FieldRun(self)

    def step(self, x: np.ndarray, u: np.ndarray | None, t: float) -> np.ndarray:
        """q a step later, under no load when u is left out."""
        return self.begin().step(x, u, t)


class FieldRun(StepRun):
    """A run: the memory of the steps, and how each went."""

    system: FieldSystem

    def __init__(self, system: FieldSystem) -> None:
        super().__init__(system)
        self.memory, self.infos = system.field.memory(), list[StepInfo]()

    def step(self, x: np.ndarray, u: np.ndarray | None, t: float) -> np.ndarray:
        """q a step later."""
        load = np.zeros(len(x)) if u is None else u
        q, info = self.system.field.step(x, load, self.system.dt, memory=self.memory, t=t)
        self.infos.append(info)
        return q

    def statistics(self) -> Mapping[str, float]:
        """Evaluations, halvings, fresh tangents, largest residual and least balance, pN um."""
        infos = self.infos
        return {
            "evaluations": sum(i.iterations for i in infos),
            "halvings": sum(i.halvings for i in infos),
            "fresh": sum(i.fresh for i in infos),
            "residual": max((i.residual for i in infos), default=0.0),
            "least_balance": min((i.work - i.gain for i in infos), default=0.0),
        }
