"""The loss of whole roll-outs, its adjoint gradient, and the projected Adam that lowers it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cellsys.errors import DataError
from cellsys.reduction.basis import LatentParts
from cellsys.reduction.regression import StepSamples, samples_per_step
from cellsys.samples.snapshots import Snapshots


@dataclass(frozen=True, eq=False, kw_only=True)
class RollOuts:
    """Training runs on the grid of a model's step, in coordinates w = T z (row vectors: z T^T).

    `true` (T + 1, R, m) with zero `weight` (T + 1, R) where a run has no sample; `start` (R, m);
    `inputs` (T, R, n_c); `known` (T, R, m) increments of w that are not learned. With e the error
    of w, the loss is  sum e^T metric e  over the same sum for "nothing moves".
    """

    true: np.ndarray
    weight: np.ndarray
    start: np.ndarray
    inputs: np.ndarray
    known: np.ndarray | None
    metric: np.ndarray

    @classmethod
    def of(
        cls,
        data: Snapshots,
        parts: LatentParts,
        samples: StepSamples,
        starts: Sequence[np.ndarray],
        T: np.ndarray,
        metric: np.ndarray,
        standard: Callable[[np.ndarray], np.ndarray],
    ) -> RollOuts:
        """From latent samples; `starts` (R, m) are the z that runs are predicted from.

        `metric` (m, m) weighs errors of z; `standard` turns inputs into standardised ones.
        """
        m, n = len(T), data.states.size
        every = samples_per_step(data, samples.step)
        steps = max(run.n_pairs // every for run in data.runs)
        shape = (steps + 1, len(data.runs))
        true, weight = np.zeros((*shape, m)), np.zeros(shape)
        inputs = np.zeros((steps, shape[1], samples.inputs.shape[1]))
        known = np.zeros((steps, shape[1], m)) if samples.B.shape[1] else None
        for i, run in enumerate(data.runs):
            rows, count = parts.runs == i, run.n_pairs // every
            z = np.full((run.n_pairs + 1, m), np.nan)
            z[parts.samples[rows] + 1] = parts.next[rows]
            z[parts.samples[rows]] = parts.now[rows]
            grid = z[::every]
            there = np.isfinite(grid[:, 0])
            true[: len(grid), i][there] = grid[there]
            weight[: len(grid), i] = there
            if data.command_names:
                commands = data.commands_of(run, samples.names)
                if commands is None:
                    raise DataError(f"{run.label or f'run {i}'}: no commands were recorded")
                inputs[:count, i] = standard(_means(commands, every, count))
            elif known is not None and run.u is not None:
                rates = _means(np.asarray(run.u), every, count) @ samples.B[:, :n].T
                known[:count, i] = samples.step * rates
        weight[0] = 0.0
        start, Ti = np.asarray(starts), np.linalg.solve(T, np.eye(m))
        moved = (true - start) * weight[..., None]
        scale = float(np.sum((moved @ metric) * moved)) or 1.0
        return cls(
            true=true @ T.T,
            weight=weight,
            start=start @ T.T,
            inputs=inputs,
            known=None if known is None else known @ T.T,
            metric=Ti.T @ metric @ Ti / scale,
        )

    def states(self, K: np.ndarray, b: np.ndarray) -> np.ndarray:
        """w (T + 1, R, m) of w+ = w K[:m] + c K[m:] + b (row vectors)."""
        drive, A = self.inputs @ K[len(b) :] + b, np.ascontiguousarray(K[: len(b)])
        if self.known is not None:
            drive += self.known
        w = np.empty_like(self.true)
        w[0] = self.start
        for k in range(len(drive)):
            np.dot(w[k], A, out=w[k + 1])
            w[k + 1] += drive[k]
        return w

    def loss(self, K: np.ndarray, b: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Loss, its gradient in K and in b: one sweep forward, one backward (the adjoint).

        l_k = A^T l_k+1 + metric (w_k - true_k) ,   dL/dA = 2 sum l_k+1 w_k^T
        """
        m = len(b)
        w = self.states(K, b)
        error = (w - self.true) * self.weight[..., None]
        pull = error @ self.metric
        value = float(np.sum(pull * error))
        back = np.ascontiguousarray(K[:m].T)
        for k in range(len(pull) - 2, -1, -1):
            pull[k] += pull[k + 1] @ back
        ahead = pull[1:].reshape(-1, m)
        old = w[:-1].reshape(-1, m)
        inputs = self.inputs.reshape(len(ahead), K.shape[0] - m)
        gradient = np.concatenate([old.T @ ahead, inputs.T @ ahead])
        return value, 2.0 * gradient, 2.0 * ahead.sum(axis=0)


def _means(table: np.ndarray, every: int, count: int) -> np.ndarray:
    """Means of `count` groups of `every` rows."""
    return table[: count * every].reshape(count, every, -1).mean(axis=1)


@np.errstate(over="ignore", invalid="ignore")  # a step that runs away is taken back
def adam(
    runs: RollOuts,
    K: np.ndarray,
    b: np.ndarray,
    project: Callable[[np.ndarray], np.ndarray] | None,
    iterations: int,
    rate: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lower the roll-out loss by Adam (Kingma & Ba 2015), projected after each step.

    Returns the best K and b, and the loss at every step (iterations + 1,). The step falls from
    `rate` to a twentieth of it along a half cosine; where the loss is more than twice the best
    found, it goes back there and halves the rate.
    """
    x = np.concatenate([K, b[None]])
    first, second = np.zeros_like(x), np.zeros_like(x)
    best, slope, least, age = x, first, np.inf, 0
    history = np.full(iterations + 1, np.inf)
    for i in range(iterations + 1):
        value, gK, gb = runs.loss(x[:-1], x[-1])
        gradient = np.concatenate([gK, gb[None]])
        fine = np.isfinite(value) and bool(np.all(np.isfinite(gradient)))
        history[i] = value if fine else np.inf
        if history[i] < least:
            best, slope, least = x, gradient, history[i]
        elif not history[i] < 2.0 * least:
            x, gradient, age, rate = best, slope, 0, 0.5 * rate
            first, second = np.zeros_like(x), np.zeros_like(x)
        if i == iterations:
            break
        age += 1
        first = 0.9 * first + 0.1 * gradient
        second = 0.999 * second + 0.001 * gradient**2
        size = rate * (0.525 + 0.475 * np.cos(np.pi * i / iterations))
        move = first / (1 - 0.9**age) / (np.sqrt(second / (1 - 0.999**age)) + 1e-12)
        x = x - size * move
        if project is not None:
            x = np.concatenate([project(x[:-1]), x[-1:]])
    return best[:-1], best[-1], history
