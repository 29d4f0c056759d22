"""The card of a model: what was learned from what, how wrong it is, and the verdict in words.

Errors are taken over whole roll-outs from the start with the commands as only input:

    relative error = rms(x_model - x) / rms(x - x_0)       ("nothing moves" scores 1)

beside the projection floor (best any model in this basis can do) and the baselines.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from cellsys.errors import IntegrationError
from cellsys.reduction.snapshots import RunData, Snapshots

if TYPE_CHECKING:
    from cellsys.reduction.model import LatentModel

DIVERGED = 1e6  # a relative error beyond this is reported as "diverges"


@dataclass(frozen=True)
class Card:
    """What a model is worth.

    Parameters
    ----------
    order, method, scale : int, str, str
    samples, columns : int
        Size of the training data.
    spectral_abscissa : float
        1/s, of the continuous poles.
    training, held_out : mapping
        ``{block: {"model", "floor", "nothing moves", "mean velocity", "mean motion", "mse"}}``;
        relative errors, and the model's MSE [thesis eq. 86] in um^2. Empty where not measured.
    verdict : str
        One sentence.
    """

    order: int
    method: str
    scale: str
    samples: int
    columns: int
    runs: tuple[str, ...]
    spectral_abscissa: float
    training: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    held_out: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    input_share_explained: float | None = None
    verdict: str = ""

    def table(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self) | {"runs": list(self.runs)}

    def __str__(self) -> str:
        lines = [
            f"order {self.order}, {self.method}, scale={self.scale!r}, "
            f"{self.samples} samples x {self.columns} columns from {len(self.runs)} runs",
            f"spectral abscissa {self.spectral_abscissa:.3g} 1/s",
        ]
        if self.input_share_explained is not None:
            lines.append(
                f"commands explain {100 * self.input_share_explained:.0f} % of the input u"
            )
        for title, rows in (("training", self.training), ("held out", self.held_out)):
            for block, row in rows.items():
                parts = ", ".join(
                    f"{k} {_number(v)}{' um^2' if k == 'mse' else ''}" for k, v in row.items()
                )
                lines.append(f"{title:9s} {block}: {parts}")
        lines.append(f"verdict: {self.verdict}")
        return "\n".join(lines)


def _number(value: float) -> str:
    return "diverges" if not value < DIVERGED else f"{value:.3g}"


def position_rows(data: Snapshots) -> dict[str, np.ndarray | slice]:
    """Columns of x that are positions: of the cells, and of the matrix."""
    rows = {
        "cells": data.states.where(role="component", kind="position"),
        "matrix": data.states.where(role="field", kind="position"),
    }
    return {k: _as_slice(v) for k, v in rows.items() if len(v)}


def _as_slice(rows: np.ndarray) -> np.ndarray | slice:
    """A slice where the rows are consecutive: no copies of whole runs."""
    if rows[-1] - rows[0] + 1 == len(rows):
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows


def roll_out(model: LatentModel, data: Snapshots, run: RunData) -> np.ndarray:
    """x (T, n) of the model from the run's start under its commands.

    Raises
    ------
    IntegrationError
        When the model diverges.
    """
    z0 = encode_start(model, run)
    if data.command_names:
        commands = data.commands_of(run, model.input_names)
    else:
        commands = np.asarray(run.u) if model.B.shape[1] and run.u is not None else None
    t = data.dt * np.arange(len(run.x))
    return model.reconstruct(model.predict(z0, commands, t))


def encode_start(model: LatentModel, run: RunData) -> np.ndarray:
    """z of a run's start from its instantaneous laws, never from a logged average."""
    return model.encode(np.asarray(run.x[0]), run.eta_start)


def encode_run(model: LatentModel, run: RunData) -> np.ndarray:
    """z (T - 1, m) of a run's samples, from states and logged auxiliaries."""
    eta = None if run.eta is None else np.asarray(run.eta)
    z = model.encode(np.asarray(run.x)[:-1], eta)
    run.release()
    return z


def _relative(error: np.ndarray, x: np.ndarray) -> float:
    moved = float(np.linalg.norm(x - x[0]))
    return float(np.linalg.norm(error)) / moved if moved > 0 else 0.0


