"""Measuring a model: roll-outs of whole runs beside projection floor and baselines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from cellsys.errors import IntegrationError
from cellsys.reduction.baselines import command_baselines
from cellsys.reduction.card import Card, verdict
from cellsys.reduction.model import LatentModel
from cellsys.reduction.provenance import constant_commands, data_hash
from cellsys.reduction.snapshots import RunData, Snapshots


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
    return model.reconstruct(predict_samples(model, z0, commands, data.dt, len(run.x)))


def predict_samples(
    model: LatentModel, z0: np.ndarray, commands: np.ndarray | None, dt: float, samples: int
) -> np.ndarray:
    """z (samples, m) every dt s, commands (samples - 1, n_c).

    A model whose own step is a multiple of dt sees the mean commands of its steps; between them
    z is interpolated linearly.
    """
    t = dt * np.arange(samples)
    every = 1 if model.dt is None else round(model.dt / dt)
    if samples < 2 or every <= 1 or abs(every * dt - model.dt) > 1e-9 * model.dt:
        return model.predict(z0, commands, t)
    starts = np.arange(0, samples - 1, every)
    if commands is not None:
        counts = np.diff(np.append(starts, samples - 1))
        commands = np.add.reduceat(commands, starts, axis=0) / counts[:, None]
    z = model.predict(z0, commands, model.dt * np.arange(len(starts) + 1))
    k, share = np.divmod(np.arange(samples), every)
    ahead = np.minimum(k + 1, len(starts))
    return z[k] + (share / every)[:, None] * (z[ahead] - z[k])


def encode_start(model: LatentModel, run: RunData) -> np.ndarray:
    """z of a run's start from its instantaneous laws, never from a logged average."""
    return model.encode(np.asarray(run.x[0]), run.eta_start if _reads_eta(model) else None)


def _reads_eta(model: LatentModel) -> bool:
    """Whether auxiliaries are among the model's coordinates."""
    return model.V is None or len(model.V) > model.n_states


def encode_run(model: LatentModel, run: RunData) -> np.ndarray:
    """z (T - 1, m) of a run's samples, from states and logged auxiliaries."""
    eta = np.asarray(run.eta) if run.eta is not None and _reads_eta(model) else None
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
    references: Mapping[str, Mapping[str, float]],
) -> dict[str, dict[str, float]]:
    """Relative errors of one run, per block, beside its `references`."""
    x = np.asarray(run.x)
    try:
        predicted: np.ndarray | None = roll_out(model, data, run)
    except IntegrationError:
        predicted = None
    out = {}
    for name, cols in rows.items():
        true = x[:, cols]
        error = np.full_like(true, np.inf) if predicted is None else predicted[:, cols] - true
        with np.errstate(over="ignore", invalid="ignore"):
            # An error this large is reported as divergence.
            mse = float(np.mean(np.sum(error**2, axis=1)))
            relative = _relative(error, true)
        out[name] = {
            "model": relative if np.isfinite(relative) else float(np.finfo(float).max),
            **references[name],
            "mse": mse if np.isfinite(mse) else float(np.finfo(float).max),
        }
    return out


def baselines(
    run: RunData, rows: Mapping[str, np.ndarray | slice], motion: np.ndarray
) -> dict[str, dict[str, float]]:
    """Relative errors of what needs no model; `motion` (T, n) is the mean training motion."""
    x = np.asarray(run.x)
    T = len(x)
    mean = motion[np.minimum(np.arange(T), len(motion) - 1)]
    velocity = np.arange(T)[:, None] * (motion[-1] / max(len(motion) - 1, 1))
    out = {}
    for name, cols in rows.items():
        true = x[:, cols]
        moved = true - true[0]
        out[name] = {
            "nothing moves": 1.0,
            "mean velocity": _relative(velocity[:, cols] - moved, true),
            "mean motion": _relative(mean[:, cols] - moved, true),
        }
    return out


def floors(
    model: LatentModel, run: RunData, rows: Mapping[str, np.ndarray | slice], latent: np.ndarray
) -> dict[str, float]:
    """Relative projection error of one run whose encoded samples are `latent` (T - 1, >= m)."""
    x = np.asarray(run.x)
    nearest = model.reconstruct(latent[:, : model.order])
    return {
        name: _relative(nearest[:, cols] - x[:-1, cols], x[:, cols]) for name, cols in rows.items()
    }


def mean_motion(data: Snapshots) -> np.ndarray:
    """Mean over runs of x(t) - x(0), (shortest T, n)."""
    T = min(len(r.x) for r in data.runs)
    return np.mean([np.asarray(r.x[:T]) - np.asarray(r.x[0]) for r in data.runs], axis=0)


def errors(model: LatentModel, data: Snapshots, known: Encoded) -> dict[str, dict[str, float]]:
    """Root mean square over runs of `run_errors`, of the training or the held-out runs."""
    rows = position_rows(data)
    each = [
        run_errors(model, data, run, rows, known.references(model, data, i, rows))
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
    """Runs encoded once in a large basis, for the cards of all smaller orders in it.

    Floors depend on the basis and baselines on the runs alone, so both are found once.
    """

    runs: list[np.ndarray]
    motion: np.ndarray
    training: Snapshots | None = None
    read: dict = field(default_factory=dict, repr=False)
    kept: dict = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls, model: LatentModel, data: Snapshots, motion: np.ndarray, training: Snapshots
    ) -> Encoded:
        """`model` is any model with the large basis, `motion` the mean training motion."""
        return cls([encode_run(model, r) for r in data.runs], motion, training)

    def references(
        self,
        model: LatentModel,
        data: Snapshots,
        i: int,
        rows: Mapping[str, np.ndarray | slice],
    ) -> dict[str, dict[str, float]]:
        """Floor at the model's order, and baselines, of run i, per block."""
        if i not in self.kept:
            self.kept[i] = baselines(data.runs[i], rows, self.motion)
            if self.training is not None:
                more = command_baselines(self.training, data.runs[i], rows, self.read)
                self.kept[i] = {k: v | more.get(k, {}) for k, v in self.kept[i].items()}
        if (i, model.order) not in self.kept:
            self.kept[i, model.order] = floors(model, data.runs[i], rows, self.runs[i])
        floor = self.kept[i, model.order]
        return {name: {"floor": floor[name], **self.kept[i][name]} for name in rows}


def encode_all(
    model: LatentModel, data: Snapshots, test: Snapshots | None
) -> tuple[Encoded, Encoded | None]:
    """Training and held-out runs in the basis of `model`."""
    motion = mean_motion(data)
    held = None if test is None else Encoded.of(model, test, motion, data)
    return Encoded.of(model, data, motion, data), held


def assess(
    model: LatentModel,
    data: Snapshots,
    test: Snapshots | None = None,
    encoded: tuple[Encoded, Encoded | None] | None = None,
) -> Card:
    """The card of a model: training and held-out errors beside floor and baselines.

    `encoded` are the training and the held-out runs in a basis that starts with the model's.
    """
    training: dict = {}
    held_out: dict = {}
    if model.V is not None and position_rows(data):
        encoded = encode_all(model, data, test) if encoded is None else encoded
        training = errors(model, data, encoded[0])
        if test is not None:
            held_out = errors(model, test, encoded[1])
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
        facts={"data hashes": data_hash(data)},
        warnings=constant_commands(data),
    )
