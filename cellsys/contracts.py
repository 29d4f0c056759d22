"""Contracts: what rooms hand each other, and what an object of your own needs to join.

A contract says what is asked of an object, not which class it has. In the annotation of a public
function it is held by `cellsys.arguments`; `needs` holds it anywhere else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Protocol, TypeVar, runtime_checkable

import numpy as np

from cellsys.answers import (
    DistinctPoles,
    Measured,
    OutsideRange,
    SteppedRun,
    WholeSolution,
)
from cellsys.arguments import needs
from cellsys.linear_systems import LinearSystem, StateSpaceLike, TransferFunctionLike
from cellsys.system import Layout, Matrix, OdeSystem
from cellsys.trajectory import Trajectory

if TYPE_CHECKING:
    from control import StateSpace

__all__ = [
    "Cells",
    "ChoosesOrder",
    "Embedding",
    "Integrator",
    "LinearModel",
    "LinearSystem",
    "LoadPort",
    "Loop",
    "MatrixField",
    "MatrixKind",
    "ReadOut",
    "ReducedModel",
    "Reductor",
    "Regression",
    "StateSpaceLike",
    "StepSystem",
    "SteppedField",
    "Stepping",
    "TransferFunctionLike",
    "WholeRun",
    "needs",
]


@runtime_checkable
class WholeRun(Protocol):
    """An integrator that finds a whole run at once."""

    def solve(
        self, system: OdeSystem, t: np.ndarray, x0: np.ndarray, *, averages: bool = True
    ) -> WholeSolution:
        """States at the times t, and the averages of eta and u between them."""


@runtime_checkable
class Stepping(Protocol):
    """An integrator that goes from sample to sample by a stepper of its own."""

    def start(
        self, system: OdeSystem, t0: float, x0: np.ndarray, rng: np.random.Generator
    ) -> SteppedRun:
        """A stepper at (t0, x0)."""


Integrator = Annotated[
    WholeRun | Stepping, "an integrator such as cs.DOP853(rtol=1e-8, atol=1e-10)"
]


class StepSystem(Protocol):
    """A system with a step of its own, x+ = step(x, u, t), every dt seconds."""

    @property
    def states(self) -> Layout:
        """Names of the entries of x."""

    @property
    def x0(self) -> np.ndarray:
        """Initial state (n,)."""

    @property
    def dt(self) -> float:
        """Step, s."""

    def step(self, x: np.ndarray, u: np.ndarray | None, t: float) -> np.ndarray:
        """x (n,) at t + dt from x at t, under the inputs u (n_u,) held over the step."""


class ReducedModel(Protocol):
    """A reduced model, made by cs.reduce(data, order=...)."""

    @property
    def order(self) -> int:
        """Number of latent states."""

    @property
    def dt(self) -> float | None:
        """Step, s; None of a continuous model."""

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the commands."""

    @property
    def z_start(self) -> np.ndarray | None:
        """Latent state (m,) at the start of the training runs."""

    @property
    def sensor(self) -> Any:
        """What it senses with, or None."""

    @property
    def card(self) -> Measured | None:
        """What it is worth, or None."""

    @property
    def notes(self) -> Mapping[str, Any]:
        """What else is known of it."""

    def encode(self, x: np.ndarray, eta: np.ndarray | None = None) -> np.ndarray:
        """Latent states of samples."""

    def reconstruct(self, z: np.ndarray) -> np.ndarray:
        """Samples of latent states."""

    def predict(self, z0: np.ndarray, u: np.ndarray | None, t: np.ndarray) -> np.ndarray:
        """Latent states (T, m) at the times t from z0 under the commands u."""

    def step_matrices(self, dt: float | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(A_d, B_d, b_d) of z+ = A_d z + B_d c + b_d over a step."""

    def at(self, t: float) -> ReducedModel:
        """The model frozen at time t, s."""

    def growth(self) -> float:
        """Spectral abscissa, 1/s."""

    def pole_set(self) -> np.ndarray:
        """The poles, 1/s, with their bounds."""

    def plant(self) -> StateSpace:
        """The model as a control.StateSpace."""

    def validity(
        self, t: np.ndarray, z: np.ndarray, u: np.ndarray | None = None
    ) -> Sequence[OutsideRange]:
        """Flags where a roll-out leaves what the model was trained on."""


class LinearModel(ReducedModel, Protocol):
    """A linear reduced model, made by cs.reduce(data, order=...).

    z' = A z + B c + b, or the generator of a step of dt seconds; at one time where the model
    follows a clock.
    """

    @property
    def A(self) -> np.ndarray:
        """(m, m), 1/s."""

    @property
    def B(self) -> np.ndarray:
        """(m, n_c), of the commands."""

    @property
    def offset(self) -> np.ndarray:
        """b (m,), 1/s."""

    def continuous_matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(A_c, B_c, b_c) of z' = A_c z + B_c c + b_c."""


class Reductor(Protocol):
    """A reductor such as cs.PCR().

    It may ignore `test` and `basis`. An attribute ``own_basis = True`` says that it ignores
    `basis`, so that none is made for it; ``name`` is what tables call it. A model that comes
    without a card is given one, measured on `test`.
    """

    def fit(
        self, snapshots: Any, order: int, /, *, test: Any = None, basis: Any = None
    ) -> ReducedModel:
        """A model of this order learned from snapshots."""


@runtime_checkable
class Regression(Reductor, Protocol):
    """A reductor that solves one regression in the common basis, so that refits are cheap."""

    svd: Any

    def refit(self, data: Any, basis: Any, kept: np.ndarray) -> np.ndarray:
        """A (m, m) from the samples `kept` (n_samples,) alone, in the same basis."""


@runtime_checkable
class ChoosesOrder(Reductor, Protocol):
    """A reductor that finds the order for a tolerance in its own coordinates."""

    def order_for(self, data: Any, tol: float) -> int:
        """Smallest order that leaves at most `tol` of the squared norm."""


class MatrixField(Protocol):
    """A matrix field such as cs.GalerkinField(system) or cs.full_field(system)."""

    @property
    def order(self) -> int:
        """Number of coordinates."""

    @property
    def drag(self) -> float:
        """Of a node, pN s/um."""

    @property
    def stiffness(self) -> Matrix:
        """Of the coordinates (order, order), pN/um."""

    @property
    def nodes(self) -> np.ndarray:
        """Nodes at rest (n, 3), um."""

    @property
    def surface(self) -> np.ndarray:
        """Numbers of the nodes that adhesions reach."""

    def project(self, f: np.ndarray) -> np.ndarray:
        """Nodal loads (..., n, 3) as loads on the field's coordinates (..., order)."""

    def displacement(self, q: np.ndarray) -> np.ndarray:
        """Nodal displacements (..., n, 3), um, of coordinates (..., order)."""


class LoadPort(Protocol):
    """A load port such as cs.PatchPort()."""

    @property
    def n_loads(self) -> int:
        """Number of loads."""

    def gather(self, field: MatrixField, position: np.ndarray, heading: float) -> np.ndarray:
        """E (n_loads, order): what the port reads of the field's coordinates."""


class SteppedField(MatrixField, Protocol):
    """A matrix field that steps itself, such as cs.GalerkinField(system)."""

    def step(
        self, q: np.ndarray, load: np.ndarray, dt: float, *, memory: Any = None, t: float = 0.0
    ) -> tuple[np.ndarray, Any]:
        """Coordinates after one implicit step of dt under the load (order,), and how it went."""

    def energy(self, q: np.ndarray) -> float:
        """Stored energy, pN um."""

    def memory(self) -> Any:
        """What steps in a row keep for each other."""


class Loop(Protocol):
    """A closed loop of plant, controller and sensor, made by cs.closed_loop(model)."""

    @property
    def order(self) -> int:
        """m of the plant."""

    def simulate(self, t: np.ndarray, integrator: Integrator | None = None) -> Trajectory:
        """A run at the times t, s; an integrator that cannot serve is refused."""

    def linearize(self, at: object = None, *, slower_than: float = 0.0) -> object:
        """The loop about a point."""

    def open_loop(self, at: object = None) -> object:
        """The loop cut open at the polarity, as a control.StateSpace: a margin is one on kappa."""


ReadOut = Annotated[
    Callable[[Trajectory], Mapping[str, float]],
    "a function of a run that returns numbers by name, such as cs.read_outs",
]


class Cells(Protocol):
    """Coupled cells, made by cs.couple(model, n_cells)."""

    @property
    def n_cells(self) -> int:
        """K."""

    @property
    def order(self) -> int:
        """Latent states of one cell."""

    def poles(self) -> np.ndarray:
        """Every pole, 1/s."""

    def pole_set(self) -> DistinctPoles:
        """Distinct poles with their multiplicities, 1/s."""

    def plant(self) -> StateSpace:
        """The whole as a control.StateSpace."""

    def stability(self) -> object:
        """The verdict, with its certificate or its bounds."""

    def simulate(self, t: np.ndarray, integrator: Integrator | None = None) -> Trajectory:
        """A run at the times t, s; an integrator is obeyed, or refused with the reason."""


@runtime_checkable
class Embedding(Protocol):
    """A matrix that cells lie in, not on, such as cs.scene.GelScene()."""

    def control(self, scene: Any) -> Any:
        """The same matrix, node by node, for one of the cells of a scene alone."""


_Scene = TypeVar("_Scene")
_Cell = TypeVar("_Cell", covariant=True)


class MatrixKind(Protocol[_Scene, _Cell]):
    """A matrix for a scene, such as cs.scene.MatrixScene() or cs.scene.ChainScene().

    A frozen dataclass whose fields are its parameters; `cs.scene.Plane` has all of this for cells
    with a membrane on a flat network but `network`. What is refused raises SceneError.
    """

    @property
    def kind(self) -> str:
        """What a scene file calls it, in matrix.kind."""

    @property
    def title(self) -> str:
        """What it is, in a few words: "a disc of 60 um"."""

    def build(self, scene: _Scene) -> OdeSystem:
        """The full-order system of the scene."""

    def place_cells(self, scene: _Scene) -> None:
        """Refuse cells of the scene that have no place here, each by its number."""

    def start_elsewhere(self, scene: _Scene, rng: np.random.Generator) -> tuple[_Cell, ...]:
        """The cells of the scene, starting from somewhere else that is drawn."""

    def train(self, scene: _Scene) -> tuple[list[_Scene], list[_Scene]]:
        """Scenes to train a reduced model on, and to test it on."""

    def turn(
        self, scene: _Scene, n: int, *, seed: int, loaded: bool, scatter: float, label: str
    ) -> list[_Scene]:
        """Scenes with turning commands; see `turning_scenes`."""

    def draw(self, run: Trajectory, ax: object = None, *, k: int = -1) -> object:
        """Draw the displacement of the matrix up to sample k of a run; returns the axes."""

    def refuse(self, scene: _Scene, use: str = "run") -> None:
        """Refuse what this matrix gives no meaning to, with the reason.

        `use` is what the scene is wanted for: "run", "train", "step" (a step that keeps an
        error) or "leave out" (runs without one effect).
        """

    def method(self, scene: _Scene) -> Integrator:
        """The integrator that runs of the scene are made with."""

    def memory(
        self, scene: _Scene, *, on_disk: bool = True, run: bool = True
    ) -> tuple[float, float, float]:
        """Bytes that a process holds at its peak, asks for, and of the rows; see `memory_need`."""

    def words(self, scene: _Scene) -> tuple[str, str]:
        """The scene in words ("a chain of 40 nodes"), and what makes it smaller."""
