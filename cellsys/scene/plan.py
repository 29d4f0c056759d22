"""`ScenePlan`: a scene as its matrix sees it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from cellsys.contracts import MatrixKind
from cellsys.mechanics.commands import Commands
from cellsys.mechanics.crawler import Crawler
from cellsys.mechanics.effects.protocol import Effect
from cellsys.scene.parts import CellScene, Training

Cell = CellScene | Crawler


class ScenePlan(Protocol):
    """A scene, made by cs.load_scene(path) or cs.Scene.parse(table)."""

    name: str
    duration: float
    sample: float
    effects: Mapping[str, Effect]
    cells: tuple[CellScene, ...] | tuple[Crawler, ...]
    matrix: Kind | None
    commands: Commands
    training: Training
    seed: int
    step: float
    until: str | None

    @property
    def times(self) -> np.ndarray:
        """Sample times, s."""

    @property
    def matrix_kind(self) -> Kind:
        """Its matrix, or what stands for none."""


Kind = MatrixKind[Any, Any]
