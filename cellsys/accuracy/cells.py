"""Coupled cells on one field against the full-order run of the same scene: error beside time."""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping, Sequence
from typing import TypeGuard

import numpy as np

from cellsys.accuracy.axes import CostAxis, CostRow
from cellsys.arguments import checked
from cellsys.cell import CellsOnField, EquivariantModel
from cellsys.contracts import MatrixField, SteppedField
from cellsys.effects.commands import History
from cellsys.errors import ParameterError
from cellsys.kinds import kind_of
from cellsys.scene import Scene
from cellsys.trajectory import Trajectory


def step_commands(scene: Scene, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean amplitude and heading of every cell's commands over the steps of t.

    Parameters
    ----------
    scene : Scene
        Every cell with a commanded heading, its own or the scene's.
    t : (T,)
        s.

    Returns
    -------
    amplitude, heading : (T - 1, K)

    Raises
    ------
    ParameterError
        A cell that its polarity law steers.
    """
    each = [cell.commands or scene.commands for cell in scene.membranes]
    if any(c.heading is None for c in each):
        raise ParameterError(
            f"a cell of scene {scene.name!r} has no commanded heading; give it one, so that "
            "full-order and reduced cells are asked for the same"
        )

    def mean(history: History | None) -> np.ndarray:
        if history is None:  # amplitude: as it is
            return np.ones(len(t) - 1)
        inner = [np.linspace(a, b, 5) for a, b in itertools.pairwise(t)]
        return np.array([np.mean([history(s) for s in times]) for times in inner])

    return (
        np.column_stack([mean(c.amplitude) for c in each]),
        np.column_stack([mean(c.heading) for c in each]),
    )


@checked
def cells_cost(
    models: Sequence[EquivariantModel],
    field: MatrixField,
    scene: Scene,
    truth: Trajectory,
    full_order: Mapping[str, Trajectory] | None = None,
    *,
    repeats: int = 2,
) -> CostAxis:
    """Time and error of trained cells on one field, beside full-order runs of the same scene.

    Parameters
    ----------
    models : sequence of EquivariantModel
        Each is put at every cell's place of the scene, coupled by loads (the run of `LoadPorts`
        without its certificate).
    field : GalerkinField or full field
    scene : Scene
        With commands for every cell.
    truth : Trajectory
        The full-order run that errors are against.
    full_order : mapping of str to Trajectory, optional
        Full-order runs of the scene, at a coarser step, say; times are those they took. `truth`
        itself gets a row without errors.
    repeats : int
        Runs behind a time; the fastest counts. Training and the field's modes are not in it.

    Raises
    ------
    DataError
        When the step of a model is no multiple of the interval of `truth`.

    Notes
    -----
    Errors: rms difference over rms motion, of all cells' nodes and of the matrix.
    """
    if not _steps(field):
        raise ParameterError(f"field{kind_of(SteppedField).fault(field)}")
    K = len(scene.cells)
    names = [f"cell{k + 1}.position" for k in range(K)]
    matrix = "matrix.displacement"
    rows = []
    for model in models:
        every = truth.stride(model.dt)
        t = truth.t[::every]
        amplitude, heading = step_commands(scene, t)
        places = np.array([c.position for c in scene.membranes])
        cells, seconds = CellsOnField(model=model, field=field), np.inf
        for _ in range(repeats):
            began = time.perf_counter()
            run = cells.simulate(amplitude, heading, places)
            seconds = min(seconds, time.perf_counter() - began)
        nodes = model.nodes(run.block("z"))
        u = field.displacement(run.block("field.modes"))
        body = np.stack([truth.block(n)[::every] for n in names], axis=1)
        errors = {
            "cells": _missed(nodes, body[0], body),
            "matrix": _missed(u, np.zeros(3), truth.block(matrix)[::every]),
        }
        rows.append(CostRow(f"{model.order} latent variables", seconds, errors))
    for name, run in (full_order or {}).items():
        if run is truth:
            rows.append(CostRow(f"{name} (reference)", float(run.statistics["wall_time"]), {}))
            continue
        body, other = (np.stack([r.block(n) for n in names], axis=1) for r in (truth, run))
        errors = {
            "cells": _missed(other, body[0], body),
            "matrix": _missed(run.block(matrix), np.zeros(3), truth.block(matrix)),
        }
        rows.append(CostRow(name, float(run.statistics["wall_time"]), errors))
    span = truth.t[-1] - truth.t[0]
    return CostAxis(f"{K} cells, {span:g} s", tuple(rows))


def _steps(field: MatrixField) -> TypeGuard[SteppedField]:
    return kind_of(SteppedField).fault(field) is None


def _missed(found: np.ndarray, rest: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth - rest))
