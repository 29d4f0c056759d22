"""Whether the effects of a scene go together; the rules themselves stand with the effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cellsys.effects.protocol import Effect
from cellsys.errors import SceneError


def check_effects(
    shared: Mapping[str, Effect], cells: Sequence[Mapping[str, Effect]], on_matrix: bool
) -> None:
    """Refuse effects without what they need, effects that exclude each other, missing bodies.

    Parameters
    ----------
    shared : mapping
        [effects] of the scene.
    cells : sequence of mappings
        Own effects of every cell.
    on_matrix : bool
        Whether there is a [matrix].

    Raises
    ------
    SceneError
        With the names of the effects and the rule.
    """
    for index, own in enumerate(cells or [{}]):
        present = {**shared, **own}
        where = f"cells[{index}].effects" if own else "effects"
        for name, effect in present.items():
            if effect.name != name:
                raise SceneError(f"{where}.{name} holds the effect {effect.name!r}; use its name")
            _check_one(where, effect, present, bool(cells), on_matrix)
        for name, effect in own.items():
            if effect.acts_on != "cell":
                raise SceneError(
                    f"{where}.{name} does not act on a single cell; move it to [effects]"
                )


def _check_one(
    where: str, effect: Effect, present: Mapping[str, Effect], cells: bool, on_matrix: bool
) -> None:
    name = effect.name
    for need in effect.needs:
        choices = need.split("|")
        if not any(choice in present for choice in choices):
            cure = " or ".join(f"{choice} = {{}}" for choice in choices)
            raise SceneError(f"{where}.{name} needs {' or '.join(choices)}; add {cure} to it")
    for other, rule in effect.excludes.items():
        if other in present:
            raise SceneError(
                f"{where}.{name} and {where}.{other} contradict each other: {rule}; "
                "leave one of them out"
            )
    if effect.acts_on in ("cell", "cells") and not cells:
        raise SceneError(f"effects.{name} acts on a cell, and the scene has no [[cells]]")
    if effect.acts_on == "matrix" and not on_matrix:
        raise SceneError(f"effects.{name} acts on the matrix, and there is no [matrix]")
