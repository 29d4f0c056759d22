"""Measuring a model: roll-outs of whole runs beside projection floor and baselines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import ReducedModel
from cellsys.errors import IntegrationError, RepresentationError
from cellsys.model.card import Card, resolution, verdict
from cellsys.model.poles import fastest_growth
from cellsys.samples.provenance import constant_commands, data_hash, repeated_runs, repeats
from cellsys.samples.snapshots import RunData, Snapshots
from cellsys.threads import one_thread
from cellsys.worth.baselines import command_baselines
from cellsys.worth.errors import mse, relative, root_mean_square

LARGEST = float(np.finfo(float).max)  # what an infinite error is written as


def position_rows(data: Snapshots) -> dict[str, np.ndarray | slice]:
    """Columns of x that are positions: ``cells`` and ``matrix``.

    Data that are not known to be places in um are not called so: they are ``states`` and
    ``field``.
    """
    rows = {}
    for role, place, other in (("component", "cells", "states"), ("field", "matrix", "field")):
        found = data.states.where(role=role, kind="position")
        if len(found):
            rows[place if _unit(data, role) == "um" else other] = _as_slice(found)
    return rows


def _unit(data: Snapshots, *roles: str) -> str:
    """The one unit of the positions of these roles; empty without one."""
    units = {b.unit for b in data.states if b.role in roles and b.kind == "position"} - {"1"}
    return units.pop() if len(units) == 1 else ""


def _as_slice(rows: np.ndarray) -> np.ndarray | slice:
    """A slice where the rows are consecutive: no copies of whole runs."""
    if rows[-1] - rows[0] + 1 == len(rows):
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows


def roll_out(model: ReducedModel, data: Snapshots, run: RunData) -> np.ndarray:
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
        commands = np.asarray(run.u) if len(model.input_names) and run.u is not None else None
    return model.reconstruct(predict_samples(model, z0, commands, data.dt, len(run.x)))


def predict_samples(
    model: ReducedModel, z0: np.ndarray, commands: np.ndarray | None, dt: float, samples: int
) -> np.ndarray:
    """z (samples, m) every dt s, commands (samples - 1, n_c).

    A model whose own step is a multiple of dt sees the mean commands of its steps; between them
    z is interpolated linearly.
    """
    t = dt * np.arange(samples)
    own = model.dt
    every = 1 if own is None else round(own / dt)
    if samples < 2 or own is None or every <= 1 or abs(every * dt - own) > 1e-9 * own:
        return model.predict(z0, commands, t)
    starts = np.arange(0, samples - 1, every)
    if commands is not None:
        counts = np.diff(np.append(starts, samples - 1))
        commands = np.add.reduceat(commands, starts, axis=0) / counts[:, None]
    z = model.predict(z0, commands, own * np.arange(len(starts) + 1))
    k, share = np.divmod(np.arange(samples), every)
    ahead = np.minimum(k + 1, len(starts))
    return z[k] + (share / every)[:, None] * (z[ahead] - z[k])


def encode_start(model: ReducedModel, run: RunData) -> np.ndarray:
    """z of a run's start from its instantaneous laws, never from a logged average."""
    return model.encode(np.asarray(run.x[0]), run.eta_start)


def encode_run(model: ReducedModel, run: RunData) -> np.ndarray:
    """z (T - 1, m) of a run's samples, from states and logged auxiliaries."""
    z = model.encode(np.asarray(run.x)[:-1], None if run.eta is None else np.asarray(run.eta))
    run.release()
    return z


