"""Work-precision: every error next to its price.

Errors are measured against a tight reference by a method that is not in the sweep, accepted only
when a second, different method agrees with it. Error and time come from separate solves: one to
warm up and for the error, then the fastest of n for the time. A failure is a gap with its reason.
[Hairer and Wanner, Solving ODEs II, IV.10]
"""

from __future__ import annotations

import csv
import io
import os
import platform
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import ClassVar

import numpy as np

from cellsys.accuracy.measures import measure
from cellsys.accuracy.setups import CostProblem, Setup
from cellsys.arguments import checked
from cellsys.drawable import Drawable
from cellsys.errors import CellsysError, DataError, ParameterError
from cellsys.store.atomic import write_json, write_text

SLOW = 2.0  # s of a solve that other work on the machine no longer changes much


@checked
@dataclass(frozen=True, kw_only=True)
class WorkPoint:
    """One setting of one setup: its error and time, or why there is none (NaN)."""

    setup: str
    setting: float
    error: float
    seconds: float
    own: bool
    reason: str = ""


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class WorkPrecision(Drawable):
    """A finished sweep.

    Parameters
    ----------
    problem, measure : str
    points : tuple of WorkPoint
    references : tuple of str
        The two methods behind the reference.
    agreement : float
        How far the two are apart, in the measure: errors below ten times this are not to be
        told from zero.
    footer : mapping
        Machine, versions, seed.
    """

    problem: str
    measure: str
    points: tuple[WorkPoint, ...]
    references: tuple[str, str]
    agreement: float
    footer: dict[str, object] = field(default_factory=dict)

    _figure: ClassVar[str] = "work_precision"

    def measured(self) -> list[WorkPoint]:
        """Points that have a number."""
        return [p for p in self.points if np.isfinite(p.error) and np.isfinite(p.seconds)]

    def front(self) -> list[WorkPoint]:
        """Points that no other point beats in both error and time, loosest first."""
        found: list[WorkPoint] = []
        for point in sorted(self.measured(), key=lambda p: (p.seconds, p.error)):
            if not found or point.error < found[-1].error:
                found.append(point)
        return found

    def cheapest(self, error: float, *, own: bool | None = None) -> WorkPoint | None:
        """The fastest point whose error is at most `error`; None when there is none."""
        good = [p for p in self.measured() if p.error <= error and own in (None, p.own)]
        return min(good, key=lambda p: p.seconds) if good else None

    def table(self) -> list[list[str]]:
        """Rows of text: setup, setting, error, milliseconds or the reason of a gap."""
        front = set(self.front())
        return [
            [
                p.setup,
                f"{p.setting:.3g}",
                "-" if p.reason else f"{p.error:.1e}",
                p.reason[:60] if p.reason else f"{1e3 * p.seconds:.2f} ms",
                "front" if p in front else "",
            ]
            for p in self.points
        ]

    def save(self, folder: str | Path) -> tuple[Path, Path]:
        """Write ``<problem>.csv`` and ``<problem>.json`` into `folder`, atomically."""
        place = Path(folder)
        place.mkdir(parents=True, exist_ok=True)
        name = "".join(c if c.isalnum() else "_" for c in self.problem)
        text = io.StringIO()
        writer = csv.DictWriter(text, list(asdict(self.points[0])))
        writer.writeheader()
        writer.writerows(asdict(p) for p in self.points)
        write_text(place / f"{name}.csv", text.getvalue())
        plain = [
            {k: None if isinstance(v, float) and not np.isfinite(v) else v
             for k, v in asdict(p).items()}
            for p in self.points
        ]  # fmt: skip
        write_json(
            place / f"{name}.json",
            {
                "problem": self.problem,
                "measure": self.measure,
                "references": list(self.references),
                "agreement": self.agreement,
                "points": plain,
                **self.footer,
            },
        )
        return place / f"{name}.csv", place / f"{name}.json"

    def __str__(self) -> str:
        lines = [
            f"{self.problem}: {self.measure} error against {self.references[0]} "
            f"({self.references[1]} agrees to {self.agreement:.1e})"
        ]
        lines += ["  ".join(f"{cell:>14s}" for cell in row) for row in self.table()]
        lines.append(", ".join(f"{k} {v}" for k, v in self.footer.items()))
        return "\n".join(lines)


