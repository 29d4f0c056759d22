"""Scenes on a chain: the 1-D crawling cells of thesis chapter 3.

``matrix.kind = "chain"`` takes the parameters of `Chain`, and every ``[[cells]]`` those of
`Crawler`, with units; `polarity` is "0 deg" (right) or "180 deg" (left). The laws of a crawler
are fixed, so a chain has no effects.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, create_model

from cellsys.arguments import checked
from cellsys.drawable import draw_by
from cellsys.errors import ParameterError, SceneError
from cellsys.geometry.chain import Chain
from cellsys.integrate.scipy_methods import LSODA
from cellsys.mechanics.crawler import Crawler, CrawlerSystem, build_crawlers, check_places
from cellsys.scene.headings import S
from cellsys.scene.memory import ADDRESSES, MOST_NODES, PROGRAM, MemoryNeed, kept
from cellsys.scene.plan import ScenePlan
from cellsys.scene.tables import Angle, Count, Extends, Sample, Time, TomlTable, amount
from cellsys.trajectory import Trajectory

# Switch times within 1e-7 s of a reference at 1e-12. LSODA changes to BDF by itself where a small
# drag of the attached nodes makes the chain stiff, so that one method serves every chain.
METHOD = LSODA(rtol=1e-10, atol=1e-12)
KICK = 0.1  # um/s beside the velocities that crawlers start with
_NODE = 3e3  # bytes: states, W_eta while it is assembled, work arrays of the integrator
_NO_USE = {
    "train": "a scene with matrix.kind = 'chain' has no headings to train on; vary its cells with "
    "dataclasses.replace and use run_ensemble",
    "leave out": "a scene with matrix.kind = 'chain' has no effects to leave out",
    "step": "a scene on a chain is run by LSODA at a tolerance of 1e-10, far below any --error; "
    "leave it out (`cellsys cost` shows what a looser one would save)",
}

_CHAIN = {"spacing": "um", "stiffness": "pN", "stiffening": "1", "drag": "pN s/um"}
_CRAWLER = {
    "mass": "pN s^2/um",
    "drag": "pN s/um",
    "drag2": "pN s^2/um^2",
    "stiffness": "pN/um",
    "stiffness3": "pN/um^3",
    "damping": "pN s/um",
    "length": "um",
    "adhesion_trail": "pN/um",
    "adhesion_lead": "pN/um",
    "grab": "um",
    "rupture": "um",
    "trail": "um",
    "lead": "um",
    "trail_velocity": "um/s",
    "lead_velocity": "um/s",
}


@checked
@dataclass(frozen=True, kw_only=True)
class ChainScene(Chain):
    """The matrix of a scene on a chain: a `Chain`, with its parameters."""

    kind: str = "chain"

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"a chain of {self.nodes} nodes"

    def build(self, scene: ScenePlan) -> CrawlerSystem:
        """The crawlers on the chain."""
        return build_crawlers(scene.crawlers, self)

    def place_cells(self, scene: ScenePlan) -> None:
        """Refuse what is no crawler, nodes outside the chain, and attachments that cross."""
        for index, cell in enumerate(scene.cells):
            if not isinstance(cell, Crawler):
                raise SceneError(
                    f"cells[{index}] must be a Crawler with matrix.kind = 'chain', got "
                    f"{type(cell).__name__}"
                )
        check_places(scene.crawlers, self)

    def start_elsewhere(self, scene: ScenePlan, rng: np.random.Generator) -> tuple[Crawler, ...]:
        """Every crawler with drawn velocities, up to `KICK` beside its own."""
        return tuple(
            dataclasses.replace(
                c,
                lead_velocity=c.lead_velocity + float(rng.uniform(-KICK, KICK)),
                trail_velocity=c.trail_velocity + float(rng.uniform(-KICK, KICK)),
            )
            for c in scene.crawlers
        )

    def train(self, scene: S) -> tuple[list[S], list[S]]:
        """Refused: crawlers take no commands."""
        self.refuse(scene, "train")
        return [], []

    def turn(
        self, scene: S, n: int, *, seed: int, loaded: bool, scatter: float, label: str
    ) -> list[S]:
        """Refused: crawlers take no commands."""
        self.refuse(scene, "train")
        return []

    def draw(self, run: Trajectory, ax: object = None, *, k: int = -1) -> object:
        """Displacement of every node against time, up to sample k."""
        error = run.error_of("chain.displacement")
        shown = slice(None) if k in (-1, len(run) - 1) else slice(k + 1)
        u = run.block("chain.displacement")[shown]
        return draw_by("row_displacement", run.t[shown], self.rest, u, ax=ax, error=error)

    def refuse(self, scene: ScenePlan, use: str = "run") -> None:
        """Refuse effects, commands and ends at a contact; of uses all but running."""
        if use in _NO_USE:
            raise SceneError(_NO_USE[use])
        if scene.until is not None:
            raise SceneError(
                f"until = {scene.until!r} is for cells with a membrane; crawlers on a chain stall "
                "where they meet: leave it out"
            )
        if scene.stepper is not None:
            raise SceneError(
                f"stepper = {scene.stepper!r} is for cells with a membrane; crawlers are run by "
                "LSODA, which finds their switches: leave it out"
            )
        if scene.effects:
            raise SceneError(
                "; ".join(
                    f"effects.{name} has no meaning with matrix.kind = 'chain': "
                    + effect.not_on.get("chain", "a crawler's laws are fixed")
                    for name, effect in scene.effects.items()
                )
            )
        if scene.commands.heading or scene.commands.amplitude:
            raise SceneError(
                "commands have no meaning with matrix.kind = 'chain': no lamellipodium"
            )

    def method(self, scene: ScenePlan) -> LSODA:
        """`METHOD`, which finds the switches."""
        return METHOD

    def memory(self, scene: ScenePlan, *, on_disk: bool = True, run: bool = True) -> MemoryNeed:
        """By the number of nodes.

        LSODA finds a whole run at once, and asks for a dense Jacobian that it touches only where
        the chain is stiff.
        """
        nodes = float(min(self.nodes, MOST_NODES))
        record = 8.0 * len(scene.times) * 4.0 * nodes if run else 0.0
        held = PROGRAM + _NODE * nodes + record + kept(scene, record, on_disk)
        dense = 8.0 * nodes**2 if run else 0.0
        return MemoryNeed(held, ADDRESSES + held - PROGRAM + dense, record)

    def words(self, scene: ScenePlan) -> tuple[str, str]:
        """The scene in words, and what makes it smaller."""
        return self.title, "make the chain shorter"


def _fields(model: type, units: Mapping[str, str]) -> dict[str, Any]:
    default = {item.name: item.default for item in dataclasses.fields(model)}
    return {
        name: (amount(unit) if default[name] is not None else amount(unit) | None, default[name])
        for name, unit in units.items()
    }


_KIND: Any = (Literal["chain"], "chain")
_ChainTable = create_model(
    "ChainTable",
    __base__=TomlTable,
    kind=_KIND,
    nodes=(Annotated[Count, Field(lt=2**53)], Chain().nodes),
    **_fields(Chain, _CHAIN),
)
_CrawlerTable = create_model(
    "CrawlerTable",
    __base__=TomlTable,
    polarity=(Angle, 0.0),
    trail_node=(Count, Crawler().trail_node),
    lead_node=(Count, Crawler().lead_node),
    **_fields(Crawler, _CRAWLER),
)


class ChainSceneTable(TomlTable):
    """A scene on a chain."""

    extends: Extends = None
    name: Annotated[str, Field(min_length=1)]
    duration: Time
    sample: Sample = 0.1
    matrix: _ChainTable  # type: ignore[valid-type]
    cells: list[_CrawlerTable]  # type: ignore[valid-type]
    effects: dict[str, object] = Field(default_factory=dict)


def chain_parts(parsed: Any) -> tuple[ChainScene, tuple[Crawler, ...]]:
    """Matrix and cells of a parsed `ChainSceneTable`.

    Raises
    ------
    SceneError
        A polarity that is neither right nor left, or a value out of its range.
    """
    cells = []
    for index, table in enumerate(parsed.cells):
        values = {name: getattr(table, name) for name in (*_CRAWLER, "trail_node", "lead_node")}
        # 1e-9: the rounding of degrees to radians, far below any other angle that is meant.
        if abs(np.sin(table.polarity)) > 1e-9:
            raise SceneError(
                f"cells[{index}].polarity must be '0 deg' (right) or '180 deg' (left) on a chain, "
                f"got {np.degrees(table.polarity):g} deg"
            )
        try:
            cells.append(Crawler(**values, heading=round(np.cos(table.polarity))))
        except ParameterError as error:
            raise SceneError(f"cells[{index}]: {error}") from error
    return ChainScene(**parsed.matrix.model_dump()), tuple(cells)
