"""`snapshots`: runs of the toolbox, a user's arrays and files, gathered into samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.samples.commands import recorded_commands
from cellsys.samples.measured import JITTER, check_choices, off_grid
from cellsys.samples.snapshots import RunData, Snapshots
from cellsys.samples.user_data import from_user
from cellsys.system import Block, Layout
from cellsys.trajectory import Trajectory


@checked
def snapshots(
    runs: Sequence[Trajectory | RunData | np.ndarray | str | Path],
    *,
    scale: str = "block",
    dt: float | None = None,
    blocks: Mapping[str, Sequence[int]] | None = None,
    resample: float | None = None,
    missing: str = "refuse",
    delays: int = 0,
) -> Snapshots:
    """Collect runs into snapshots.

    Parameters
    ----------
    runs : sequence
        `Trajectory` objects recorded with auxiliaries; or a user's runs: arrays (T, n), or files
        ``.npz`` (arrays ``x``, optional ``eta``, ``u``, ``commands``, ``W_x``, ``W_eta``, ``dt``
        or ``t``, s) and ``.csv`` (header with names, time as ``t [s]``).
    scale : {"none", "block", "column"}
        See `Snapshots`.
    dt : float, optional
        Sampling interval in s; needed for plain arrays.
    blocks : mapping of str to indices, optional
        For a user's arrays: which columns of x form which block, e.g.
        ``{"component": range(6), "field": range(6, 30)}``.
    resample : float, optional
        For files with times: put unevenly sampled states on even times so many s apart, linear
        between; ``source["resampling_error"]`` tells the error this adds, over the spread of the
        column. Without it stamps may lie 1e-3 of the interval off even times (rounding, float32).
    missing : {"refuse", "split", "fill"}
        What to do where states are NaN or a cell is empty: refuse (default), split the run there
        into runs of at least three samples, or fill linearly; ``source["missing_samples"]``.
    delays : int
        Append the last so many samples to each (rows of a Hankel matrix), for few measured
        quantities; the blocks are called ``NAME.delay1``, ...

    Raises
    ------
    DataError
        NaN or inf in the data, unequal sampling, or a trajectory without auxiliaries.
    """
    if not runs:
        raise DataError("snapshots need at least one run")
    check_choices(resample, missing, delays)
    if all(isinstance(r, Trajectory) for r in runs):
        if resample is not None or missing != "refuse" or delays:
            raise ParameterError(
                "resample, missing and delays are for measured data; a run of the toolbox is "
                "sampled evenly and whole"
            )
        return _from_trajectories(list(runs), scale)  # type: ignore[arg-type]
    return from_user(list(runs), scale, dt, blocks, resample, missing, delays)


def _from_trajectories(runs: list[Trajectory], scale: str) -> Snapshots:
    first = runs[0]
    if first.eta is None or first.W_eta is None or first.W_x is None:
        raise DataError("trajectories must be recorded with auxiliaries=True")
    steps = np.concatenate([np.diff(r.t) for r in runs])
    if not steps.size:
        raise DataError("every run is too short: a run needs at least three samples")
    dt = float(steps[0])
    for i, run in enumerate(runs):
        if len(run) < 3:
            continue
        step, off, k = off_grid(np.asarray(run.t, dtype=float))
        if off > JITTER * step or abs(step - dt) > JITTER * dt:
            raise DataError(
                f"all runs must be sampled at one constant interval: that of run {i} is "
                f"{step:.9g} s, with t[{k}] = {run.t[k]:.9g} s off even times by {off:.3g} s, and "
                f"the first of all is {dt:.9g} s; sample the runs at equal times"
            )
    learned = [b for b in first.states if b.role != "controller" and b.kind != "label"]
    order = np.arange(first.states.size)
    keep_x = np.concatenate([order[first.states.slice(b.name)] for b in learned])
    keep_eta = np.arange(first.auxiliaries.size)
    states, auxiliaries = first.states, first.auxiliaries
    if len(keep_x) < first.states.size:
        states, keep_eta, auxiliaries = _learned_blocks(first, learned)
    commands, names = recorded_commands(runs)
    data = []
    for i, run in enumerate(runs):
        if run.states != first.states or run.auxiliaries != first.auxiliaries:
            raise DimensionError("all runs must have the same states and auxiliaries")
        hit = np.searchsorted(run.t, [e.time for e in run.events], side="right") - 1
        data.append(
            RunData(
                x=_columns(run.x, keep_x),
                eta=_columns(run.eta, keep_eta),
                u=_columns(run.u, keep_x) if run.u is not None else None,
                commands=commands[i] if names else None,
                skip=tuple(sorted({int(k) for k in hit})),
                eta_start=None if run.eta_start is None else np.asarray(run.eta_start)[keep_eta],
                d=None if run.d is None else np.asarray(run.d),
                nodal=run.nodal(),
                label=run.label,
            )
        )
    return Snapshots(
        runs=tuple(data), states=states, auxiliaries=auxiliaries, dt=dt,
        W_x=sp.csr_array(first.W_x[keep_x][:, keep_x]),
        W_eta=sp.csr_array(first.W_eta[keep_x][:, keep_eta]),
        command_names=names,
        scale=scale,
        source={"runs": [r.label for r in runs]},
        geometry=dict(first.geometry),
    )  # fmt: skip


def _columns(array: np.ndarray | None, keep: np.ndarray) -> Any:
    """Chosen columns; a view when they are contiguous, so that memory maps stay on disk."""
    if array is None or len(keep) == array.shape[1]:
        return array
    if len(keep) and keep[-1] - keep[0] + 1 == len(keep):
        return array[:, keep[0] : keep[-1] + 1]
    return _Selected(array, keep)


class _Selected:
    """Columns of a (memory-mapped) array, taken when rows are asked for."""

    def __init__(self, array: np.ndarray, keep: np.ndarray) -> None:
        self._array, self._keep = array, keep
        self.shape = (array.shape[0], len(keep))
        self.ndim = 2

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: slice | np.ndarray | tuple) -> np.ndarray:
        if isinstance(rows, tuple):  # (rows, columns): only those are read
            rows, columns = rows
            keep = self._keep[columns]
            if len(keep) and keep[-1] - keep[0] + 1 == len(keep):
                return np.asarray(self._array[rows, int(keep[0]) : int(keep[-1]) + 1])
            return np.asarray(self._array[rows])[..., keep]
        return np.take(np.asarray(self._array[rows]), self._keep, axis=-1)

    def __array__(self, dtype: np.dtype | None = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self[:], dtype=dtype)


def _learned_blocks(run: Trajectory, learned: list[Block]) -> tuple[Layout, np.ndarray, Layout]:
    """States without controllers and labels, and the auxiliaries that go with them."""
    states = Layout(learned)
    left_out = {f"{b.name}.rate" for b in run.states if b.name not in states}
    kept, blocks = [], []
    for block in run.auxiliaries:
        piece = run.auxiliaries.slice(block.name)
        if block.name == "step_residual":
            rows = np.concatenate(
                [np.arange(run.states.size)[run.states.slice(b.name)] for b in states]
            )
            kept.append(piece.start + rows)
            blocks.append(
                Block(block.name, (states.size,), block.unit, role=block.role, kind=block.kind)
            )
        elif block.role != "controller" and block.name not in left_out:
            kept.append(np.arange(piece.start, piece.stop))
            blocks.append(block)
    return states, np.concatenate(kept), Layout(blocks)