@checked
def work_precision(
    setups: Sequence[Setup],
    problem: CostProblem,
    reference: tuple[Setup, Setup],
    *,
    error: str = "maximum",
    repeats: int = 3,
    agree: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> WorkPrecision:
    """Sweep setups over their settings on one problem.

    Parameters
    ----------
    setups : sequence of Setup
    problem : CostProblem
    reference : pair
        Two `Setup` objects of different methods; the last (tightest) setting of each is used.
    error : str
        One of `cellsys.accuracy.MEASURES`.
    repeats : int
        Solves behind a time; the fastest counts. One is enough above `SLOW` seconds.
    agree : float, optional
        Largest disagreement of the two references in the measure; default 1e-6.
    progress : callable, optional
        Called with the share of the solves that is done.

    Raises
    ------
    ParameterError
        When the two references are one method, or one of them is in the sweep at its setting.
    DataError
        When they disagree by more than `agree`.
    """
    first, second = reference
    if first.name == second.name:
        raise ParameterError(
            f"two references of one method ({first.name}) cannot confirm each other"
        )
    if repeats < 1:
        raise ParameterError(f"repeats must be >= 1, got {repeats!r}")
    todo, done = 2 + sum(len(setup.settings) for setup in setups), 0

    def one_more() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done / todo)

    best = first.solve(problem, first.settings[-1])
    one_more()
    other = second.solve(problem, second.settings[-1])
    one_more()
    apart, bound = measure(error, other, best), 1e-6 if agree is None else agree
    if not apart <= bound:
        raise DataError(
            f"the references {first.name} and {second.name} are {apart:.1e} apart in "
            f"{error!r}, more than {bound:.1e}; tighten their settings"
        )
    points = []
    for setup in setups:
        for setting in setup.settings:
            points.append(_point(setup, setting, problem, best, error, repeats))
            one_more()
    return WorkPrecision(
        problem=problem.name,
        measure=error,
        points=tuple(points),
        references=(first.name, second.name),
        agreement=apart,
        footer=footer(problem.seed),
    )


def _point(
    setup: Setup, setting: float, problem: CostProblem, best: np.ndarray, error: str, repeats: int
) -> WorkPoint:
    nan = float("nan")
    try:
        with np.errstate(all="ignore"):
            found = setup.solve(problem, setting)
            value = measure(error, found, best)
            if not np.isfinite(value):
                return WorkPoint(
                    setup=setup.name,
                    setting=setting,
                    error=nan,
                    seconds=nan,
                    own=setup.own,
                    reason="states not finite",
                )
            times = []
            for _ in range(repeats):
                began = clock.perf_counter()
                setup.solve(problem, setting)
                times.append(clock.perf_counter() - began)
                if times[-1] > SLOW:
                    break
    except (CellsysError, RuntimeError, ArithmeticError) as failure:
        reason = f"{type(failure).__name__}: {' '.join(str(failure).split())}"
        return WorkPoint(
            setup=setup.name, setting=setting, error=nan, seconds=nan, own=setup.own, reason=reason
        )
    return WorkPoint(
        setup=setup.name, setting=setting, error=value, seconds=min(times), own=setup.own
    )


def footer(seed: int) -> dict[str, object]:
    """Machine, versions and seed."""
    return {
        "machine": f"{platform.machine()} {platform.system()}, {os.cpu_count()} cores",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": version("scipy"),
        "casadi": version("casadi"),
        "threads": os.environ.get("OMP_NUM_THREADS", "default"),
        "seed": seed,
    }