def run_errors(
    model: LatentModel,
    data: Snapshots,
    run: RunData,
    rows: Mapping[str, np.ndarray | slice],
    motion: np.ndarray,
    latent: np.ndarray | None = None,
) -> dict[str, dict[str, float]]:
    """Relative errors of one run, per block.

    `motion` (T, n) is the mean training motion; `latent` (T - 1, >= m) the encoded run, when it
    is known already.
    """
    x = np.asarray(run.x)
    try:
        predicted: np.ndarray | None = roll_out(model, data, run)
    except IntegrationError:
        predicted = None
    T = len(x)
    latent = encode_run(model, run) if latent is None else latent[:, : model.order]
    floor = model.reconstruct(latent)
    mean = motion[np.minimum(np.arange(T), len(motion) - 1)]
    velocity = np.arange(T)[:, None] * (motion[-1] / max(len(motion) - 1, 1))
    out = {}
    for name, cols in rows.items():
        true = x[:, cols]
        error = np.full_like(true, np.inf) if predicted is None else predicted[:, cols] - true
        with np.errstate(over="ignore", invalid="ignore"):
            # An error this large is reported as divergence.
            mse = float(np.mean(np.sum(error**2, axis=1)))
            relative = _relative(error, true)
        moved = true - true[0]
        out[name] = {
            "model": relative if np.isfinite(relative) else float(np.finfo(float).max),
            "floor": _relative(floor[:, cols] - true[:-1], true),
            "nothing moves": 1.0,
            "mean velocity": _relative(velocity[:, cols] - moved, true),
            "mean motion": _relative(mean[:, cols] - moved, true),
            "mse": mse if np.isfinite(mse) else float(np.finfo(float).max),
        }
    return out


def mean_motion(data: Snapshots) -> np.ndarray:
    """Mean over runs of x(t) - x(0), (shortest T, n)."""
    T = min(len(r.x) for r in data.runs)
    return np.mean([np.asarray(r.x[:T]) - np.asarray(r.x[0]) for r in data.runs], axis=0)


def errors(
    model: LatentModel,
    data: Snapshots,
    motion: np.ndarray,
    latents: list[np.ndarray] | None = None,
) -> dict[str, dict[str, float]]:
    """Root mean square over runs of `run_errors`."""
    rows = position_rows(data)
    each = [
        run_errors(model, data, run, rows, motion, None if latents is None else latents[i])
        for i, run in enumerate(data.runs)
    ]
    return {
        block: {
            key: (
                float(np.mean([min(e[block][key], 1e300) for e in each]))
                if key == "mse"
                else float(np.sqrt(np.mean(np.square([min(e[block][key], 1e150) for e in each]))))
            )
            for key in each[0][block]
        }
        for block in rows
    }


@dataclass(frozen=True, eq=False)
class Encoded:
    """Runs encoded once in a large basis, for the cards of all smaller orders in it."""

    training: list[np.ndarray]
    test: list[np.ndarray]
    motion: np.ndarray

    @classmethod
    def of(cls, model: LatentModel, data: Snapshots, test: Snapshots | None) -> Encoded:
        """`model` is any model with the large basis."""
        return cls(
            [encode_run(model, r) for r in data.runs],
            [] if test is None else [encode_run(model, r) for r in test.runs],
            mean_motion(data),
        )


def assess(
    model: LatentModel,
    data: Snapshots,
    test: Snapshots | None = None,
    encoded: Encoded | None = None,
) -> Card:
    """The card of a model: training and held-out errors beside floor and baselines."""
    training: dict = {}
    held_out: dict = {}
    if model.V is not None and position_rows(data):
        encoded = Encoded.of(model, data, test) if encoded is None else encoded
        training = errors(model, data, encoded.motion, encoded.training)
        if test is not None:
            held_out = errors(model, test, encoded.motion, encoded.test)
    abscissa = model.growth()
    return Card(
        order=model.order,
        method=str(model.notes.get("method", "given")),
        scale=data.scale,
        samples=data.n_samples,
        columns=data.n_columns,
        runs=tuple(r.label for r in data.runs),
        spectral_abscissa=abscissa if np.isfinite(abscissa) else float(np.finfo(float).max),
        training=training,
        held_out=held_out,
        input_share_explained=model.notes.get("input_share_explained"),
        verdict=verdict(model.order, abscissa, training, held_out),
    )


def verdict(
    order: int,
    abscissa: float,
    training: Mapping[str, Mapping[str, float]],
    held_out: Mapping[str, Mapping[str, float]],
) -> str:
    """One sentence on what the model can be trusted for."""
    shown = held_out or training
    where = "held out" if held_out else "in training"
    if not shown:
        return f"order {order}: not measured against data."
    block, row = next(iter(shown.items()))
    model, best_name = (
        row["model"],
        min(("nothing moves", "mean velocity", "mean motion"), key=lambda k: row[k]),
    )
    best = row[best_name]
    if not model < DIVERGED:
        text = f"order {order}: its roll-out diverges {where}; do not predict with it"
    elif model >= best:
        text = (
            f"order {order}: {where} its error on {block} is {model:.2f} of the motion, worse than "
            f"{best_name} ({best:.2f}); do not predict with it"
        )
    else:
        text = (
            f"order {order}: {where} its error on {block} is {model:.2f} of the motion, better "
            f"than {best_name} ({best:.2f}); its basis allows {row['floor']:.2f}"
        )
    grows = f"; it has a growing mode ({abscissa:.2g} 1/s)" if abscissa > 0 else ""
    return text + grows + "."
