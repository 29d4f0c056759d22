"""`ScenePlan`: a scene as its matrix sees it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import Field
from typing import Any, ClassVar, Protocol

import numpy as np

from cellsys.contracts import MatrixKind
from cellsys.effects.commands import Commands
from cellsys.effects.protocol import Effect
from cellsys.mechanics.crawler import Crawler
from cellsys.scene.parts import CellScene, Training

Cell = CellScene | Crawler


class ScenePlan(Protocol):
    """A scene, made by cs.load_scene(path) or cs.Scene.parse(table)."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]  # `dataclasses.replace` takes it

    @property
    def name(self) -> str:
        """What messages call it."""

    @property
    def duration(self) -> float:
        """s."""

    @property
    def sample(self) -> float:
        """Time between samples, s."""

    @property
    def effects(self) -> Mapping[str, Effect]:
        """Effects that act, by name."""

    @property
    def cells(self) -> tuple[CellScene, ...] | tuple[Crawler, ...]:
        """Cells with a membrane, or crawlers."""

    @property
    def matrix(self) -> Kind | None:
        """The matrix, if there is one."""

    @property
    def commands(self) -> Commands:
        """What is prescribed to every cell without commands of its own."""

    @property
    def training(self) -> Training:
        """Runs that a reduced model is learned from."""

    @property
    def seed(self) -> int:
        """Of what is drawn."""

    @property
    def step(self) -> float:
        """Of a stepping integrator, s."""

    @property
    def stepper(self) -> str | None:
        """What steps it, one of `cellsys.scene.steppers.STEPPERS`; None where it names none."""

    @property
    def tolerance(self) -> float | None:
        """Of that stepper; None where the scene names none."""

    @property
    def until(self) -> str | None:
        """What ends the run before its time: "contact"."""

    @property
    def membranes(self) -> tuple[CellScene, ...]:
        """Its cells, which have a membrane; SceneError for crawlers."""

    @property
    def crawlers(self) -> tuple[Crawler, ...]:
        """Its cells, which crawl on a chain; SceneError for cells with a membrane."""

    @property
    def times(self) -> np.ndarray:
        """Sample times, s."""

    @property
    def matrix_kind(self) -> Kind:
        """Its matrix, or what stands for none."""


Kind = MatrixKind[Any, Any]
