"""The range a model was trained in, kept with it, and flags where a roll-out leaves it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError
from cellsys.shown import Shown

_NOTE = "trained_range"
_SLACK = 1e-9  # of the larger bound: rounding of a range of one value


@checked
@dataclass(frozen=True)
class Flag(Shown):
    """Something outside the trained range: when, what, its value and the bound."""

    time: float
    what: str
    value: float
    bound: float

    def __str__(self) -> str:
        return (
            f"t = {self.time:g} s: {self.what} {self.value:.3g} is outside the trained range "
            f"(bound {self.bound:.3g})"
        )


def beginnings(outside: np.ndarray) -> np.ndarray:
    """Indices at which runs of True begin."""
    return np.flatnonzero(outside & ~np.concatenate([[False], outside[:-1]]))


class WithNotes(Protocol):
    """A model with notes, such as one made by cs.reduce."""

    @property
    def order(self) -> int:
        """Number of latent states."""

    @property
    def notes(self) -> Mapping[str, Any] | None:
        """What else is known of it."""


@checked
@dataclass(frozen=True, eq=False)
class TrainedRange:
    """Least and greatest input, latent state and time of the training runs.

    A learned model knows nothing beyond them. A tenth of a range is given as a margin.

    Parameters
    ----------
    inputs : array (2, n_c)
        Least and greatest value of each input; NaN where the runs recorded no commands.
    latent : array (2, m)
    time : float
        Longest training run, s.
    margin : float
        Share of a range by which it may be left.
    """

    inputs: np.ndarray
    latent: np.ndarray
    time: float
    margin: float = 0.1

    @classmethod
    def of(
        cls, commands: Sequence[np.ndarray | None], latents: Sequence[np.ndarray], time: float
    ) -> TrainedRange:
        """The ranges of training runs: commands (T - 1, n_c) and latent states (T, m) of each."""
        z = np.concatenate(latents)
        known = [c for c in commands if c is not None]
        inputs = np.concatenate(known) if known else np.full((1, 0), np.nan)
        return cls(
            np.array([inputs.min(axis=0), inputs.max(axis=0)]),
            np.array([z.min(axis=0), z.max(axis=0)]),
            float(time),
        )

    @classmethod
    def kept(cls, model: WithNotes) -> TrainedRange:
        """The range that `reduce` kept with a model.

        Raises
        ------
        DataError
            A model made from arrays, or written before ranges were kept.
        """
        try:
            table = (model.notes or {})[_NOTE]
            inputs, latent = (np.array(table[k], dtype=float) for k in ("inputs", "latent"))
            if latent.shape != (2, model.order) or inputs.ndim != 2 or len(inputs) != 2:
                raise ValueError
            return cls(inputs, latent, float(table["time"]))
        except (TypeError, KeyError, ValueError) as error:
            raise DataError(
                "the model holds no trained range; cs.reduce keeps one with every model it makes"
            ) from error

    def note(self) -> Mapping[str, Mapping[str, object]]:
        """Plain values, to be kept in the notes of a model."""
        return {
            _NOTE: {
                "inputs": self.inputs.tolist(), "latent": self.latent.tolist(), "time": self.time,
            }
        }  # fmt: skip

    def check(
        self, t: np.ndarray, z: np.ndarray, u: np.ndarray | None = None, names: Sequence[str] = ()
    ) -> list[Flag]:
        """Flags of a roll-out, in order of time; the first of each kind in a row.

        Parameters
        ----------
        t, z : (T,), (T, m)
            s from the start of the run, and latent states.
        u : (T - 1, n_c) or (n_c,), optional
            Commands; None for zero.
        names : sequence of str
            Of the inputs, for the flags.

        Raises
        ------
        DimensionError
        """
        t, z = np.asarray(t, dtype=float), np.asarray(z, dtype=float)
        if t.ndim != 1 or z.shape != (len(t), self.latent.shape[1]):
            raise DimensionError(
                f"z must be ({t.size}, {self.latent.shape[1]}) for t (T,), got {z.shape}"
            )
        n_c = self.inputs.shape[1]
        c = np.zeros((max(len(t) - 1, 0), n_c))
        if u is not None and n_c:
            given = np.asarray(u, dtype=float)
            if given.shape not in (c.shape, (n_c,)):
                raise DimensionError(f"u must be {c.shape} or ({n_c},), got {given.shape}")
            c[:] = given
        found = []
        labels = [*names] if len(names) == n_c else [f"c[{i}]" for i in range(n_c)]
        ranges: list[tuple[str, np.ndarray, tuple[float, float] | np.ndarray]] = [
            *((f"input {n}", c[:, i], self.inputs[:, i]) for i, n in enumerate(labels)),
            *((f"latent state z[{i}]", z[:, i], self.latent[:, i]) for i in range(z.shape[1])),
            ("time of the run", t - t[:1], (0.0, self.time)),
        ]
        for what, values, (low, high) in ranges:
            reach = _SLACK * max(abs(low), abs(high))
            if not what.startswith("time"):
                reach += self.margin * (high - low)
            for outside, bound in ((values < low - reach, low), (values > high + reach, high)):
                found += [
                    Flag(float(t[k]), what, float(values[k]), float(bound))
                    for k in beginnings(outside)
                ]
        return sorted(found, key=lambda f: f.time)
