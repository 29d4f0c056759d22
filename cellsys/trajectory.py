"""`Trajectory`: what every simulation returns, full-order or reduced."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from cellsys.arguments import checked
from cellsys.errors import CellsysError, DataError, DimensionError, FileFormatError
from cellsys.exported import Exported
from cellsys.shown import Shown
from cellsys.store.archive import load_archive, save_archive
from cellsys.system import Event, Layout
from cellsys.trajectory_file import KIND, SCHEMA, packed, unpacked

SOON = 5.0  # s: a run that took longer is not solved again only to be printed


def cell_names(states: Layout) -> list[str]:
    """``cell1``, ``cell2``, ...: what has a membrane of its own; a nucleus is part of its cell."""
    names = [b.name.removesuffix(".position") for b in states if b.name.endswith(".position")]
    return [name for name in names if "." not in name]


@checked
@dataclass(frozen=True, eq=False)
class ErrorEstimate(Shown):
    """The integrator's part of a run's error: its largest value over the samples.

    Parameters
    ----------
    absolute : array (n,) or None
        Estimated largest global error of each state, in its unit; None where there is no
        estimate.
    scale : array (n,)
        Largest |x| of each state over the samples.
    method : str
        How it was found, or why there is none.
    time : float
        What it took, s.
    """

    absolute: np.ndarray | None
    scale: np.ndarray
    method: str
    time: float = 0.0

    @property
    def relative(self) -> float:
        """Largest error over the largest |x|; NaN where there is no estimate."""
        if self.absolute is None:
            return float("nan")
        size = float(self.scale.max(initial=0.0))
        return float(self.absolute.max(initial=0.0)) / size if size else 0.0

    def blocks(self, states: Layout) -> dict[str, float]:
        """Largest absolute error of each state block."""
        if self.absolute is None:
            return {}
        return {b.name: float(self.absolute[states.slice(b.name)].max(initial=0.0)) for b in states}

    def __str__(self) -> str:
        if self.absolute is None:
            return f"not estimated ({self.method})"
        return f"{self.relative:.1e} of the largest state ({self.method}, {self.time:.2g} s)"


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Trajectory(Exported):
    """Samples of a run; axis 0 is time.

    The state x_k is the state at t_k. eta_k and u_k are the averages of each law and of the
    input over the *following* interval [t_k, t_k+1], so they have one row less than x, and

        (x_k+1 - x_k) / (t_k+1 - t_k) = W_x x_k + W_eta eta_k + u_k

    holds to rounding: what the stepping leaves over is the last block of eta,
    ``step_residual``, never spread over the laws.

    Parameters
    ----------
    t : array (T,)
        Times, s, increasing.
    x : array (T, n)
        States, in the units of their blocks.
    states : Layout
        Names of the n states.
    eta : array (T - 1, n_eta), optional
        Interval averages of the auxiliary variables.
    u : array (T - 1, n), optional
        Interval averages of the exogenous rate.
    auxiliaries : Layout
        Names of the n_eta auxiliaries, ``step_residual`` included.
    W_x, W_eta : sparse (n, n), (n, n_eta), optional
        The matrices of the equation above.
    p, d : array (T, cells, 3), optional
        Polarity and sensed direction of each cell.
    amplitude : array (T, cells), optional
        Lamellipodium amplitude (1 = nominal).
    virial, stiffness : array (T, N), optional
        At every matrix node: tension times length of its tense fibres, pN um, and the sum of
        their tangent stiffnesses, pN/um. Stored where a cell senses.
    eta_start : array (n_eta,), optional
        The laws at (t_0, x_0), not averaged: what a latent initial state is made from.
    events : tuple of Event
        Discrete happenings, in order of time.
    statistics : mapping
        Counts (rhs, jacobians, factorisations, steps, rejected; None where the program behind an
        integrator does not tell) and times of the integrator, s. ``estimate_factor``: what `error`
        takes over the time of the run, where that is not 2.
    geometry : mapping of str to array
        Constant places of the system, such as ``matrix.rest`` (N, 3) um.
    estimator : callable, optional
        Finds `error` when it is first asked for; it may solve the run again.
    model_error : mapping of str to float
        The model's part of the error, from its card: relative error of roll-outs by block.
        Empty for a full-order run, which is its own reference.
    source : mapping
        Where the run comes from, as plain values: its scene, the file it was read from, the
        version and platform that made it.
    """

    t: np.ndarray
    x: np.ndarray
    states: Layout
    eta: np.ndarray | None = None
    u: np.ndarray | None = None
    auxiliaries: Layout = Layout()
    W_x: sp.csr_array | None = None
    W_eta: sp.csr_array | None = None
    p: np.ndarray | None = None
    d: np.ndarray | None = None
    amplitude: np.ndarray | None = None
    virial: np.ndarray | None = None
    stiffness: np.ndarray | None = None
    eta_start: np.ndarray | None = None
    events: tuple[Event, ...] = ()
    statistics: Mapping[str, Any] = field(default_factory=dict)
    label: str = ""
    geometry: Mapping[str, np.ndarray] = field(default_factory=dict)
    estimator: Callable[[], ErrorEstimate] | None = field(default=None, repr=False)
    model_error: Mapping[str, float] = field(default_factory=dict)
    source: Mapping[str, object] = field(default_factory=dict)

    _figure: ClassVar[str] = "trajectory"

    def __post_init__(self) -> None:
        if np.ndim(self.t) != 1:
            raise DimensionError(f"t must be a list of times, got shape {np.shape(self.t)}")
        n_times = np.shape(self.t)[0]
        if np.shape(self.x) != (n_times, self.states.size):
            raise DimensionError(
                f"x must have shape ({n_times}, {self.states.size}), got {np.shape(self.x)}"
            )
        if n_times > 1 and not np.all(np.diff(self.t) > 0):
            raise DataError("t must increase; sort the samples or drop repeated times")
        for name, width in (("eta", self.auxiliaries.size), ("u", self.states.size)):
            value = getattr(self, name)
            if value is not None and np.shape(value) != (max(n_times - 1, 0), width):
                raise DimensionError(
                    f"{name} must have shape ({max(n_times - 1, 0)}, {width}), "
                    f"got {np.shape(value)}"
                )

    def __len__(self) -> int:
        return int(np.shape(self.t)[0])

    def block(self, name: str) -> np.ndarray:
        """State block over time, shape (T, *block.shape)."""
        return self.states.view(np.asarray(self.x), name)

    def auxiliary(self, name: str) -> np.ndarray:
        """Auxiliary block over time, shape (T - 1, *block.shape)."""
        if self.eta is None:
            raise DataError("this trajectory was recorded without its auxiliaries")
        return self.auxiliaries.view(np.asarray(self.eta), name)

    @property
    def polarities(self) -> np.ndarray:
        """`p` (T, cells, 3) of a run that has it; DataError where no cell has a polarity."""
        if self.p is None:
            raise DataError("this trajectory has no polarity; run cells that are steered")
        return self.p

    def stride(self, step: float) -> int:
        """Samples per `step` s, for ``run.x[::run.stride(model.dt)]``.

        Raises
        ------
        DataError
            Samples that are not equally spaced, or a step that is no multiple of their interval.
        """
        spacing = np.diff(np.asarray(self.t, dtype=float))
        if not spacing.size:
            raise DataError("one sample has no interval; run longer")
        interval = float(spacing.mean())
        if np.abs(spacing - interval).max() > 1e-6 * interval:
            raise DataError(
                f"samples are {spacing.min():.6g} to {spacing.max():.6g} s apart; take a run of "
                "equally spaced ones"
            )
        every = step / interval
        if not (np.isfinite(every) and round(every) >= 1 and abs(every - round(every)) < 1e-6):
            raise DataError(
                f"a step of {step:.6g} s is no multiple of the samples' {interval:.6g} s; sample "
                f"the run every {step:.6g} s"
            )
        return round(every)

    def nodal(self) -> dict[str, np.ndarray]:
        """Stored measures (T, N) of the matrix nodes by name: ``virial``, ``stiffness``."""
        both = {"virial": self.virial, "stiffness": self.stiffness}
        return {name: values for name, values in both.items() if values is not None}

    def residual_share(self) -> dict[str, float]:
        """Rms of ``step_residual`` over rms of dx/dt, for each state block of kind position."""
        if self.eta is None or "step_residual" not in self.auxiliaries:
            raise DataError("this trajectory was recorded without its auxiliaries")
        residual = self.auxiliaries.view(np.asarray(self.eta), "step_residual")
        rate = np.diff(np.asarray(self.x), axis=0) / np.diff(self.t)[:, None]
        share = {}
        for block in self.states:
            if block.kind != "position":
                continue
            piece = self.states.slice(block.name)
            norm = float(np.linalg.norm(rate[:, piece]))
            share[block.name] = float(np.linalg.norm(residual[:, piece])) / norm if norm else 0.0
        return share

    @cached_property
    def error(self) -> ErrorEstimate:
        """The integrator's part of the error, found when first asked for."""
        if self.estimator is None:
            return ErrorEstimate(None, np.zeros(self.states.size), "no estimate for this run")
        return self.estimator()

    def error_of(self, name: str) -> float:
        """How far any entry of a state block may be off, in its unit, over the whole run.

        The integrator's part of the error (`error`, found when first asked for), of places and
        displacements (n, 3) the length of a node's; where there is no estimate, and at least, the
        rounding of the states, 4 eps |x|. The model's part is not in it. What is smaller than this
        is not to be told from zero.
        """
        return float(np.max(self.errors_of(name), initial=0.0))

    def errors_of(self, name: str) -> np.ndarray:
        """`error_of` each entry of a state block, of each node (n,) where it holds places."""
        block = self.states[name]
        rounding = 4.0 * np.finfo(float).eps * np.abs(self.block(name)).max(axis=0, initial=0.0)
        error = rounding
        if self.error.absolute is not None:
            error = np.maximum(error, self.states.view(self.error.absolute, name))
        if len(block.shape) == 2 and block.shape[1] == 3:
            error = np.linalg.norm(error, axis=1)
        return error

    def save(self, path: str | Path, *, loads: bool = True) -> Path:
        """Write the run as one ``.npz``: arrays, names and units of the blocks, provenance.

        Parameters
        ----------
        path : path
            ``.npz`` is appended when missing.
        loads : bool
            False: states, polarity, sensed direction and amplitude alone, without the auxiliaries
            (most of the bytes of a full-order run), so that no model can be learned from it.

        Returns
        -------
        Path
            What was written; `load` gives the run back to the last bit. Never pickle.
        """
        fields = dict(vars(self))
        arrays, described = packed(fields, loads)
        if "error" in fields:  # found already; to find it later takes the system
            error: ErrorEstimate = fields["error"]
            described["error"] = {"method": error.method, "time": error.time}
            arrays["error.scale"] = error.scale
            if error.absolute is not None:
                arrays["error.absolute"] = error.absolute
        return save_archive(path, KIND, SCHEMA, arrays, described)

    @classmethod
    def load(cls, path: str | Path) -> Trajectory:
        """The run that `save` wrote.

        Raises
        ------
        FileNotFoundError
        FileFormatError
            Truncated, damaged, of another kind or of another schema.
        """
        arrays, described = load_archive(path, KIND, SCHEMA)
        fields = unpacked(arrays, described)
        kept = described.get("error")
        if isinstance(kept, Mapping) and "error.scale" in arrays:
            found = ErrorEstimate(
                arrays.get("error.absolute"), arrays["error.scale"], str(kept.get("method"))
            )
            fields["estimator"] = lambda: found
        try:
            return cls(**fields)
        except (CellsysError, TypeError) as error:
            raise FileFormatError(f"{Path(path).name!r} is damaged: {error}") from error

    def __getstate__(self) -> dict[str, Any]:
        # An estimator holds the system, whose laws need not be picklable.
        return {k: v for k, v in self.__dict__.items() if k != "estimator"} | {"estimator": None}

    def __str__(self) -> str:
        wall = self.statistics.get("wall_time")
        took = f", computed in {wall:.3g} s" if wall is not None else ""
        lines = [
            f"Trajectory {self.label or '(unnamed)'}: {len(self)} samples, "
            f"t = {self.t[0]:g} .. {self.t[-1]:g} s, {self.states.size} states, "
            f"{self.auxiliaries.size} auxiliaries, {len(self.events)} events{took}"
        ]
        quick = self.statistics.get("estimate_is_quick", wall is not None and wall < SOON)
        if "error" in self.__dict__ or (self.estimator is not None and quick):
            lines.append(f"integrator's error: {self.error}")
        elif self.estimator is not None:
            took = self.statistics.get("estimate_factor", 2.0) * wall
            lines.append(f"integrator's error: `.error` finds it (about {took:.0f} s)")
        else:
            lines.append("integrator's error: not estimated")
        if self.model_error:
            parts = ", ".join(f"{k} {v:.2g}" for k, v in self.model_error.items())
            lines.append(f"model's error (its card): {parts}")
        return "\n".join(lines)
