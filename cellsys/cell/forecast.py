"""Predictions with error bands, and flags where a prediction leaves what was trained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np

from cellsys.arguments import checked
from cellsys.cell.charged import ChargedModel
from cellsys.cell.records import CellRecord
from cellsys.drawable import Drawable
from cellsys.errors import DataError, ParameterError
from cellsys.model.trained_range import Flag, beginnings
from cellsys.system import Event

LEVELS = (0.68, 0.95)
WINDOW = 3  # steps to either side whose residuals are pooled
KINDS = ("centroid", "plane", "height", "load")


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class ErrorBands:
    """Half widths from residuals of runs left out, by conformal quantiles.

    The residuals are those of models that never saw the run (folds over *runs*): they hold the
    sampling error, the model's form and the realisation of the network alike. Bootstrap or
    ensemble spread alone covers half of what it claims [notes: measurements, error bands].

    Parameters
    ----------
    t : (K + 1,)
        s since contact.
    levels : (L,)
        Shares covered.
    width : mapping of (L, K + 1)
        ``centroid`` each coordinate of the centroid in the plane, um; ``plane`` x and y of any
        node, um; ``height`` z of any node, um; ``load`` norm of the load density's error, pN/um.
    folds, runs : int
    """

    t: np.ndarray
    levels: tuple[float, ...]
    width: dict[str, np.ndarray]
    folds: int
    runs: int

    def at(self, kind: str, t: np.ndarray, level: float = 0.95) -> np.ndarray:
        """Half width at times t; kept constant after the last trained time."""
        if kind not in self.width:
            raise ParameterError(f"kind must be one of {', '.join(self.width)}, got {kind!r}")
        if level not in self.levels:
            raise ParameterError(
                f"level must be one of {', '.join(map(str, self.levels))}, got {level!r}"
            )
        return np.interp(t, self.t, self.width[kind][self.levels.index(level)])

    def coverage(
        self, misses: Sequence[dict[str, np.ndarray]], level: float = 0.95
    ) -> dict[str, float]:
        """Share of held-out residuals inside the band, per kind."""
        out = {}
        for kind in self.width:
            inside = total = 0
            for miss in misses:
                values = np.abs(miss[kind])
                bound = self.at(kind, self.t[: len(values)], level)
                inside += int((values <= bound[:, None]).sum())
                total += values.size
            out[kind] = inside / total
        return out


def residuals(model: ChargedModel, record: CellRecord, z: np.ndarray) -> dict[str, np.ndarray]:
    """Errors of a roll-out z (K + 1, m), each (K + 1, values)."""
    miss = model.nodes(z) - record.nodes
    load = model.reconstruct_load(z)
    size = sum(
        np.sum(np.abs(load[q] - np.array([r[q] for r in record.loads])) ** 2, axis=1) for q in load
    )
    return {
        "centroid": miss.mean(axis=1)[:, :2],
        "plane": miss[..., :2].reshape(len(miss), -1),
        "height": miss[..., 2],
        "load": np.sqrt(size)[:, None],
    }


def conformal_bands(misses: Sequence[dict[str, np.ndarray]], dt: float, folds: int) -> ErrorBands:
    """Bands of residuals of left-out runs, one entry per run.

    The residuals of all runs within `WINDOW` steps of a time are pooled: values of one run are not
    independent, but every run counts alike.

    Raises
    ------
    DataError
        Fewer than three runs: nothing can be said about another one.
    """
    if len(misses) < 3:
        raise DataError(f"error bands need at least 3 runs, got {len(misses)}")
    K = min(len(m["plane"]) for m in misses)
    width = {}
    for kind in KINDS:
        rows = []
        for level in LEVELS:
            pooled = np.concatenate([np.abs(m[kind][:K]) for m in misses], axis=1)
            near = [pooled[max(k - WINDOW, 0) : k + WINDOW + 1] for k in range(K)]
            rows.append([float(np.quantile(part, level)) for part in near])
        width[kind] = np.array(rows)
    return ErrorBands(
        t=dt * np.arange(K), levels=LEVELS, width=width, folds=folds, runs=len(misses)
    )


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class ValidityMonitor:
    """Ranges seen in training, with a margin, checked as a simulation goes on.

    Parameters
    ----------
    amplitude : (low, high)
    turning : float
        Greatest change of the heading in one step, rad.
    latent : tuple of float
        Greatest |x_q| per charge.
    strain : float
        Greatest rms change of shape over the radius.
    time : float
        Longest training run, s.
    """

    amplitude: tuple[float, float]
    turning: float
    latent: tuple[float, ...]
    strain: float
    time: float
    margin: float = 1.1

    @classmethod
    def of(cls, model: ChargedModel, records: Sequence[CellRecord]) -> ValidityMonitor:
        """The ranges of training records."""
        amplitudes = np.concatenate([r.amplitude for r in records])
        turns = [np.abs(_turns(r.heading)).max(initial=0.0) for r in records]
        latent, strain = np.zeros(len(model.dynamics.blocks)), 0.0
        for r in records:
            z = model.encode_cell(r.nodes, r.loads)
            sizes, shape = _sizes(model, z)
            latent = np.maximum(latent, sizes.max(axis=0))
            strain = max(strain, float(shape.max()))
        return cls(
            amplitude=(float(amplitudes.min()), float(amplitudes.max())),
            turning=float(max(turns)),
            latent=tuple(float(v) for v in latent),
            strain=strain,
            time=model.dt * max(r.steps for r in records),
        )

    def check(
        self,
        model: ChargedModel,
        t: np.ndarray,
        z: np.ndarray,
        amplitude: np.ndarray,
        heading: np.ndarray,
    ) -> list[Flag]:
        """Flags of samples z (T, m) and commands (T - 1,); the first of each kind in a row."""
        sizes, strain = _sizes(model, z)
        found = []
        reach = 1e-9 + (self.margin - 1.0) * (self.amplitude[1] - self.amplitude[0])
        series = [
            ("amplitude (low)", -np.asarray(amplitude), -(self.amplitude[0] - reach)),
            ("amplitude (high)", np.asarray(amplitude), self.amplitude[1] + reach),
            ("turn per step", np.abs(_turns(heading)), self.margin * self.turning + 1e-9),
            ("rms strain of the shape", strain, self.margin * self.strain),
            ("time since contact", np.asarray(t, dtype=float), self.time * (1 + 1e-9)),
        ]
        series += [
            (f"latent state of charge {q}", sizes[:, q], self.margin * bound)
            for q, bound in enumerate(self.latent)
        ]
        for what, values, bound in series:
            outside = np.asarray(values) > bound
            sign = -1.0 if what == "amplitude (low)" else 1.0
            found += [
                Flag(float(t[k]), what, sign * float(values[k]), sign * float(bound))
                for k in beginnings(outside)
            ]
        return sorted(found, key=lambda f: f.time)


@runtime_checkable
class WatchedModel(Protocol):
    """A model that knows the ranges it was trained in."""

    @property
    def monitor(self) -> ValidityMonitor | None:
        """Those ranges."""


def watched(
    model: ChargedModel,
    t: np.ndarray,
    z: np.ndarray,
    amplitude: np.ndarray,
    heading: np.ndarray,
    who: str,
) -> tuple[Event, ...]:
    """Flags of the model's monitor as events of a run; none for a model without one."""
    if not isinstance(model, WatchedModel) or model.monitor is None:
        return ()
    flags = model.monitor.check(model, t, z, amplitude, heading)
    return tuple(Event(f.time, "outside the trained range", f"{who}: {f}") for f in flags)


