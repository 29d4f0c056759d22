"""What the study measures: errors of its models against order, their price, read-outs as text."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import numpy as np

from cellsys.contracts import ReducedModel
from cellsys.drawable import Drawable
from cellsys.errors import IntegrationError
from cellsys.model.card import card_of
from cellsys.reduction import PCR, LeastSquares, reduce_orders
from cellsys.response import Margins
from cellsys.samples import Snapshots
from cellsys.study.coordinates import Coordinates
from cellsys.trajectory import Trajectory

MATRIX = "matrix.displacement"
ERRORS = {  # read-outs that are 0 where nothing moves, and the entry that holds their error
    "crawl_um": "position_error_um",
    "displacement_max_um": "matrix_error_um",
    "displacement_rms_end_um": "matrix_error_um",
    "matrix_displacement_max_um": "matrix_error_um",
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class OrderRow:
    """One model of the sweep: held-out relative errors, floor, baselines, price."""

    method: str
    order: int
    error: dict[str, float]
    floor: dict[str, float]
    baselines: dict[str, dict[str, float]]
    abscissa: float
    roll_out_ms: float
    verdict: str


@dataclasses.dataclass(frozen=True)
class OrderSweep(Drawable):
    """Held-out error and price against the order, for several methods."""

    rows: tuple[OrderRow, ...]
    full_order_s: float
    horizon_s: float

    _figure: ClassVar[str] = "order_sweep"

    def __str__(self) -> str:
        lines = [
            f"{'model':>14s} {'m':>4s} {'error on cells':>14s} {'floor':>7s} {'abscissa 1/s':>13s} "
            f"{'roll-out ms':>12s}"
        ]
        for r in self.rows:
            lines.append(
                f"{r.method:>14s} {r.order:4d} {r.error['cells']:14.3g} {r.floor['cells']:7.3g} "
                f"{r.abscissa:13.2e} {r.roll_out_ms:12.2f}"
            )
        return "\n".join(lines)


def sweep_orders(
    data: Snapshots,
    test: Snapshots,
    coordinates: Coordinates,
    methods: Sequence[PCR | LeastSquares],
    orders: Sequence[int],
    full_order_s: float,
    progress: Callable[[float], None] | None = None,
) -> tuple[OrderSweep, dict[tuple[str, int], ReducedModel]]:
    """Fit every method at every order; errors are held out, times the minimum of 3 roll-outs."""
    rows: list[OrderRow] = []
    models: dict[tuple[str, int], ReducedModel] = {}
    total = len(methods) * len(orders)
    for model, (name, order) in zip(
        reduce_orders(data, methods, orders, test, *coordinates),
        [(method.name, order) for method in methods for order in orders],
        strict=True,
    ):
        models[name, order] = model
        card = card_of(model)
        held = card.held_out
        rows.append(
            OrderRow(
                method=name,
                order=order,
                error={b: v["model"] for b, v in held.items()},
                floor={b: v["floor"] for b, v in held.items()},
                baselines={
                    b: {k: v[k] for k in ("nothing moves", "mean velocity", "mean motion")}
                    for b, v in held.items()
                },
                abscissa=card.spectral_abscissa,
                roll_out_ms=1e3 * _price(model, test),
                verdict=card.verdict,
            )
        )
        if progress is not None:
            progress(len(rows) / total)
    horizon = data.dt * (len(test.runs[0].x) - 1)
    return OrderSweep(tuple(rows), full_order_s, horizon), models


def _price(model: ReducedModel, test: Snapshots) -> float:
    """Seconds of one latent roll-out over the first held-out run, minimum of 3 after one.

    NaN where the roll-out diverges.
    """
    run = test.runs[0]
    z0 = model.encode(np.asarray(run.x[0]), run.eta_start)
    commands = test.commands_of(run, model.input_names) if test.command_names else None
    t = test.dt * np.arange(len(run.x))
    try:
        model.predict(z0, commands, t)
    except IntegrationError:
        return float("nan")
    times = []
    for _ in range(3):
        began = time.perf_counter()
        model.predict(z0, commands, t)
        times.append(time.perf_counter() - began)
    return min(times)


def margin_table(m: Margins) -> dict[str, object]:
    """Margins of a polarity loop cut at kappa, as ``summary.json`` holds them."""
    table = m.table()
    return {"gain_margin_on_kappa": table.pop("gain_margin"), **table}


def short_number(value: float | None, digits: int = 3) -> str:
    """A number for a table; a dash for None and NaN."""
    if value is None or np.isnan(value):
        return "-"
    return "inf" if np.isinf(value) else f"{value:.{digits}g}"


# Endings of read-outs and their units, longer ones first.
_UNITS = (
    ("_nm_s", "nm/s"), ("_um_per_s", "um/s"), ("_pN_um", "pN um"), ("_um2", "um^2"),
    ("_um3", "um^3"), ("_um", "um"), ("_s", "s"), ("_deg", "deg"), ("_pN", "pN"), ("_Pa", "Pa"),
    ("_fJ", "fJ"), ("_percent", "%"),
)  # fmt: skip


def read_out_name(key: str) -> str:
    """Name of a read-out for a reader: ``crawl_um`` is "crawl, um"."""
    for ending, unit in _UNITS:
        if key.endswith(ending):
            return f"{key.removesuffix(ending).replace('_', ' ')}, {unit}"
    return key.replace("_", " ")


def matrix_row(run: Trajectory) -> dict[str, float]:
    """Greatest displacement of any node over the run and when, rms at the end, error; or nothing.

    um and s. The error is `Trajectory.error_of`: what is below it is not to be told from zero.
    """
    if MATRIX not in run.states:
        return {}
    u = np.linalg.norm(run.block(MATRIX), axis=2)
    return {
        "displacement_max_um": float(u.max()),
        "displacement_max_at_s": float(run.t[u.max(axis=1).argmax()]),
        "displacement_rms_end_um": float(np.sqrt(np.mean(u[-1] ** 2))),
        "matrix_error_um": run.error_of(MATRIX),
    }


def texts(row: Mapping[str, float]) -> dict[str, str]:
    """The values of a row as text; what is below its own error (`ERRORS`) says so instead."""
    out = {key: short_number(value, 4) for key, value in row.items()}
    for key, error in ERRORS.items():
        if key in row and error in row and not row[key] > row[error]:
            out[key] = f"below its error, {row[error]:.2g}"
    return out
