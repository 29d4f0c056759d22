"""Copies of a model of one cell on the matrix of a scene of several, beside the full-order run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellsys.accuracy.measures import motion, relative
from cellsys.cell import EquivariantModel
from cellsys.contracts import LinearModel
from cellsys.effects.commands import Commands
from cellsys.effects.steering import Polarity, StiffnessSensing
from cellsys.errors import ParameterError
from cellsys.field import full_field
from cellsys.loop import PolarityLaw
from cellsys.mechanics.spreading import SpreadingSystem
from cellsys.observe import heading_error_deg
from cellsys.population import FieldSensor, LoadPorts, couple
from cellsys.population.ported.equivariant_cells import EquivariantCells
from cellsys.scene import Scene
from cellsys.scene.parts import CellScene
from cellsys.shown import Shown
from cellsys.study.summary import ReducedSummary
from cellsys.trajectory import Trajectory, cell_names

MATRIX = "matrix.displacement"


@dataclass(frozen=True, eq=False, kw_only=True)
class ReducedCells(Shown):
    """Reduced cells against the full-order run, up to its end.

    Attributes
    ----------
    run : Trajectory
        In nodes, as the full-order model stores it.
    latent : Trajectory
        The same as it was computed.
    cells, matrix : float
        Error of the positions over their motion, of the matrix's displacement over its size.
    superposed : float
        The same for the summed displacements of full-order cells alone; NaN without them.
    heading : float
        Rms difference of the headings, deg; NaN without.
    steered : bool
        Whether the cells steered themselves; else they followed the commands.
    """

    run: Trajectory
    latent: Trajectory
    cells: float
    matrix: float
    superposed: float
    heading: float
    steered: bool

    def table(self) -> ReducedSummary:
        """For ``summary.json``."""
        return ReducedSummary(
            error_on_cells=self.cells,
            error_on_matrix=self.matrix,
            error_of_superposed_cells_alone=self.superposed,
            heading_rms_deg=self.heading,
            steered=self.steered,
            seconds=self.latent.statistics["wall_time"],
            events=self.latent.events,
        )

    def verdict(self) -> str:
        """One sentence."""
        return (
            f"reduced cells miss {self.cells:.2g} of the cells' motion and {self.matrix:.2g} of "
            f"the matrix's displacement (superposed cells alone {self.superposed:.2g})"
        )

    def __str__(self) -> str:
        how = "each its own polarity" if self.steered else "headings as commanded"
        head = f", heading {self.heading:.1f} deg rms" if np.isfinite(self.heading) else ""
        lines = [f"{self.verdict()}{head}; {how}", str(self.latent)]
        return "\n".join([*lines, *(f"  {e.time:g} s: {e.detail}" for e in self.latent.events)])


def check_model(scene: Scene, model: LinearModel) -> EquivariantModel:
    """The model, of which copies can run beside this scene; asked before anything is run.

    Raises
    ------
    ParameterError
        When it is another kind of model, the scene has no cells on a matrix, or its samples miss
        the model's step.
    """
    if not isinstance(model, EquivariantModel):
        raise ParameterError(
            f"cells on one matrix need an Equivariant model, got {type(model).__name__}; "
            "`cellsys run` of a scene with one cell writes model_equivariant.npz"
        )
    if scene.matrix is None or not scene.cells:
        raise ParameterError("a model is run beside a scene with cells on a matrix; leave it out")
    sample = float(scene.times[1])
    every = model.dt / sample
    if abs(every - round(every)) > 1e-9 or round(every) < 1:
        raise ParameterError(
            f"the scene is sampled every {sample:g} s, which does not divide the model's step of "
            f"{model.dt:g} s; set sample = '{model.dt:g} s'"
        )
    return model


def reduced_cells(
    scene: Scene,
    system: SpreadingSystem,
    model: LinearModel,
    run: Trajectory,
    alone: list[Trajectory],
) -> ReducedCells:
    """Run one copy of the model for every cell of the scene, on all fibres of its matrix.

    Cells steer themselves by the scene's polarity law and the sensing law on the shared fibres, or
    follow its commands.

    Parameters
    ----------
    system
        ``build(scene)``.
    model : EquivariantModel
    run, alone : Trajectory, list of Trajectory
        The full-order run and the one-cell controls, what is compared with.

    Raises
    ------
    ParameterError
        As `check_model`.
    """
    copied = check_model(scene, model)
    marks = np.arange(0, len(run), run.stride(copied.dt))
    places = np.array([c.position for c in scene.membranes])
    headings = np.array([c.polarity for c in scene.membranes])
    commanded = any(_commands(scene, c).heading for c in scene.membranes)
    steered = "polarity" in scene.effects and not commanded
    polarity, sensing = scene.find(Polarity), scene.find(StiffnessSensing)
    law = PolarityLaw(kappa=polarity.kappa) if steered and polarity is not None else None
    sensor = FieldSensor.of(sensing) if steered and sensing is not None else None
    cells = couple(
        copied,
        coupling=LoadPorts(field=full_field(system), positions=places, headings=headings),
        controller=law,
        sensor=sensor,
    )
    if not isinstance(cells, EquivariantCells):
        raise ParameterError(f"cells on one matrix cannot be run as {type(cells).__name__}")
    t = run.t[marks]
    amplitude, heading = _followed(scene, t)
    found = cells.simulate(t, amplitude=amplitude, heading=None if steered else heading)
    return _compared(cells.in_nodes(found), found, run, marks, alone, steered)


def _commands(scene: Scene, cell: CellScene) -> Commands:
    return cell.commands or scene.commands


def _followed(scene: Scene, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Amplitude and heading (steps, K): means of the commands over the steps."""
    columns = []
    for cell in scene.membranes:
        told = _commands(scene, cell)
        for history, default in ((told.amplitude, 1.0), (told.heading, cell.polarity)):
            held = np.full(len(t) - 1, default)
            columns.append(held if history is None else history.means(t))
    return np.column_stack(columns[::2]), np.column_stack(columns[1::2])


def _compared(
    small: Trajectory,
    latent: Trajectory,
    run: Trajectory,
    marks: np.ndarray,
    alone: list[Trajectory],
    steered: bool,
) -> ReducedCells:
    names = [f"{name}.position" for name in cell_names(small.states)]

    def cells(r: Trajectory, rows: np.ndarray | slice) -> np.ndarray:
        return np.concatenate([r.block(n)[rows] for n in names], axis=1)

    u = run.block(MATRIX)[marks]
    summed = sum(r.block(MATRIX)[marks] for r in alone) if alone else np.full_like(u, np.nan)
    heading = float("nan")
    if run.p is not None and small.p is not None:
        turn = heading_error_deg(np.asarray(run.p)[marks], small.p)
        heading = float(np.sqrt(np.mean(turn**2)))
    return ReducedCells(
        run=small,
        latent=latent,
        cells=motion(cells(small, slice(None)), cells(run, marks)),
        matrix=relative(small.block(MATRIX), u),
        superposed=relative(summed, u),
        heading=heading,
        steered=steered,
    )
