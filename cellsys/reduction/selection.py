"""Choosing a model by roll-out errors on validation runs, and how much data it needs.

Runs are split, never samples: neighbouring samples of one run are all but the same. The choice
is nested: an outer fold is held out while the inner folds choose, so that the reported error
never saw the run it is measured on.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import ReducedModel, Reductor
from cellsys.drawable import Drawable
from cellsys.errors import DataError, ParameterError
from cellsys.kinds import Seed
from cellsys.model.card import card_of
from cellsys.reduction.basis import check_order
from cellsys.reduction.comparison import measured, refuse_shared_runs
from cellsys.reduction.reduce import described, name_of, reduce
from cellsys.samples.snapshots import Snapshots
from cellsys.threads import one_thread


@checked
def candidates(method: Reductor, settings: Mapping[str, Sequence[object]]) -> list[Reductor]:
    """The method with every combination of the settings.

    ``candidates(Ridge(), {"ridge": [1e-3, 1]})`` gives two methods.

    Raises
    ------
    ParameterError
        A setting the method does not have.
    """
    if not dataclasses.is_dataclass(method) or isinstance(method, type):
        raise ParameterError(f"method must be a dataclass to have settings, got {method!r}")
    known = {f.name for f in dataclasses.fields(method)}
    for name in settings:
        if name not in known:
            raise ParameterError(
                f"{name_of(method)} has no {name!r}; it has {', '.join(sorted(known))}"
            )
    return [
        dataclasses.replace(method, **dict(zip(settings, values, strict=True)))
        for values in itertools.product(*settings.values())
    ]


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """Mean validation error of a method at an order, and its spread (sd) over folds."""

    method: str
    order: int
    settings: str
    error: float
    spread: float


@dataclass(frozen=True, kw_only=True)
class OuterFold:
    """One held-out group: its runs, what the inner folds chose, and its error there."""

    runs: tuple[str, ...]
    settings: str
    order: int
    error: float
    validation_error: float


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Selection(Drawable):
    """What `select_model` chose, and what the choice is worth.

    Attributes
    ----------
    model : ReducedModel
        The chosen method and order, learned from all runs.
    method, settings, order
        The choice: reductor, the same in words, order.
    error : float
        Nested: root mean square over outer folds of the error of what the *inner* folds chose.
    validation_error : float
        Of the choice, on the runs that chose it: flattering, and shown to be compared.
    rows, folds : tuples
        Candidates, best first, and outer folds.
    """

    model: ReducedModel
    method: Reductor
    settings: str
    order: int
    error: float
    validation_error: float
    rows: tuple[Candidate, ...]
    folds: tuple[OuterFold, ...]

    _figure: ClassVar[str] = "selection"

    def __str__(self) -> str:
        lines = [f"{'model':>14s} {'m':>4s} {'validation':>11s} {'spread':>8s}  settings"]
        for r in self.rows[:12]:
            lines.append(
                f"{r.method:>14s} {r.order:4d} {_number(r.error):>11s} {_number(r.spread):>8s}  "
                f"{r.settings}"
            )
        if len(self.rows) > 12:
            lines.append(f"{'':14s}      and {len(self.rows) - 12} worse")
        lines.append(
            f"chosen: {self.settings} at order {self.order}; nested error {_number(self.error)} "
            f"(validation {_number(self.validation_error)})"
        )
        same = sum((f.settings, f.order) == (self.settings, self.order) for f in self.folds)
        lines.append(f"{same} of {len(self.folds)} outer folds choose the same")
        return "\n".join(lines)


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "diverges"


@checked
@one_thread()
def select_model(
    data: Snapshots,
    methods: Sequence[Reductor],
    orders: Sequence[int],
    *,
    folds: int = 4,
    inner: int = 3,
    seed: Seed = 0,
    progress: Callable[[float], None] | None = None,
) -> Selection:
    """Choose method, settings and order by roll-out error, split by run and nested.

    Parameters
    ----------
    data : Snapshots
        All training runs; test runs stay outside.
    methods : sequence of reductors
        Anything with ``fit(snapshots, order, *, test=None, basis=None)``; see `candidates`
        for their settings.
    orders : sequence of int
    folds, inner : int
        Outer folds (the reported error) and inner ones (the choice), at most one a run.
    seed : int
        Of the deal of runs to folds.
    progress : callable, optional
        Called with the share done.

    Raises
    ------
    DataError
        Fewer than three runs: nothing can be nested.
    """
    methods = tuple(methods)
    if not methods or not len(orders):
        raise ParameterError("select_model needs at least one order and one method")
    for order in orders:
        check_order(order)
    if folds < 2 or inner < 2:
        raise ParameterError(f"folds and inner must be >= 2, got {folds} and {inner}")
    n = len(data.runs)
    if n < 3:
        raise DataError(f"choosing needs at least 3 runs, got {n}; add runs")
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    dealt = [int(i) for i in rng.permutation(n)]
    outer = deal(dealt, folds)
    total, done = sum(min(inner, n - len(o)) for o in outer) + min(inner, n), 0

    def told() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done / total)

    reported = []
    for held in outer:
        rest = [i for i in dealt if i not in held]
        table = _validation(data, rest, methods, orders, inner, told)
        best = _best(table)
        method, order = _pairs(methods, orders)[best]
        kept, tested = _of(data, rest), _of(data, held)
        error = _errors(kept, tested, [method], [order])[0]
        labels = tuple(data.runs[i].label for i in held)
        reported.append(
            OuterFold(
                runs=labels,
                settings=described(method),
                order=order,
                error=error,
                validation_error=float(table[:, best].mean()),
            )
        )
    table = _validation(data, dealt, methods, orders, inner, told)
    pairs = _pairs(methods, orders)
    ranked = sorted(range(len(pairs)), key=lambda k: _mean(table[:, k]))
    rows = [
        Candidate(
            method=name_of(pairs[k][0]),
            order=pairs[k][1],
            settings=described(pairs[k][0]),
            error=_mean(table[:, k]),
            spread=float(np.std(table[:, k])) if np.all(np.isfinite(table[:, k])) else float("inf"),
        )
        for k in ranked
    ]
    method, order = pairs[ranked[0]]
    nested = float(np.sqrt(np.mean(np.square([f.error for f in reported]))))
    return Selection(
        model=reduce(data, order=order, method=method),
        method=method,
        settings=described(method),
        order=order,
        error=nested,
        validation_error=rows[0].error,
        rows=tuple(rows),
        folds=tuple(reported),
    )


def deal(runs: Sequence[int], folds: int) -> list[list[int]]:
    """Runs dealt round into at most `folds` groups, none of them empty."""
    count = min(folds, len(runs))
    return [list(runs[k::count]) for k in range(count)]


def _of(data: Snapshots, runs: Sequence[int]) -> Snapshots:
    return dataclasses.replace(data, runs=tuple(data.runs[i] for i in sorted(runs)))


def _pairs(methods: Sequence[Reductor], orders: Sequence[int]) -> list[tuple[Reductor, int]]:
    return [(m, order) for m in methods for order in orders]


def _errors(
    train: Snapshots, test: Snapshots, methods: Sequence[Reductor], orders: Sequence[int]
) -> list[float]:
    """Held-out error on the first block of every (method, order), inf where it diverges."""
    found: dict[int, list[float]] = {}
    for model, method, _, _ in measured(train, test, orders, methods):
        held = card_of(model).held_out
        if not held:
            raise ParameterError("there are no positions in these data to measure errors on")
        error = float(next(iter(held.values()))["model"])
        found.setdefault(id(method), []).append(error if error < 1e6 else float("inf"))
    return [found[id(m)][k] for m in methods for k in range(len(orders))]


def _validation(
    data: Snapshots,
    runs: Sequence[int],
    methods: Sequence[Reductor],
    orders: Sequence[int],
    folds: int,
    told: Callable[[], None],
) -> np.ndarray:
    """Errors (folds, candidates) with one group of `runs` left out at a time."""
    table = []
    for group in deal(runs, folds):
        rest = [i for i in runs if i not in group]
        table.append(_errors(_of(data, rest), _of(data, group), methods, orders))
        told()
    return np.array(table)


def _mean(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def _best(table: np.ndarray) -> int:
    return int(np.argmin([_mean(column) for column in table.T]))


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class LearningCurve(Drawable):
    """Errors against the number of training runs, mean and sd over the draws of runs."""

    counts: tuple[int, ...]
    held_out: np.ndarray
    held_out_spread: np.ndarray
    training: np.ndarray
    training_spread: np.ndarray
    settings: str
    order: int

    _figure: ClassVar[str] = "learning_curve"

    def __str__(self) -> str:
        lines = [
            f"{self.settings} at order {self.order}",
            f"{'runs':>5s} {'held out':>9s} {'spread':>8s} {'training':>9s}",
        ]
        for k, count in enumerate(self.counts):
            lines.append(
                f"{count:5d} {_number(self.held_out[k]):>9s} "
                f"{_number(self.held_out_spread[k]):>8s} {_number(self.training[k]):>9s}"
            )
        return "\n".join(lines)


@checked
@one_thread()
def learning_curve(
    train: Snapshots,
    test: Snapshots,
    method: Reductor,
    order: int,
    counts: Sequence[int] | None = None,
    *,
    draws: int = 3,
    seed: Seed = 0,
) -> LearningCurve:
    """Held-out error against the number of training runs.

    Parameters
    ----------
    train, test : Snapshots
        Different runs.
    method : reductor
    order : int
    counts : sequence of int, optional
        Numbers of runs; default 1, 2, 4, ... and all. Of each, `draws` random subsets are
        learned from (one where it is all of them); smaller subsets lie inside larger ones.
    seed : int
        Of the draws.
    """
    refuse_shared_runs(train, test)
    n = len(train.runs)
    if counts is None:
        counts = sorted({*(2**k for k in range(n.bit_length()) if 2**k <= n), n})
    if not len(counts) or min(counts) < 1 or max(counts) > n:
        raise ParameterError(f"counts must lie between 1 and the {n} training runs, got {counts}")
    if draws < 1:
        raise ParameterError(f"draws must be >= 1, got {draws}")
    errors = np.full((2, len(counts), draws), np.nan)
    for d in range(draws):
        rng = np.random.default_rng(np.random.SeedSequence([seed, d]))
        dealt = [int(i) for i in rng.permutation(n)]
        for k, count in enumerate(counts):
            if count == n and d > 0:
                continue
            card = card_of(reduce(_of(train, dealt[:count]), order=order, method=method, test=test))
            for side, part in enumerate((card.held_out, card.training)):
                value = float(next(iter(part.values()))["model"])
                errors[side, k, d] = value if value < 1e6 else np.inf
    with np.errstate(invalid="ignore"):
        mean, spread = np.nanmean(errors, axis=2), np.nanstd(errors, axis=2)
    return LearningCurve(
        counts=tuple(int(c) for c in counts),
        held_out=mean[0],
        held_out_spread=spread[0],
        training=mean[1],
        training_spread=spread[1],
        settings=described(method),
        order=order,
    )
