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
from cellsys.errors import ParameterError, SceneError
from cellsys.integrate.scipy_methods import LSODA
from cellsys.mechanics.commands import Commands
from cellsys.mechanics.crawler import Crawler, check_places
from cellsys.mechanics.effects.protocol import Effect
from cellsys.mechanics.geometry.chain import Chain
from cellsys.scene.tables import Angle, Count, Extends, Sample, Time, TomlTable, amount

# Switch times within 1e-7 s of a reference at 1e-12. LSODA changes to BDF by itself where a small
# drag of the attached nodes makes the chain stiff, so that one method serves every chain.
METHOD = LSODA(rtol=1e-10, atol=1e-12)

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


def _fields(model: type, units: Mapping[str, str]) -> dict[str, Any]:
    default = {item.name: item.default for item in dataclasses.fields(model)}
    return {
        name: (amount(unit) if default[name] is not None else amount(unit) | None, default[name])
        for name, unit in units.items()
    }


_ChainTable = create_model(
    "ChainTable",
    __base__=TomlTable,
    kind=(Literal["chain"], "chain"),
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
    effects: dict[str, Any] = Field(default_factory=dict)


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


def check_chain(
    matrix: ChainScene,
    cells: tuple[Any, ...],
    effects: Mapping[str, Effect],
    commands: Commands,
) -> None:
    """Raise `SceneError` for what a chain cannot have, with the reason."""
    if effects:
        raise SceneError(
            "; ".join(
                f"effects.{name} has no meaning with matrix.kind = 'chain': "
                + effect.not_on.get("chain", "a crawler's laws are fixed")
                for name, effect in effects.items()
            )
        )
    if commands.heading or commands.amplitude:
        raise SceneError("commands have no meaning with matrix.kind = 'chain': no lamellipodium")
    for index, cell in enumerate(cells):
        if not isinstance(cell, Crawler):
            raise SceneError(
                f"cells[{index}] must be a Crawler with matrix.kind = 'chain', got "
                f"{type(cell).__name__}"
            )
    check_places(cells, matrix)
