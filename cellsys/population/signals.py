"""What the signals of K cells are called."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from cellsys.errors import ParameterError
from cellsys.model.plant import signal_names

Constant = Literal["input", "drop"]  # what becomes of offsets


def cell_prefixes(K: int) -> list[str]:
    """What the signals of each cell begin with: cell1_, cell2_, ..."""
    return [f"cell{k}_" for k in range(1, K + 1)]


def command_names(names: Sequence[str], K: int) -> list[str]:
    """Signals of the commands of K cells: cell1_cos, ..., cell2_cos, ..."""
    own = [n.split(".")[-1].replace("[", "_").replace("]", "") for n in names]
    return signal_names([f"{cell}{n}" for cell in cell_prefixes(K) for n in own])


def check_offset(offset: str) -> None:
    """Refuse what coupled cells do not know."""
    if offset not in ("input", "drop"):
        raise ParameterError(
            f"offset must be 'input' or 'drop' for coupled cells, got {offset!r}; a shifted plant "
            "is that of one cell"
        )
