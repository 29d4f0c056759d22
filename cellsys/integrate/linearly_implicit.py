"""Linearly implicit Euler: implicit steps of first order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellsys.arguments import checked
from cellsys.integrate.implicit_steps import ImplicitMethod, ImplicitStepper
from cellsys.integrate.stepping import Stepper
from cellsys.system import OdeSystem


@checked
@dataclass(frozen=True, kw_only=True)
class LinearlyImplicit(ImplicitMethod):
    """First-order W-method for overdamped systems: one force evaluation and one solve a step.

    With the tangent itself it is implicit Euler; with one too large by a factor it stays first
    order and stable, while one below 3/4 of the tangent would oscillate (the two-cycle of a
    lagged tangent).

    Parameters
    ----------
    step : float
        Largest step, s.
    refresh : int
        Steps between two looks at the tangent; a block is factorised again only when its
        system says that it changed.
    corrections : int
        Most corrections of one step. A further one is made only while some block leaves more
        than `tolerance` unexplained (start of a run, kink of a command, rupture).
    tolerance : float
        Share of a block's rate that one step may leave over: |M delta| / |C v|.
    largest_move : float
        Largest displacement of a node in one step, um; a step beyond it is halved, at most ten
        times, and then fails.
    """

    def start(
        self, system: OdeSystem, t0: float, x0: np.ndarray, rng: np.random.Generator
    ) -> Stepper:
        """A stepper at (t0, x0)."""
        return ImplicitStepper(self, self.overdamped(system), t0, x0, rng)
