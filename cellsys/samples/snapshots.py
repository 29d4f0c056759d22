"""Snapshots: samples of the augmented vector [x; eta] of several runs; rows are samples.

Arrays may be memory-mapped: all works on blocks of rows, so that a set may be larger than memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from cellsys.arguments import checked
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.samples.commands import named_command
from cellsys.store.runs import read_rows, release
from cellsys.system import Layout

SCALES = ("none", "block", "column")
ROWS = 128  # rows of one block when streaming


@checked
@dataclass(frozen=True, eq=False)
class RunData:
    """One run: x (T, n), eta and u (T - 1, .) averaged over the following intervals.

    `commands` (T - 1, n_c) are the inputs behind u; `skip` lists intervals with an event, which
    are not used; `eta_start` (n_eta,) are the laws at x_0; `d` and `nodal` are those of a run.
    """

    x: np.ndarray
    _: KW_ONLY
    eta: np.ndarray | None = None
    u: np.ndarray | None = None
    commands: np.ndarray | None = None
    skip: tuple[int, ...] = ()
    eta_start: np.ndarray | None = None
    d: np.ndarray | None = None
    nodal: Mapping[str, np.ndarray] = field(default_factory=dict)
    label: str = ""

    @property
    def n_pairs(self) -> int:
        """Samples k for which both x~_k and x~_k+1 exist."""
        last = 2 if self.eta is not None else 1
        return max(0, len(self.x) - last)

    def release(self) -> None:
        """Let go of memory-mapped pages; see `cellsys.store.release`."""
        for array in (self.x, self.eta, self.u, *self.nodal.values()):
            release(getattr(array, "_array", array))

    def usable(self) -> np.ndarray:
        """Sample indices k whose step k -> k+1 crosses no event."""
        ks = np.arange(self.n_pairs)
        bad = {j for i in self.skip for j in (i - 1, i, i + 1)}
        return np.array([k for k in ks if k not in bad], dtype=int) if bad else ks


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Snapshots:
    """Samples of [x; eta] with what is needed to learn a model from them.

    Parameters
    ----------
    runs : tuple of RunData
        Never differenced across a seam.
    states, auxiliaries : Layout
        Names of the n states and n_eta auxiliaries (columns of x and eta).
    dt : float
        Sampling interval, s.
    W_x, W_eta : sparse (n, n), (n, n_eta)
        x' = W_x x + W_eta eta + u holds at every sample.
    command_names : tuple of str
        Names of the columns of `commands`.
    scale : {"none", "block", "column"}
        Units of the inner product: as they come; one factor for the positions and one for the
        rates of every cell and of the matrix (default); one factor per column (amplifies noise).
    geometry : mapping of str to array
        Constant places: ``matrix.rest`` (N, 3) um, ``matrix.surface`` (indices).
    """

    runs: tuple[RunData, ...]
    states: Layout
    auxiliaries: Layout
    dt: float
    W_x: sp.csr_array
    W_eta: sp.csr_array
    command_names: tuple[str, ...] = ()
    scale: str = "block"
    source: Mapping[str, object] = field(default_factory=dict)
    geometry: Mapping[str, np.ndarray] = field(default_factory=dict)

    _made_by: ClassVar[str] = "cs.snapshots([...])"

    def __post_init__(self) -> None:
        if not isinstance(self.scale, str) or self.scale not in SCALES:
            raise ParameterError(f"scale must be one of {', '.join(SCALES)}, got {self.scale!r}")
        if not (np.isfinite(self.dt) and self.dt > 0):
            raise ParameterError(f"dt must be > 0 s, got {self.dt!r}")
        if not self.runs:
            raise DataError("snapshots need at least one run")
        if not self.n_samples:
            raise DataError("every run is too short: a run needs at least three samples")
        n = self.states.size
        for name, W, shape in (
            ("W_x", self.W_x, (n, n)),
            ("W_eta", self.W_eta, (n, self.auxiliaries.size)),
        ):
            if W.shape != shape:
                raise DimensionError(f"{name} must have shape {shape}, got {W.shape}")
            if not np.all(np.isfinite(W.data)):
                raise DataError(f"{name} holds NaN or inf")
        for i, run in enumerate(self.runs):
            for name, value, width in (
                ("x", run.x, self.states.size),
                ("eta", run.eta, self.auxiliaries.size),
                ("u", run.u, self.states.size),
                ("commands", run.commands, len(self.command_names)),
            ):
                if value is None:
                    continue
                if np.ndim(value) != 2 or value.shape[1] != width:
                    raise DimensionError(
                        f"{name} of run {i} must have {width} columns, got shape {np.shape(value)}"
                    )
                if name != "x" and len(value) != len(run.x) - 1:
                    raise DimensionError(
                        f"{name} of run {i} must have one row per interval, {len(run.x) - 1} for "
                        f"{len(run.x)} samples of x, got {len(value)}"
                    )
                for start in range(0, len(value), ROWS):
                    rows = read_rows(value, start, start + ROWS)
                    # of NaN neither is true; squares of larger numbers overflow
                    if not (rows.min(initial=0) > -1e100 and rows.max(initial=0) < 1e100):
                        row, column = np.argwhere(~(np.abs(rows) < 1e100))[0]
                        raise DataError(
                            f"{name} of run {i} holds NaN or inf (or more than 1e100), at sample "
                            f"{start + row}, column {column}; repair or leave out that run"
                        )

    @property
    def n_samples(self) -> int:
        """Samples used: those whose successor exists and whose step crosses no event."""
        return sum(len(r.usable()) for r in self.runs)

    @property
    def n_columns(self) -> int:
        """n + n_eta."""
        return self.states.size + self.auxiliaries.size

    @property
    def layout(self) -> Layout:
        """Names of all columns."""
        return self.states + self.auxiliaries

    @property
    def run_ids(self) -> np.ndarray:
        """Run number of each used sample (n_samples,)."""
        return np.concatenate([np.full(len(r.usable()), i) for i, r in enumerate(self.runs)])

    def pieces(self, ahead: int = 0, shift: np.ndarray | None = None) -> Iterator[np.ndarray]:
        """Blocks of rows of [x; eta] at the used samples, each `ahead` samples later.

        `shift` (columns,) is subtracted. The block is valid until the next one is asked for.
        """
        for run in self.runs:
            yield from self.blocks(run, run.usable() + ahead, shift)

    def blocks(
        self, run: RunData, samples: np.ndarray, shift: np.ndarray | None = None
    ) -> Iterator[np.ndarray]:
        """Blocks of rows of [x; eta] of one run at the given samples; see `pieces`."""
        n = self.states.size
        buffer = np.empty((min(ROWS, len(samples)), self.n_columns))
        minus = np.zeros(self.n_columns) if shift is None else shift
        for start in range(0, len(samples), ROWS):
            rows = samples[start : start + ROWS]
            out = buffer[: len(rows)]
            np.subtract(_take(run.x, rows), minus[:n], out=out[:, :n])
            if run.eta is not None:
                np.subtract(_take(run.eta, rows), minus[n:], out=out[:, n:])
            yield out

    def stacked(self, name: str) -> np.ndarray:
        """`u` or `commands` of all used samples, stacked; zeros where a run has none."""
        width = self.states.size if name == "u" else len(self.command_names)
        parts = []
        for run in self.runs:
            value, ks = getattr(run, name), run.usable()
            parts.append(np.zeros((len(ks), width)) if value is None else np.asarray(value)[ks])
        return np.concatenate(parts)

    @cached_property
    def moving_input(self) -> tuple[np.ndarray, np.ndarray]:
        """Columns of u that are ever non-zero, and u (n_samples, columns) there."""
        n, used = self.states.size, np.zeros(self.states.size, bool)
        for run in self.runs:
            if run.u is not None:
                for start in range(0, len(run.u), ROWS):
                    used |= np.any(run.u[start : start + ROWS] != 0, axis=0)
        columns = np.flatnonzero(used)
        parts = []
        for run in self.runs:
            ks = run.usable()
            empty = np.zeros((len(ks), n))
            parts.append((empty if run.u is None else np.asarray(run.u)[ks])[:, columns])
        return columns, np.concatenate(parts)

    def varying_commands(self) -> tuple[np.ndarray, tuple[str, ...]]:
        """Commands of all used samples without those that never vary, and their names.

        A command that never varies (the amplitude, usually) cannot be told from the offset.
        """
        table = self.stacked("commands")
        keep = np.ptp(table, axis=0) > 1e-12
        return table[:, keep], tuple(n for n, k in zip(self.command_names, keep, strict=True) if k)

    def commands_of(self, run: RunData, names: tuple[str, ...]) -> np.ndarray | None:
        """The named commands (T - 1, len(names)) of one run; harmonics from what was recorded."""
        if run.commands is None:
            return None
        t = np.asarray(run.commands)
        columns = (named_command(t, self.command_names, n) for n in names)
        return np.column_stack([np.zeros((len(t), 0)), *columns])

    @property
    def has_u(self) -> bool:
        """Whether any run has an exogenous rate."""
        return any(r.u is not None for r in self.runs)

    def groups(self) -> list[np.ndarray]:
        """Column indices that share a scale factor: positions and rates, per cell and matrix."""
        owners: dict[tuple, list[np.ndarray]] = {}
        layout = self.layout
        for block in layout:
            piece = layout.slice(block.name)
            owner = block.name.split(".")[0] if block.role != "field" else "field"
            if block.name == "step_residual":
                # Split like the states whose rate it is, and in one group with those rates: what
                # is rounding beside them must not be scaled up to a group of its own.
                for state in self.states:
                    inner = self.states.slice(state.name)
                    who = state.name.split(".")[0] if state.role != "field" else "field"
                    kind = "rate" if state.kind == "position" else f"{state.name}.rate"
                    owners.setdefault((who, kind), []).append(
                        np.arange(piece.start + inner.start, piece.start + inner.stop)
                    )
                continue
            kind = block.kind if block.kind != "internal" else block.name
            owners.setdefault((owner, kind), []).append(np.arange(piece.start, piece.stop))
        return [np.concatenate(parts) for parts in owners.values()]


def _take(array: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Rows of an array; a slice, hence no copy, when they are consecutive."""
    if len(rows) and rows[-1] - rows[0] + 1 == len(rows):
        return read_rows(array, int(rows[0]), int(rows[-1]) + 1)
    return array[rows]