def _turns(heading: np.ndarray) -> np.ndarray:
    """Change of heading into each step, rad; 0 for the first."""
    heading = np.asarray(heading, dtype=float)
    if not len(heading):
        return heading
    return np.concatenate([[0.0], np.angle(np.exp(1j * np.diff(heading)))])


def _sizes(model: ChargedModel, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """|x_q| (T, charges) and rms change of shape over the radius (T,)."""
    state = model.dynamics.split(np.atleast_2d(z))
    sizes = np.stack([np.sqrt(np.sum(np.abs(x) ** 2, axis=-1)) for x in state.x], axis=-1)
    total = np.zeros(len(sizes))
    for q, features in model.modes.decode(dict(enumerate(state.x))).items():
        shape, _ = model.representation.split(q, features)
        total = total + np.sum(np.abs(shape) ** 2, axis=-1)
    return sizes, np.sqrt(total) / model.representation.shape.radius


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Forecast(Drawable):
    """A roll-out with its bands and flags.

    Parameters
    ----------
    t : (T,)
        s.
    z : (T, m)
    nodes : (T, n, 3)
        um.
    half_width : (T, 3)
        Of x, y and z of every node at `level`, um; NaN where no bands were made.
    flags : tuple of Flag
        Where the roll-out leaves the trained range.
    """

    t: np.ndarray
    z: np.ndarray
    nodes: np.ndarray
    half_width: np.ndarray
    level: float
    flags: tuple[Flag, ...]

    _figure: ClassVar[str] = "forecast"

    def __str__(self) -> str:
        lines = [
            f"forecast over {self.t[-1] - self.t[0]:g} s: at its end every node lies within "
            f"{self.half_width[-1, 0]:.2g} um in the plane and {self.half_width[-1, 2]:.2g} um in "
            f"height at {100 * self.level:g} %"
        ]
        return "\n".join(lines + [str(f) for f in self.flags])