def run_errors(
    model: ReducedModel,
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
            found = {"model": relative(error, true), **references[name], "mse": mse(error)}
        out[name] = {k: v if np.isfinite(v) else LARGEST for k, v in found.items()}
    return out


def baselines(
    run: RunData, rows: Mapping[str, np.ndarray | slice], motion: np.ndarray | None
) -> dict[str, dict[str, float]]:
    """Relative errors of what needs no model; `motion` (T, n) is the mean of other runs."""
    x = np.asarray(run.x)
    T = len(x)
    out = {name: {"nothing moves": 1.0} for name in rows}
    if motion is None:
        return out
    mean = motion[np.minimum(np.arange(T), len(motion) - 1)]
    velocity = np.arange(T)[:, None] * (motion[-1] / max(len(motion) - 1, 1))
    for name, cols in rows.items():
        true = x[:, cols]
        moved = true - true[0]
        out[name] |= {
            "mean velocity": relative(velocity[:, cols] - moved, true),
            "mean motion": relative(mean[:, cols] - moved, true),
        }
    return out


def floors(
    model: ReducedModel, run: RunData, rows: Mapping[str, np.ndarray | slice], latent: np.ndarray
) -> dict[str, float]:
    """Relative projection error of one run whose encoded samples are `latent` (T - 1, >= m)."""
    x = np.asarray(run.x)
    nearest = model.reconstruct(latent[:, : model.order])
    return {
        name: relative(nearest[:, cols] - x[:-1, cols], x[:, cols]) for name, cols in rows.items()
    }


def mean_motion(data: Snapshots, leave: RunData | None = None) -> np.ndarray | None:
    """Mean over runs of x(t) - x(0), (shortest T, n), of all but `leave`; None without others."""
    others = [r for r in data.runs if r is not leave]
    if not others:
        return None
    T = min(len(r.x) for r in others)
    total = np.zeros((T, data.states.size))
    for run in others:
        total += np.asarray(run.x[:T]) - np.asarray(run.x[0])
        run.release()
    return total / len(others)


def errors(
    model: ReducedModel, data: Snapshots, known: Encoded, leave: Sequence[int] = ()
) -> dict[str, dict[str, float]]:
    """Root mean square over runs of `run_errors`, of the training or the held-out runs.

    Runs of the numbers `leave` do not count. "resolution" is how far the mean of the model's
    error over these runs can be told from the best baseline's: twice the standard error of the
    difference, from three runs on.
    """
    rows = position_rows(data)
    each = [
        run_errors(model, data, run, rows, known.references(model, data, i, rows))
        for i, run in enumerate(data.runs)
        if i not in leave
    ]
    out: dict[str, dict[str, float]] = {}
    for block in rows if each else ():
        found = {key: [e[block][key] for e in each] for key in each[0][block]}
        out[block] = {
            key: float(np.mean(np.minimum(v, 1e300))) if key == "mse" else root_mean_square(v)
            for key, v in found.items()
        }
        out[block]["resolution"] = resolution(found)
    return out


@dataclass(frozen=True, eq=False, kw_only=True)
class Encoded:
    """Runs encoded once in a large basis, for the cards of all smaller orders in it.

    Floors depend on the basis and baselines on the runs alone, so both are found once.
    """

    runs: list[np.ndarray]
    training: Snapshots
    read: dict[tuple[int, int], np.ndarray] = field(default_factory=dict, repr=False)
    kept: dict[int, dict[str, dict[str, float]]] = field(default_factory=dict, repr=False)
    floors: dict[tuple[int, int], dict[str, float]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, model: ReducedModel, data: Snapshots, training: Snapshots) -> Encoded:
        """`model` is any model with the large basis."""
        return cls(runs=[encode_run(model, r) for r in data.runs], training=training)

    @cached_property
    def motion(self) -> np.ndarray | None:
        """Mean motion of all training runs."""
        return mean_motion(self.training)

    def references(
        self,
        model: ReducedModel,
        data: Snapshots,
        i: int,
        rows: Mapping[str, np.ndarray | slice],
    ) -> dict[str, dict[str, float]]:
        """Floor at the model's order, and baselines, of run i, per block.

        A baseline never knows the run it is measured on.
        """
        if i not in self.kept:
            run = data.runs[i]
            own = any(run is r for r in self.training.runs)
            motion = mean_motion(self.training, run) if own else self.motion
            self.kept[i] = baselines(run, rows, motion)
            more = command_baselines(self.training, run, rows, self.read)
            self.kept[i] = {k: v | more.get(k, {}) for k, v in self.kept[i].items()}
        if (i, model.order) not in self.floors:
            self.floors[i, model.order] = floors(model, data.runs[i], rows, self.runs[i])
        floor = self.floors[i, model.order]
        return {name: {"floor": floor[name], **self.kept[i][name]} for name in rows}


def encode_all(
    model: ReducedModel, data: Snapshots, test: Snapshots | None
) -> tuple[Encoded, Encoded | None]:
    """Training and held-out runs in the basis of `model`."""
    held = None if test is None else Encoded.of(model, test, data)
    return Encoded.of(model, data, data), held


def _has_coordinates(model: ReducedModel, data: Snapshots) -> bool:
    """Whether a model reconstructs the states of the data; refused where it makes others."""
    try:
        width = np.shape(model.reconstruct(np.zeros(model.order)))
    except RepresentationError:
        return False
    if width != (data.states.size,):
        raise RepresentationError(
            f"this {type(model).__name__} reconstructs {width}, the data have "
            f"{data.states.size} states; the reductor that made it measures it: see model.card"
        )
    return True


@checked
@one_thread()
def assess(
    model: ReducedModel,
    data: Snapshots,
    test: Snapshots | None = None,
    encoded: tuple[Encoded, Encoded | None] | None = None,
) -> Card:
    """The card of a model: training and held-out errors beside floor and baselines.

    `encoded` are the training and the held-out runs in a basis that starts with the model's. A
    model without coordinates (a `LatentModel` given without V) gets a card without errors.

    Raises
    ------
    RepresentationError
        A model that reconstructs other things than the states of the data.
    """
    training: dict[str, dict[str, float]] = {}
    held_out: dict[str, dict[str, float]] = {}
    repeated = [] if test is None else repeated_runs(test, data)
    if position_rows(data) and _has_coordinates(model, data):
        encoded = encode_all(model, data, test) if encoded is None else encoded
        training = errors(model, data, encoded[0])
        if test is not None:
            held = encoded[1] or Encoded.of(model, test, data)
            held_out = errors(model, test, held, repeated)
    abscissa, growth = model.growth(), fastest_growth(model.pole_set())
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
        growth=growth,
        unit=_unit(data, "component", "field"),
        verdict=verdict(model.order, growth, training, held_out),
        facts={"data hashes": data_hash(data)},
        warnings=(*constant_commands(data), *repeats(repeated, test)),
    )
