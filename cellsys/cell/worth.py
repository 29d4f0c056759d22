"""What an equivariant model is worth: roll-out errors per block beside floors and baselines.

Every number is over whole roll-outs from the start, commands only as input
[notes: theory, errors and baselines]:
`cells` absolute node positions over the displacement from the start, `shape` without the centroid,
`centroid` in the plane, `loads` the load density (L2 over the port).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from cellsys.arguments import checked
from cellsys.cell.charges import turn
from cellsys.cell.model import EquivariantModel
from cellsys.cell.records import CellRecord
from cellsys.cell.representation import CHARGES
from cellsys.errors import DataError
from cellsys.model.card import resolution
from cellsys.worth.errors import mse, relative, root_mean_square

Path = tuple[np.ndarray, "list[dict[int, np.ndarray]] | None"]


def block_errors(nodes: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Relative errors of node positions (K + 1, n, 3) per block, and the MSE of them all, um^2."""
    inside = nodes - nodes.mean(axis=1, keepdims=True)
    inside_truth = truth - truth.mean(axis=1, keepdims=True)
    plane, plane_truth = nodes.mean(axis=1)[:, :2], truth.mean(axis=1)[:, :2]
    return {
        "cells": relative(nodes - truth, truth),
        "shape": relative(inside - inside_truth, inside_truth),
        "centroid": relative(plane - plane_truth, plane_truth),
        "mse": mse(nodes - truth),
    }


def load_error(
    loads: Sequence[dict[int, np.ndarray]], truth: Sequence[dict[int, np.ndarray]]
) -> float:
    """Relative L2 error of the load density over a run."""
    both = list(zip(loads, truth, strict=True))
    miss = sum(np.sum(np.abs(a[q] - b[q]) ** 2) for a, b in both for q in b)
    size = sum(np.sum(np.abs(b[q]) ** 2) for b in truth for q in b)
    return float(np.sqrt(miss / size)) if size > 0 else 0.0


def roll_record(model: EquivariantModel, record: CellRecord) -> np.ndarray:
    """z (K + 1, m) of the model from the record's start under its commands."""
    z0 = model.encode_cell(record.nodes[:1], record.loads[:1])[0]
    return model.simulate_commands(z0, record.amplitude, record.heading)


def loads_along(model: EquivariantModel, z: np.ndarray) -> list[dict[int, np.ndarray]]:
    """Load charges at every sample of z (T, m)."""
    loads = model.reconstruct_load(z)
    return [{q: values[k] for q, values in loads.items()} for k in range(len(z))]


@dataclass(frozen=True, eq=False)
class Baselines:
    """Predictors that need no model, learned from the training records (never from its own)."""

    records: tuple[CellRecord, ...]
    model: EquivariantModel

    def paths(self, record: CellRecord) -> dict[str, np.ndarray]:
        """Node positions (K + 1, n, 3) that each baseline predicts for a record."""
        K = record.steps
        start = record.nodes[0]
        known = [r for r in self.records if r.steps >= K and r is not record]
        moved = [r.nodes[: K + 1] - r.nodes[0] for r in known]
        out = {"nothing moves": np.tile(start, (K + 1, 1, 1))}
        if not moved:
            return out
        mean = np.mean(moved, axis=0)
        share = np.arange(K + 1)[:, None, None] / K
        out["mean velocity"] = start + share * mean[-1]
        out["mean motion"] = start + mean
        pushes = [_push(r, K) for r in known]
        own = _push(record, K)
        nearest = int(np.argmin([np.linalg.norm(p - own) for p in pushes]))
        out["nearest run"] = start + moved[nearest]
        if len(moved) >= 4:
            out["linear in polarity"] = start + _linear(pushes, moved, own)
        out["body-frame mean"] = self._body_frame(known, record)
        return out

    def _body_frame(self, known: list[CellRecord], record: CellRecord) -> np.ndarray:
        """Mean trajectory of charges and of the centroid's velocity in the heading's frame."""
        K, representation = record.steps, self.model.representation
        charges: dict[int, list[np.ndarray]] = {q: [] for q in CHARGES}
        speeds = []
        for r in known:
            centre, features = representation.features(r.nodes[: K + 1], None)
            angle = np.append(r.heading[:K], r.heading[K - 1])
            for q in CHARGES:
                charges[q].append(turn(features[q], q, -angle[:, None]))
            path = centre[:, 0] + 1j * centre[:, 1]
            speeds.append(np.diff(path) * np.exp(-1j * r.heading[:K]))
        angle = np.append(record.heading, record.heading[-1])
        own = {q: turn(np.mean(charges[q], axis=0), q, angle[:, None]) for q in CHARGES}
        step = np.mean(speeds, axis=0) * np.exp(1j * record.heading)
        at = record.nodes[0].mean(axis=0)[:2]
        path = np.concatenate([[0.0], np.cumsum(step)])
        place = at + np.stack([path.real, path.imag], axis=-1)
        return representation.nodes(place, own)


