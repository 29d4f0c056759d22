"""A budget held to an exhaustive search on a start that it has not seen."""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass

from cellsys.accuracy.budget import Budget, held_out_error
from cellsys.accuracy.setups import CostProblem, Setup
from cellsys.accuracy.starts import uncapped
from cellsys.arguments import checked
from cellsys.errors import ParameterError


@checked
@dataclass(frozen=True, kw_only=True)
class BudgetCheck:
    """What a budget's setting is worth on another start.

    Parameters
    ----------
    problem : str
    asked, error : float
        Asked error, and that of the budget's setting on this start.
    chosen, best : str
        The budget's setting, and the cheapest of all settings that meets the error here ("" when
        none does).
    ratio : float
        Time of the first over that of the second; NaN without a second.
    """

    problem: str
    asked: float
    error: float
    chosen: str
    best: str
    ratio: float

    @property
    def met(self) -> bool:
        """Whether the error is what was asked for or less."""
        return self.error <= self.asked


@checked
def check_budget(
    found: Budget,
    problem: CostProblem,
    setups: Sequence[Setup],
    reference: Setup,
    *,
    repeats: int = 3,
) -> BudgetCheck:
    """Run every setting of `setups` on `problem` and hold the budget's own to the cheapest.

    Parameters
    ----------
    found : Budget
        With an integrator that is one of the settings.
    problem : CostProblem
        A start that the budget has not seen.
    setups : sequence of Setup
        What is searched.
    reference : Setup
        Its last setting is the truth here.
    repeats : int
        The two that are compared are timed this often in turns; the fastest counts.

    Raises
    ------
    ParameterError
        When the budget is empty or its setting is not among those of `setups`.
    """
    truth = reference.solve(problem, reference.settings[-1])
    rows = []
    for setup in setups:
        for setting in setup.settings:
            began = clock.perf_counter()
            error = held_out_error(setup, setting, problem, truth, found.measure)
            rows.append((clock.perf_counter() - began, error, setup, setting))
    mine = [
        r
        for r in rows
        if (make := r[2].make) is not None and uncapped(make(r[3])) == found.integrator
    ]
    if not found or not mine:
        raise ParameterError(
            f"the budget's setting {found.integrator!r} is not among the settings searched"
        )
    good = [r for r in rows if r[1] <= found.error]
    best = min(good, key=lambda r: r[0], default=None)
    pair = [mine[0], *([best] if best else [])]
    least = [float("inf")] * len(pair)
    for _ in range(repeats):
        for k, (_, _, setup, setting) in enumerate(pair):
            began = clock.perf_counter()
            setup.solve(problem, setting)
            least[k] = min(least[k], clock.perf_counter() - began)
    names = [f"{setup.name} {setting:g}" for _, _, setup, setting in pair]
    return BudgetCheck(
        problem=problem.name,
        asked=found.error,
        error=mine[0][1],
        chosen=names[0],
        best=names[1] if best else "",
        ratio=least[0] / least[1] if best else float("nan"),
    )
