"""`PrintedCells`: what plants, runs, poles and verdicts ask of cells coupled in a printed form."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from cellsys.contracts import Cells
from cellsys.loop import ClosedLoop
from cellsys.model.latent import LatentModel
from cellsys.population.graph import InteractionGraph
from cellsys.population.poleset import PoleSet
from cellsys.population.printed.blocks import ModeBlock, PrintedForm
from cellsys.population.printed.modes import Modes
from cellsys.population.printed.split import FieldSplit
from cellsys.spectra.certainty import PoleCertainty


class PrintedCells(Cells, Protocol):
    """Coupled cells such as `CoupledCells`, whose attributes these are."""

    @property
    def model(self) -> LatentModel:
        """One cell."""

    @property
    def coupling(self) -> PrintedForm:
        """The form."""

    @property
    def graph(self) -> InteractionGraph | None:
        """None: every cell meets every other with weight 1."""

    @property
    def headings(self) -> np.ndarray | None:
        """Polarity angles at the start (K,), rad."""

    @property
    def loop(self) -> ClosedLoop | None:
        """Controller and sensor of every cell."""

    @property
    def matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(A, B, b) of one isolated cell in continuous time."""

    @property
    def field(self) -> np.ndarray:
        """Row indices of V that count as matrix."""

    @property
    def rank(self) -> FieldSplit:
        """The rank decision."""

    @property
    def modes(self) -> Modes | None:
        """The split of the interaction."""

    @property
    def route(self) -> str:
        """Which route is taken, and why."""

    @property
    def doubtful(self) -> np.ndarray:
        """|N| of the directions kept that the data do not determine."""

    @property
    def eigenvalues(self) -> list[np.ndarray]:
        """Of each matrix of `distinct(drop=False)`."""

    @property
    def block_certainty(self) -> tuple[list[PoleCertainty] | None, str]:
        """What the data leave open of each, and what is said of it."""

    def blocks(self, *, drop: bool = False) -> list[ModeBlock]:
        """Every block of the split."""

    def distinct(self, *, drop: bool) -> list[tuple[np.ndarray, int, int, float]]:
        """(matrix, multiplicity, dropped, omega)."""

    def describe_doubt(self) -> str:
        """The doubtful values in words."""

    def pole_set(self) -> PoleSet:
        """Distinct poles with multiplicities."""