def _push(record: CellRecord, K: int) -> np.ndarray:
    """Running mean (K, 2) of amplitude times heading direction."""
    a, angle = record.amplitude[:K], record.heading[:K]
    drive = np.stack([a * np.cos(angle), a * np.sin(angle)], axis=-1)
    return np.cumsum(drive, axis=0) / np.arange(1, K + 1)[:, None]


def _linear(pushes: list[np.ndarray], moved: list[np.ndarray], own: np.ndarray) -> np.ndarray:
    """Displacement at each time linear in the mean polarity so far; least squares over runs."""
    K = len(own)
    out = np.zeros((K + 1, *moved[0].shape[1:]))
    flat = np.array(moved).reshape(len(moved), K + 1, -1)
    for k in range(K):
        design = np.column_stack([np.ones(len(pushes)), [p[k] for p in pushes]])
        weights = sla.lstsq(design.T, np.array([1.0, *own[k]]), cond=1e-8)[0]
        out[k + 1] = (weights @ flat[:, k + 1]).reshape(moved[0].shape[1:])
    return out


def measure(
    model: EquivariantModel,
    records: Sequence[CellRecord],
    baselines: Baselines,
    roll: Callable[[EquivariantModel, CellRecord], np.ndarray] = roll_record,
) -> dict[str, dict[str, float]]:
    """Rows of the card: per block the model's error, its spread over runs, floor and baselines.

    `roll` may be another way of simulating (a cell on its field).
    """
    rows: dict[str, dict[str, list[float]]] = {}

    def note(block: str, key: str, value: float) -> None:
        rows.setdefault(block, {}).setdefault(key, []).append(value)

    for record in records:
        z = roll(model, record)
        predicted = model.nodes(z)
        truth = record.nodes
        known = model.encode_cell(record.nodes, record.loads)
        for key, nodes in {
            "model": predicted,
            "floor": model.nodes(known),
            **baselines.paths(record),
        }.items():
            found = block_errors(nodes, truth)
            for block in ("cells", "shape", "centroid"):
                note(block, key, found[block])
            if key == "model":
                note("cells", "mse", found["mse"])
        note("loads", "model", load_error(loads_along(model, z), record.loads))
        note("loads", "floor", load_error(loads_along(model, known), record.loads))
    return {block: _summary(values) for block, values in rows.items()}


def _summary(values: dict[str, list[float]]) -> dict[str, float]:
    out = {}
    for key, each in values.items():
        out[key] = float(np.mean(each)) if key == "mse" else root_mean_square(each)
        if key == "model":
            out["spread over runs"] = float(np.std(each))
    out["resolution"] = resolution(values)
    if "body-frame mean" in values:
        pairs = zip(values["model"], values["body-frame mean"], strict=True)
        out["runs better than body-frame mean"] = float(np.mean([m < b for m, b in pairs]))
    return out


@checked
def realisation_floor(
    model: EquivariantModel, pairs: Sequence[tuple[CellRecord, CellRecord]]
) -> dict[str, float]:
    """Error between runs with the same commands at two places of the matrix, over sqrt 2.

    The second run of a pair may be turned by a constant angle; it is turned back. No model that
    does not know the local network can be better than this.
    """
    if not pairs:
        raise DataError("pairs must hold at least one pair of runs with the same commands")
    cells, loads = [], []
    for a, b in pairs:
        K = min(a.steps, b.steps)
        alpha = float(np.angle(np.mean(np.exp(1j * (b.heading[:K] - a.heading[:K])))))
        centre, features = model.representation.features(b.nodes[: K + 1], b.loads[: K + 1])
        turned = {q: turn(f, q, -alpha) for q, f in features.items()}
        path = (centre[:, 0] + 1j * centre[:, 1]) * np.exp(-1j * alpha)
        path = path - path[0] + complex(*a.nodes[0].mean(axis=0)[:2])
        nodes = model.representation.nodes(np.stack([path.real, path.imag], axis=-1), turned)
        cells.append(relative(nodes - a.nodes[: K + 1], a.nodes[: K + 1]))
        given = model.representation.load(turned)
        along = [{q: v[k] for q, v in given.items()} for k in range(K + 1)]
        loads.append(load_error(along, a.loads[: K + 1]))
    root = np.sqrt(2.0)
    return {
        "cells": float(np.sqrt(np.mean(np.square(cells)))) / root,
        "loads": float(np.sqrt(np.mean(np.square(loads)))) / root,
    }


def representation_error(
    model: EquivariantModel, records: Sequence[CellRecord]
) -> dict[str, float]:
    """What the coordinates lose before any reduction: um rms per node, and over the motion."""
    representation = model.representation
    misses, shares = [], []
    for r in records:
        centre, features = representation.features(r.nodes, None)
        nodes = representation.nodes(centre[:, :2], features)
        misses.append(np.mean(np.sum((nodes - r.nodes) ** 2, axis=2)))
        shares.append(relative(nodes - r.nodes, r.nodes))
    return {
        "um": float(np.sqrt(np.mean(misses))),
        "of the motion": float(np.sqrt(np.mean(np.square(shares)))),
    }
