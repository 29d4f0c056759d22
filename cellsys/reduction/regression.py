"""What the regressions share: latent samples, least squares, inputs, and the model they fill."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import scipy.linalg as sla

from cellsys.errors import DataError, ParameterError
from cellsys.kinds import FILLED, Filled
from cellsys.model.latent import LatentModel
from cellsys.reduction.basis import Basis, LatentParts
from cellsys.samples.snapshots import Snapshots


def learned_model(
    data: Snapshots,
    basis: Basis,
    A: np.ndarray,
    *,
    B: Filled[np.ndarray] = FILLED,
    offset: Filled[np.ndarray] = FILLED,
    input_names: tuple[str, ...] = (),
    dt: float | None = None,
    notes: Mapping[str, object],
) -> LatentModel:
    """`LatentModel` in `basis` with the names of `data`; what the basis left out is noted.

    A (m, m) in 1/s with `dt` (s), or continuous without; see `LatentModel`.
    """
    return LatentModel(
        A=A,
        B=B,
        offset=offset,
        V=basis.V,
        mean=basis.mean,
        scale=basis.scale,
        singular_values=basis.singular_values,
        dt=dt,
        n_states=data.states.size,
        blocks=role_blocks(data),
        states=data.states,
        auxiliaries=data.auxiliaries,
        input_names=input_names,
        notes={
            **notes,
            "dropped_columns": basis.dropped,
            "variance_share": float(np.sum(basis.singular_values**2) / basis.total),
        },
    )


def regress(
    Z: np.ndarray, Y: np.ndarray, intercept: bool, tolerance: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """Least squares Y ~ Z K + 1 k_0: K (regressors, columns), k_0 (columns,), rank.

    Regressors are scaled to unit norm first, so that `tolerance` is relative to each; directions
    below it are dropped (minimum norm).
    """
    columns = np.column_stack([Z, np.ones(len(Z))]) if intercept else Z
    norm = np.linalg.norm(columns, axis=0)
    norm[norm == 0] = 1.0
    solution, _, rank, _ = sla.lstsq(columns / norm, Y, cond=tolerance)
    solution = solution / norm[:, None]
    if not intercept:
        return solution, np.zeros(Y.shape[1]), int(rank)
    return solution[:-1], solution[-1], int(rank)


def input_map(
    data: Snapshots, weight: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...], float | None]:
    """How the commands enter: logged u regressed on them, projected.

    Returns B (m, n_c), the constant part (m,), names, and the share of u's variance about its
    mean that the commands explain (None without commands). Without commands a small system's u
    enters as it is, one input per state; a u that is zero throughout makes no input.
    """
    m = weight.shape[1]
    if not data.has_u:
        return np.zeros((m, 0)), np.zeros(m), (), None
    if data.command_names:
        moving, u = data.moving_input
        F, names = data.varying_commands()
        U, u_0, _ = regress(F, u, True, tolerance)
        left = u - F @ U - u_0
        spread = u - u.mean(axis=0)
        total = float(np.sum(spread**2))
        share = 1.0 - float(np.sum(left**2)) / total if total > 0 else None
        return (U @ weight[moving]).T, u_0 @ weight[moving], names, share
    if not len(data.moving_input[0]):
        return np.zeros((m, 0)), np.zeros(m), (), None
    if data.states.size > 200:
        raise DataError(
            "u has more than 200 columns and no commands were given; pass the low-dimensional "
            "commands behind u with each run"
        )
    return weight.T.copy(), np.zeros(m), tuple(f"u.{n}" for n in data.states.names), None


def role_blocks(data: Snapshots) -> dict[str, np.ndarray]:
    """Rows of V of the component (cells) and of the field (matrix), states and auxiliaries.

    The rows of ``step_residual`` belong to the states whose rate it is.
    """
    layout, out = data.layout, {}
    for role in ("component", "field"):
        rows = [
            np.arange(layout.slice(b.name).start, layout.slice(b.name).stop)
            for b in layout
            if b.role == role and b.name != "step_residual"
        ]
        if "step_residual" in data.auxiliaries:
            start = layout.slice("step_residual").start
            rows.append(start + data.states.where(role=role))
        found = np.concatenate(rows) if rows else np.zeros(0, int)
        if len(found):
            out[role] = np.sort(found)
    return out


class StepSamples(NamedTuple):
    """Pairs of latent states one model step apart, inside one run and across no event.

    now, ahead (N, m); `inputs` (N, n_c), means of the learned inputs over the step, and their
    `names`; `known` (N, m), mean rate of an input that enters as it is through `B` (m, n_u).
    """

    now: np.ndarray
    ahead: np.ndarray
    inputs: np.ndarray
    names: tuple[str, ...]
    known: np.ndarray
    B: np.ndarray
    step: float

    @classmethod
    def of(
        cls,
        data: Snapshots,
        basis: Basis,
        parts: LatentParts,
        step: float,
        kept: np.ndarray | None = None,
    ) -> StepSamples:
        """All pairs `step` s apart, overlapping ones included.

        Commands are learned. Without commands the u of a small system enters as it is, held at
        its mean over the step. `kept` (n_samples,) leaves out pairs that touch another sample.

        Raises
        ------
        ParameterError
            Where `step` is no multiple of the sampling interval.
        DataError
            Where no run is that long.
        """
        every, n = samples_per_step(data, step), data.states.size
        first = np.arange(max(len(parts.runs) - every + 1, 0))
        last = first + every - 1
        same = (parts.runs[first] == parts.runs[last]) & (
            parts.samples[last] - parts.samples[first] == every - 1
        )
        if kept is not None:
            lost = np.concatenate([[0], np.cumsum(~kept)])
            same &= lost[last + 1] == lost[first]
        first, last = first[same], last[same]
        if not len(first):
            raise DataError(f"no run has an uninterrupted stretch of {step:g} s; lower step=")
        m = parts.now.shape[1]
        names: tuple[str, ...] = ()
        inputs = np.zeros((len(parts.runs), 0))
        known, B = np.zeros((len(parts.runs), m)), np.zeros((m, 0))
        if data.command_names:
            inputs, names = data.varying_commands()
        elif data.has_u:
            weight = basis.inverse_scale()[:n, None] * basis.V[:n]
            B, _, names, _ = input_map(data, weight, 1e-13)
            known = data.stacked("u") @ weight

        def mean(table: np.ndarray) -> np.ndarray:
            if every == 1:
                return table[first]
            sums = np.concatenate([np.zeros((1, table.shape[1])), np.cumsum(table, axis=0)])
            return (sums[last + 1] - sums[first]) / every

        now, ahead = parts.now[first], parts.next[last]
        return cls(now, ahead, mean(inputs), names, mean(known), B, step)


def samples_per_step(data: Snapshots, step: float) -> int:
    """Sampling intervals in a step of `step` s.

    Raises
    ------
    ParameterError
        Unless it is a whole number >= 1.
    """
    every = round(step / data.dt)
    if every < 1 or abs(every * data.dt - step) > 1e-9 * step:
        raise ParameterError(
            f"step = {step:g} s is not a multiple of the sampling interval of {data.dt:g} s; "
            f"take {max(every, 1) * data.dt:g} s"
        )
    return every
