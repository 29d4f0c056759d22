"""Axes of cost: time and error against order, training runs, adhesion kinetics, coupling, cells.

Every sweep gives a `CostAxis`, rows of one setting with its time and its errors. Nothing is fitted
or compared here that `compare_reductors`, `learning_curve` and `couple` do not do themselves.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import Cells, Integrator, LinearModel, Reductor
from cellsys.effects.protocol import Effect
from cellsys.errors import DataError, ParameterError
from cellsys.integrate import DOP853, Exponential, LinearlyImplicit, simulate
from cellsys.integrate.record import check_times
from cellsys.kinds import Count, Seed
from cellsys.population import (
    Feedback,
    InteractionGraph,
    MappedSuperposition,
    Superposition,
    couple,
)
from cellsys.reduction import compare_reductors, learning_curve
from cellsys.samples import Snapshots
from cellsys.scene import Scene, build
from cellsys.shown import Shown

NUDGE = 1e-13  # of one weight: enough for the dense route, far below every tolerance
SHIFT = 0.005  # um
MOVING = ("cell1.position", "matrix.displacement")


@checked
@dataclass(frozen=True)
class CostRow:
    """One setting: its time, s, and its errors by name (NaN or absent: not measured)."""

    setting: str
    seconds: float
    errors: Mapping[str, float]


@checked
@dataclass(frozen=True)
class CostAxis(Shown):
    """What one axis of settings costs and how far off each setting is.

    Parameters
    ----------
    name : str
    rows : tuple of CostRow
    time : str
        What the seconds are of.
    baselines : mapping of str to float
        Errors, in the first column's measure, of predictions that need no model.
    """

    name: str
    rows: tuple[CostRow, ...]
    time: str = "run"
    baselines: Mapping[str, float] = dataclasses.field(default_factory=dict)

    def head(self) -> list[str]:
        """Column names."""
        return ["setting", f"{self.time}, s", *self._names()]

    def table(self) -> list[list[str]]:
        """Rows of text; baselines last, with the error alone."""
        names = self._names()
        rows = [
            [r.setting, _text(r.seconds), *(_text(r.errors.get(n)) for n in names)]
            for r in self.rows
        ]
        blank = [""] * max(len(names) - 1, 0)
        return rows + [[k, "-", _text(v), *blank] for k, v in self.baselines.items()]

    def cheapest(self, error: float, of: str | None = None) -> CostRow | None:
        """The fastest row whose error (`of`, default the first column) is met; None if none."""
        of = self._names()[0] if of is None else of
        good = [r for r in self.rows if r.errors.get(of, np.inf) <= error]
        return min(good, key=lambda r: r.seconds, default=None)

    def _names(self) -> list[str]:
        return list(dict.fromkeys(name for r in self.rows for name in r.errors))

    def __str__(self) -> str:
        rows = [self.head(), *self.table()]
        width = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
        lines = ["  ".join(c.rjust(w) for c, w in zip(row, width, strict=True)) for row in rows]
        return "\n".join([self.name, *lines])


def _text(value: float | None) -> str:
    if value is None or np.isnan(value):
        return "-"
    return "diverges" if np.isinf(value) else f"{value:.3g}"


@checked
def order_cost(
    train: Snapshots, test: Snapshots, orders: Sequence[int], methods: Sequence[Reductor]
) -> CostAxis:
    """Held-out error, projection floor and roll-out time of reduced models against their order.

    Parameters
    ----------
    train, test : Snapshots
        Different runs.
    orders, methods : sequence
        As in `compare_reductors`, which does the work. A model that diverges has no time.
    """
    found = compare_reductors(train, test, orders, methods)
    rows = tuple(
        CostRow(
            f"{r.method} m = {r.order}",
            1e-3 * r.roll_out_ms,
            {"held out": np.inf if r.diverges else r.error, "floor": r.floor, "fit, s": r.fit_s},
        )
        for r in found.rows
    )
    return CostAxis(f"order: {found.block}", rows, "roll-out", found.baselines)


@checked
def runs_cost(
    train: Snapshots,
    test: Snapshots,
    method: Reductor,
    order: int,
    run_seconds: float,
    counts: Sequence[int] | None = None,
    *,
    draws: int = 3,
    seed: Seed = 0,
) -> CostAxis:
    """Held-out error against what the training runs cost.

    Parameters
    ----------
    train, test, method, order, counts, draws, seed
        As in `learning_curve`.
    run_seconds : float
        Time that one full-order training run took, s.
    """
    if not (np.isfinite(run_seconds) and run_seconds > 0):
        raise ParameterError(f"run_seconds must be finite and > 0, got {run_seconds!r}")
    curve = learning_curve(train, test, method, order, counts, draws=draws, seed=seed)
    rows = tuple(
        CostRow(
            f"{n} run{'s' * (n > 1)}",
            n * run_seconds,
            {"held out": held, "spread": spread, "training": known},
        )
        for n, held, spread, known in zip(
            curve.counts, curve.held_out, curve.held_out_spread, curve.training, strict=True
        )
    )
    return CostAxis(f"training runs: {curve.settings} m = {order}", rows, "training runs")


@checked
def kinetics_cost(
    scene: Scene, t: np.ndarray, kinetics: Sequence[str] = ("clutch", "switching")
) -> CostAxis:
    """Time of a run with each adhesion kinetics, and what 5 nm at the start make of it.

    Parameters
    ----------
    scene : Scene
        One with a matrix and focal adhesion; its first cell is started `SHIFT` um beside its place.
    t : (T,)
        Samples, s.
    kinetics : sequence of str

    Notes
    -----
    Compared are motions since the start (the shift itself is not counted), relative to their
    norm. A share near 1 says that no single run of these kinetics is a prediction. Clusters that
    switch carry no reaction of a lamellipodium: with them it is a source of force.
    """
    if "focal_adhesion" not in scene.effects:
        raise ParameterError(f"scene {scene.name!r} has no focal_adhesion; add it to its effects")
    t, rows = check_times(t), []
    if len(t) < 2:
        raise DataError(f"t must hold at least two samples, got {len(t)}")
    for kind in kinetics:
        effects = dict(scene.effects)
        effects["focal_adhesion"] = _with(effects["focal_adhesion"], "kinetics", kind)
        if kind == "switching" and "lamellipodium" in effects:
            effects["lamellipodium"] = _with(effects["lamellipodium"], "reaction", "none")
        base = dataclasses.replace(scene, effects=effects)
        first, *others = base.membranes
        place = (first.position[0] + SHIFT, first.position[1])
        beside = dataclasses.replace(
            base, cells=(dataclasses.replace(first, position=place), *others)
        )
        method = LinearlyImplicit(step=scene.step)
        systems = [build(s) for s in (base, beside)]
        for system in systems[:1]:  # compile
            simulate(system, method, t[0] + np.array([0.0, scene.step]), auxiliaries=False)
        runs, seconds = [], []
        for system in systems:
            began = time.perf_counter()
            runs.append(simulate(system, method, t, auxiliaries=False, seed=scene.seed))
            seconds.append(time.perf_counter() - began)
        a, b = runs
        errors = {f"5 nm: {name}": _other_motion(b.block(name), a.block(name)) for name in MOVING}
        rows.append(CostRow(kind, min(seconds), errors))
    return CostAxis(f"adhesion kinetics, {t[-1] - t[0]:g} s", tuple(rows))


def _other_motion(found: np.ndarray, truth: np.ndarray) -> float:
    moved = truth - truth[0]
    return float(np.linalg.norm(found - found[0] - moved) / np.linalg.norm(moved))


@checked
def coupling_cost(
    model: LinearModel,
    counts: Sequence[Count],
    t: np.ndarray,
    form: Superposition | MappedSuperposition | Feedback,
    *,
    tolerance: float = 1e-6,
    dense_up_to: int = 600,
    seed: Seed = 0,
) -> CostAxis:
    """One run of K coupled cells by exact modal flows, by modes integrated, by the dense matrix.

    Parameters
    ----------
    model : LatentModel
        One cell with rows of the matrix.
    counts : sequence of int
        K.
    t : (T,)
        Samples, s.
    form : Superposition, MappedSuperposition or Feedback
    tolerance : float
        rtol = atol of DOP853; in the exact route, of `Exponential`.
    dense_up_to : int
        Largest K m that is run by the dense matrix.
    seed : int
        Of the headings.

    Notes
    -----
    The error is the largest of any latent state or polarity against a run by exact flows at a
    tolerance of 1e-11, over the largest such value. The dense route solves the same cells: one
    weight is off by 1e-13, so that nothing splits.
    """
    rows = []
    for K in counts:
        headings = np.random.default_rng(seed).uniform(-np.pi, np.pi, K)
        cells = couple(model, K, form, headings=headings)
        truth = cells.simulate(t, Exponential(rtol=1e-11, atol=1e-11)).x
        method = DOP853(rtol=tolerance, atol=tolerance)
        exact = Exponential(rtol=tolerance, atol=tolerance)

        ways: dict[str, Callable[[], np.ndarray]] = {
            "exact": _run_of(cells, t, exact),
            "modal": _run_of(cells, t, method),
        }
        if K > 1 and K * cells.order <= dense_up_to:
            weights = np.ones((K, K)) - np.eye(K)
            weights[0, 1] += NUDGE
            dense = couple(model, graph=InteractionGraph(weights), coupling=form, headings=headings)
            ways["dense"] = _run_of(dense, t, method)
        for name, way in ways.items():
            began = time.perf_counter()
            x = way()
            seconds = time.perf_counter() - began
            error = float(np.abs(x - truth).max() / np.abs(truth).max())
            rows.append(CostRow(f"K = {K}, {name}", seconds, {"error": error}))
    return CostAxis(f"coupling: {form.name}, m = {model.order}", tuple(rows))


def _run_of(cells: Cells, t: np.ndarray, method: Integrator) -> Callable[[], np.ndarray]:
    return lambda: cells.simulate(t, method).x


def _with(effect: Effect, parameter: str, value: str) -> Effect:
    """The effect with one parameter changed."""
    made: Callable[..., Effect] = type(effect)
    fields = {f.name: getattr(effect, f.name) for f in dataclasses.fields(effect)}
    return made(**{**fields, parameter: value})
