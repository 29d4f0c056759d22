"""`Trajectory`: what every simulation returns, full-order or reduced."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from cellsys.drawable import Drawable
from cellsys.errors import DataError, DimensionError
from cellsys.system import Event, Layout


@dataclass(frozen=True, eq=False)
class Trajectory(Drawable):
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
    eta_start : array (n_eta,), optional
        The laws at (t_0, x_0), not averaged: what a latent initial state is made from.
    events : tuple of Event
        Discrete happenings, in order of time.
    statistics : mapping
        Counts and times of the integrator.
    geometry : mapping of str to array
        Constant places of the system, such as ``matrix.rest`` (N, 3) um.
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
    eta_start: np.ndarray | None = None
    events: tuple[Event, ...] = ()
    statistics: Mapping[str, Any] = field(default_factory=dict)
    label: str = ""
    geometry: Mapping[str, np.ndarray] = field(default_factory=dict)

    _figure: ClassVar[str] = "trajectory"

    def __post_init__(self) -> None:
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

    def __str__(self) -> str:
        wall = self.statistics.get("wall_time")
        took = f", computed in {wall:.2f} s" if wall is not None else ""
        return (
            f"Trajectory {self.label or '(unnamed)'}: {len(self)} samples, "
            f"t = {self.t[0]:g} .. {self.t[-1]:g} s, {self.states.size} states, "
            f"{self.auxiliaries.size} auxiliaries, {len(self.events)} events{took}"
        )
