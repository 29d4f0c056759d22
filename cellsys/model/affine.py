"""`AffineModel`: what every reduced affine model z' = A z + B c + b can be asked for."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np

from cellsys.arguments import checked
from cellsys.drawable import Drawable
from cellsys.errors import DimensionError, ParameterError
from cellsys.model.card import Card
from cellsys.model.hold import hold, to_continuous
from cellsys.model.plant import Offset, equilibrium, with_offset
from cellsys.model.poles import certainty_of, continuous_poles, pole_set
from cellsys.model.sensor import StiffnessSensor
from cellsys.model.trained_range import Flag, TrainedRange
from cellsys.spectra.certainty import PoleCertainty
from cellsys.spectra.realization import Realization
from cellsys.spectra.roots import RootSet
from cellsys.state_space import state_space

if TYPE_CHECKING:
    from control import StateSpace


@checked
class AffineModel(Drawable, ABC):
    """A reduced affine model, continuous or the generator of a step.

        dt is None :  z' = A z + B c + b
        dt given   :  z+ = z + dt (A z + B c + b)          [thesis eq. 24]

    The part that `LatentModel` and `EquivariantModel` share: what follows from A, B, b alone.
    The coordinates are their own.
    """

    A: np.ndarray
    B: np.ndarray
    offset: np.ndarray
    dt: float | None
    input_names: tuple[str, ...]
    z_start: np.ndarray | None
    sensor: StiffnessSensor | None
    card: Card | None
    notes: Mapping[str, Any]
    refits: np.ndarray | None
    left_out: str

    @property
    def order(self) -> int:
        """m."""
        return self.A.shape[0]

    def step_matrices(self, dt: float | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(A_d, B_d, b_d) of z+ = A_d z + B_d c + b_d over one step of dt seconds.

        A step model has only its own step; a continuous model takes any (zero-order hold).
        """
        if self.dt is not None:
            if dt is not None and abs(dt - self.dt) > 1e-9 * self.dt:
                raise ParameterError(f"this model has a step of {self.dt:g} s, not {dt:g} s")
            return np.eye(self.order) + self.dt * self.A, self.dt * self.B, self.dt * self.offset
        if dt is None:
            raise ParameterError("a continuous model needs dt for its step matrices")
        return hold(self.A, self.B, self.offset, dt)

    def continuous_matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(A_c, B_c, b_c) of z' = A_c z + B_c c + b_c.

        A step model is inverted under zero-order hold, log [[I + dt A, dt B, dt b], [0, I]] / dt,
        which is refused where I + dt A has an eigenvalue on the closed negative real axis: no
        real continuous model steps like that.
        """
        if self.dt is None:
            return self.A, self.B, self.offset
        return to_continuous(self.A, self.B, self.offset, self.dt)

    def realization(self) -> Realization:
        """`plant(offset="drop")` as matrices alone: with the model's own step where no continuous
        form exists.
        """
        try:
            A, B, _ = self.continuous_matrices()
            return Realization(A, B, np.eye(self.order))
        except ParameterError:
            A, B, _ = self.step_matrices()
            return Realization(A, B, np.eye(self.order), dt=self.dt or 0.0)

    def poles(self) -> np.ndarray:
        """Continuous poles (m,), 1/s: eig(A), or log(eig(I + dt A))/dt of a step model."""
        return continuous_poles(self.A, self.dt)

    def growth(self) -> float:
        """Spectral abscissa, 1/s: largest real part of the continuous poles."""
        return float(self.poles().real.max())

    def certainty(self, *, discrete: bool = False) -> PoleCertainty | None:
        """How far each pole moves when a part of the data is left out; None where not known.

        Of the continuous poles, 1/s, or (`discrete`) of those of `plant(discrete=True)`.
        """
        if self.refits is None:
            return None
        return certainty_of(self.A, self.dt, self.refits, self.left_out, discrete=discrete)

    def pole_set(self) -> RootSet:
        """The poles, 1/s, each with a bound: the larger of rounding and `certainty`."""
        return pole_set(self.A, self.dt, self.certainty())

    # What its coordinates are

    @abstractmethod
    def encode(self, x: np.ndarray, eta: np.ndarray | None = None) -> np.ndarray:
        """Latent states of samples of the full-order states (n,) or (T, n)."""

    @abstractmethod
    def reconstruct(self, z: np.ndarray) -> np.ndarray:
        """Samples of latent states (m,) or (T, m)."""

    @abstractmethod
    def predict(self, z0: np.ndarray, u: np.ndarray | None, t: np.ndarray) -> np.ndarray:
        """Latent states (T, m) at the times t from z0 under the commands u."""

    @abstractmethod
    def at(self, t: float) -> AffineModel:
        """The model frozen at time t, s."""

    @abstractmethod
    def save(self, path: str | Path) -> Path:
        """Write the model to a file, atomically; returns its path."""

    @classmethod
    @abstractmethod
    def read(cls, path: str | Path) -> AffineModel:
        """Read back what `save` wrote; FileFormatError for a model of another kind."""

    # Control

    def equilibrium(self, commands: np.ndarray | None = None) -> np.ndarray:
        """z* (m,) at which the model stands still under these commands (n_c,), zero by default.

        The one of least norm where A is singular; `DataError` where there is none.
        """
        return equilibrium(self.A, self.B, self.offset, commands)

    @overload
    def plant(
        self,
        *,
        discrete: bool = False,
        output: np.ndarray | None = None,
        output_names: Sequence[str] | None = None,
        offset: Literal["input", "drop"] = "input",
    ) -> StateSpace: ...

    @overload
    def plant(
        self,
        *,
        discrete: bool = False,
        output: np.ndarray | None = None,
        output_names: Sequence[str] | None = None,
        offset: Literal["shifted"],
    ) -> tuple[StateSpace, np.ndarray]: ...

    def plant(
        self,
        *,
        discrete: bool = False,
        output: np.ndarray | None = None,
        output_names: Sequence[str] | None = None,
        offset: Offset = "input",
    ) -> StateSpace | tuple[StateSpace, np.ndarray]:
        """The model as `control.StateSpace` with named states, inputs and outputs.

        Parameters
        ----------
        discrete : bool
            Keep a step model's own step; by default it is made continuous (dt = 0), see
            `continuous_matrices`.
        output : (p, m), optional
            Output matrix; default the latent states themselves.
        offset : {"input", "shifted", "drop"}
            What becomes of the offset b, for which a linear system has no place. "input"
            (default): a last input ``one``, which is 1 at all times, so that
            ``control.forced_response(plant, t, [u; 1], z0)`` is `predict`. "shifted": states and
            outputs are those less their values at the equilibrium z* = `equilibrium()`. "drop":
            without b, the linear part alone: transfer from commands to differences of runs.

        Returns
        -------
        StateSpace
            For "shifted" the pair (plant, z*).

        Raises
        ------
        DataError
            "shifted" where the offset pushes an integrator: there is no equilibrium.
        """
        if discrete and self.dt is None:
            raise ParameterError("a continuous model has no step of its own; use control.c2d")
        A, B, b = self.step_matrices() if discrete else self.continuous_matrices()
        C = np.eye(self.order) if output is None else np.atleast_2d(np.asarray(output, float))
        if C.shape[1] != self.order:
            raise DimensionError(f"output must have {self.order} columns, got {C.shape}")
        states = [f"z[{i}]" for i in range(self.order)]
        if output_names is not None:
            outputs = list(output_names)
        else:
            outputs = states if output is None else [f"y[{i}]" for i in range(len(C))]
        B, inputs = with_offset(B, b, self.input_names, offset)
        plant = state_space(
            A,
            B,
            C,
            np.zeros((len(C), B.shape[1])),
            self.dt if discrete and self.dt is not None else 0,
            states=states,
            inputs=inputs,
            outputs=outputs,
            name=f"plant_m{self.order}",
        )
        return (plant, self.equilibrium()) if offset == "shifted" else plant

    def validity(self, t: np.ndarray, z: np.ndarray, u: np.ndarray | None = None) -> list[Flag]:
        """Where a roll-out of `predict` leaves what the model was trained on, in order of time.

        Inputs, latent states and time of the run, each against its trained range and a tenth of
        it; `DataError` for a model that was not made by `reduce`. See `TrainedRange`.
        """
        return TrainedRange.kept(self).check(t, z, u, self.input_names)

    def flags(self, t: np.ndarray, z: np.ndarray, u: np.ndarray | None = None) -> list[Flag]:
        """The same as `validity`."""
        return self.validity(t, z, u)
