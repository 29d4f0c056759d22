"""Reductors side by side on held-out runs: `compare_reductors`."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import ReducedModel, Reductor
from cellsys.drawable import Drawable
from cellsys.errors import CellsysError, ParameterError
from cellsys.model.card import BASELINES, DIVERGED, card_of, compared
from cellsys.reduction.basis import Basis, check_order, fit_basis
from cellsys.reduction.contractive import Contractive
from cellsys.reduction.least_squares import LeastSquares
from cellsys.reduction.pcr import PCR
from cellsys.reduction.reduce import brings_basis, completed, described, name_of, reduce_orders
from cellsys.reduction.ridge import Ridge
from cellsys.samples.provenance import repeated_runs
from cellsys.samples.snapshots import Snapshots
from cellsys.threads import one_thread

METHODS = (PCR(), LeastSquares(), Ridge(), Contractive())


@checked
@dataclass(frozen=True, kw_only=True)
class ComparedModel:
    """One row: what a model is worth held out, how stable it is, what it costs.

    `error` is the relative roll-out error rc on `block`
    [notes: theory, errors and baselines], infinite where the model
    diverges; `floor` the projection floor; `abscissa` in 1/s and `radius` per step of the model
    (NaN for a continuous one); `fit_s` without the shared basis; `roll_out_ms` of one held-out
    run, reconstruction left out (NaN where the model diverges); `growth`, `growth_bound` in 1/s
    of the pole that most certainly grows; `apart` the least difference to a baseline that these
    runs can tell.
    """

    method: str
    order: int
    settings: str
    error: float
    floor: float
    abscissa: float
    radius: float
    fit_s: float
    roll_out_ms: float
    verdict: str
    growth: float = float("nan")
    growth_bound: float = 0.0
    apart: float = 0.0

    @property
    def diverges(self) -> bool:
        """Whether a held-out roll-out left all bounds."""
        return not self.error < DIVERGED


@checked
@dataclass(frozen=True, kw_only=True)
class Comparison(Drawable):
    """Rows of `compare_reductors`, the baselines on the same runs, and the price of the basis."""

    rows: tuple[ComparedModel, ...]
    baselines: Mapping[str, float]
    block: str
    runs: tuple[int, int]
    basis_s: float

    _figure: ClassVar[str] = "comparison"

    @property
    def best(self) -> ComparedModel:
        """The row with the smallest held-out error."""
        return min(self.rows, key=lambda r: r.error)

    def row(self, method: str, order: int) -> ComparedModel:
        """The first row of that method (name or settings) and order; KeyError otherwise."""
        for r in self.rows:
            if method in (r.method, r.settings) and r.order == order:
                return r
        raise KeyError(f"no row {method!r} of order {order}")

    def __str__(self) -> str:
        width = max(len(r.method) for r in self.rows)
        lines = [
            f"held-out roll-out error on {self.block} / their motion; "
            f"{self.runs[0]} training runs, {self.runs[1]} held out; basis {self.basis_s:.1f} s",
            f"{'model':>{width}s} {'m':>4s} {'error':>9s} {'floor':>7s} {'abscissa 1/s':>13s} "
            f"{'radius':>8s} {'fit s':>7s} {'roll-out ms':>12s}",
        ]
        for r in self.rows:
            error = "diverges" if r.diverges else f"{r.error:.3g}"
            lost = r.growth > r.growth_bound and not r.error < 1.0
            note = f"   grows like exp({r.growth:.2g} t)" if lost else ""
            lines.append(
                f"{r.method:>{width}s} {r.order:4d} {error:>9s} {r.floor:7.3g} "
                f"{r.abscissa:13.2e} {r.radius:8.5f} {r.fit_s:7.2f} {r.roll_out_ms:12.2f}{note}"
            )
        lines += [f"{'':>{width}s}      {v:9.3g}  {k}" for k, v in self.baselines.items()]
        lines.append(self.verdict())
        return "\n".join(lines)

    def verdict(self) -> str:
        """One sentence: the best model against the best baseline."""
        name, value = min(self.baselines.items(), key=lambda item: item[1])
        best = self.best
        if best.diverges:
            return "every model diverges on held-out runs; predict with none of them"
        word = compared(best.error, value, best.apart)
        word += " from" if word == "not told apart" else " than"
        lost = sum(compared(r.error, value, r.apart) != "better" for r in self.rows)
        return (
            f"best: {best.method} at order {best.order} with {best.error:.3g}, {word} {name} "
            f"({value:.3g}); {lost} of {len(self.rows)} models do not beat that"
        )


@checked
@one_thread()
def compare_reductors(
    train: Snapshots,
    test: Snapshots,
    orders: Sequence[int],
    methods: Sequence[Reductor] | None = None,
) -> Comparison:
    """Fit every method at every order and measure whole roll-outs of the held-out runs.

    Parameters
    ----------
    train, test : Snapshots
        Different runs; one that occurs in both, sample by sample, is refused.
    orders : sequence of int
    methods : sequence of reductors, optional
        Anything with ``fit(snapshots, order, *, test=None, basis=None)``; default PCR,
        LeastSquares, Ridge, Contractive.

    Returns
    -------
    Comparison
        A model that diverges is a row that says so, with its growth rate.

    Raises
    ------
    ParameterError
        No orders or methods, runs in both sets, no positions to measure.
    RankError
        An order beyond the data's rank.
    """
    tried: Sequence[Reductor] = METHODS if methods is None else tuple(methods)
    if not tried or not len(orders):
        raise ParameterError("compare_reductors needs at least one order and one method")
    for order in orders:
        check_order(order)
    refuse_shared_runs(train, test)
    seen: dict[str, float] = {}
    rows, block, basis_s = [], "", 0.0
    for model, method, seconds, shared_s in measured(train, test, orders, tried):
        basis_s = max(basis_s, shared_s)
        held = card_of(model).held_out
        if not held:
            raise ParameterError("there are no positions in these data to measure errors on")
        block = block or next(iter(held))
        seen = {k: v for k, v in held[block].items() if k in BASELINES} | seen
        rows.append(_row(model, method, held[block], seconds, test))
    return Comparison(
        rows=tuple(rows),
        baselines=seen,
        block=block,
        runs=(len(train.runs), len(test.runs)),
        basis_s=basis_s,
    )


def refuse_shared_runs(train: Snapshots, test: Snapshots) -> None:
    """ParameterError where a held-out run is a training run, sample by sample.

    Labels do not tell: runs given as arrays are numbered from 0 in every set.
    """
    for i in repeated_runs(test, train)[:1]:
        name = test.runs[i].label or f"run {i}"
        raise ParameterError(f"{name!r} is in the training and in the held-out set; split by run")


def measured(
    train: Snapshots, test: Snapshots, orders: Sequence[int], methods: Sequence[Reductor]
) -> Iterator[tuple[ReducedModel, Reductor, float, float]]:
    """(model with card, its method, seconds of its fit, seconds of the shared basis).

    Methods that learn in the common basis share it and the latent samples; the others bring
    their own coordinates.
    """
    shared = [m for m in methods if not brings_basis(m)]
    basis_s, basis = 0.0, None
    if shared:
        began = time.perf_counter()
        basis = fit_basis(train, max(orders)).with_parts(train)
        basis_s = time.perf_counter() - began
        seconds: list[float] = []
        timed = [_Timed(m, seconds) for m in shared]
        found = reduce_orders(train, timed, orders, test, basis)
        for k, model in enumerate(found):
            yield model, shared[k // len(orders)], seconds[-1], basis_s
    for method in methods:
        if method in shared:
            continue
        for order in orders:
            began = time.perf_counter()
            model = method.fit(train, order, test=test)
            spent = time.perf_counter() - began
            model = completed(model, method, train, test)
            yield model, method, float(model.notes.get("fit_seconds", spent)), basis_s


@dataclass(frozen=True)
class _Timed:
    """A reductor that notes how long each fit took."""

    method: Reductor
    seconds: list[float]

    def fit(
        self,
        data: Snapshots,
        order: int,
        *,
        test: Snapshots | None = None,
        basis: Basis | None = None,
    ) -> ReducedModel:
        began = time.perf_counter()
        model = self.method.fit(data, order, test=test, basis=basis)
        self.seconds.append(time.perf_counter() - began)
        return model


def _row(
    model: ReducedModel,
    method: Reductor,
    held: Mapping[str, float],
    seconds: float,
    test: Snapshots,
) -> ComparedModel:
    card = card_of(model)
    error, abscissa = float(held["model"]), card.spectral_abscissa
    growth, growth_bound = card.growth or (float("nan"), 0.0)
    fine = error < DIVERGED
    with np.errstate(over="ignore"):
        radius = float("nan") if model.dt is None else float(np.exp(model.dt * abscissa))
    return ComparedModel(
        method=name_of(method),
        order=model.order,
        settings=described(method),
        error=error if fine else float("inf"),
        floor=float(held.get("floor", float("nan"))),
        abscissa=abscissa,
        radius=radius,
        fit_s=seconds,
        roll_out_ms=1e3 * _price(model, test) if fine else float("nan"),
        verdict=card.verdict,
        growth=growth,
        growth_bound=growth_bound,
        apart=held.get("resolution", 0.0),
    )


def _price(model: ReducedModel, test: Snapshots) -> float:
    """Seconds of one roll-out as long as the first held-out run, minimum of 3; commands zero.

    NaN where it cannot be rolled out that far without commands.
    """
    length = test.dt * (len(test.runs[0].x) - 1)
    step = test.dt if model.dt is None else model.dt
    t = step * np.arange(round(length / step) + 1)
    start = np.zeros(model.order) if model.z_start is None else model.z_start
    times = []
    for _ in range(3):
        began = time.perf_counter()
        try:
            model.predict(start, None, t)
        except CellsysError:
            return float("nan")
        times.append(time.perf_counter() - began)
    return min(times)
