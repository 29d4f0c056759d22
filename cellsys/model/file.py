"""Model files: arrays, names and card in one npz with a schema version; never pickle."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from cellsys.errors import FileFormatError
from cellsys.model.affine import AffineModel
from cellsys.model.card import Card
from cellsys.store.archive import archive_kind, load_archive, save_archive
from cellsys.system import Block, Layout

ARRAYS = ("A", "B", "offset", "V", "mean", "scale", "singular_values", "z_start", "refits")
_KIND, _VERSION = "latent model", 1
EQUIVARIANT = "equivariant model"
# What reads a file of each kind. Rooms above this one are named, not imported: they are loaded
# when a file of theirs is met.
KINDS = {
    _KIND: ("cellsys.model.latent", "LatentModel"),
    EQUIVARIANT: ("cellsys.cell.model", "EquivariantModel"),
}


def kind_of_file(path: str | Path) -> type[AffineModel]:
    """The class that reads a model file; errors as of `load_model`."""
    module, name = KINDS.get(archive_kind(path), KINDS[_KIND])
    return getattr(importlib.import_module(module), name)


def save_model(model: Any, path: str | Path) -> Path:
    """Write a `LatentModel`, atomically; returns the file's path."""
    arrays = {k: getattr(model, k) for k in ARRAYS if getattr(model, k) is not None}
    arrays |= {f"block {k}": v for k, v in model.blocks.items()}
    if model.sensor is not None:
        arrays |= {f"sensor {k}": v for k, v in model.sensor.arrays().items()}
    metadata = {
        "dt": model.dt,
        "n_states": model.n_states,
        "input_names": list(model.input_names),
        "states": layout_table(model.states),
        "auxiliaries": layout_table(model.auxiliaries),
        "card": None if model.card is None else model.card.table(),
        "notes": dict(model.notes),
        "left_out": model.left_out,
    }
    return save_archive(path, _KIND, _VERSION, arrays, metadata)


def load_model(path: str | Path) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Fields of the model in a file, and the arrays of its sensor (None without one).

    Raises
    ------
    FileNotFoundError, FileFormatError
    """
    arrays, meta = load_archive(path, _KIND, _VERSION)
    check_real(arrays, path)
    with damage_of(path):
        values = {k: arrays[k] for k in ARRAYS if k in arrays} | {
            "dt": meta["dt"],
            "n_states": meta["n_states"],
            "blocks": {k[6:]: v for k, v in arrays.items() if k.startswith("block ")},
            "states": layout_from(meta["states"]),
            "auxiliaries": layout_from(meta["auxiliaries"]),
            "input_names": tuple(n + "" for n in meta["input_names"]),  # TypeError if no text
            "card": card_from(meta["card"]),
            "notes": dict(meta["notes"]),
            "left_out": str(meta.get("left_out", "run")),
        }
    sensor = {k[7:]: v for k, v in arrays.items() if k.startswith("sensor ")}
    return values, sensor or None


TEXTS = ("sensor inputs", "sensor tried_names")  # arrays of a file that hold no numbers


def check_real(arrays: Mapping[str, np.ndarray], path: str | Path) -> None:
    """Refuse a file with an array of anything but real numbers, or texts; FileFormatError."""
    for name, value in arrays.items():
        if value.dtype.kind not in ("U" if name in TEXTS else "biuf"):
            raise FileFormatError(
                f"{Path(path).name!r} is damaged: array {name!r} holds {value.dtype}, not real "
                "numbers"
            )


@contextmanager
def damage_of(path: str | Path) -> Iterator[None]:
    """What a value of another type or size raises where a model is made of a file's entries."""
    try:
        yield
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise FileFormatError(f"{Path(path).name!r} is damaged: {error}") from error


def card_from(table: dict[str, Any] | None) -> Card | None:
    """A card from its table."""
    if table is None:
        return None
    tuples = {k: tuple(table.get(k, ())) for k in ("runs", "warnings")}
    growth = table.get("growth")
    if growth is not None:
        rate, bound = growth
        tuples["growth"] = (float(rate), float(bound))
    return Card(**(table | tuples))


BlockRow = tuple[str, list[int], str, str, str]  # of a Block; JSON makes it a list


def layout_table(layout: Layout | None) -> list[BlockRow] | None:
    """A layout as plain values."""
    if layout is None:
        return None
    return [(b.name, list(b.shape), b.unit, b.role, b.kind) for b in layout]


def layout_from(table: list[BlockRow] | None) -> Layout | None:
    """A layout from plain values."""
    if table is None:
        return None
    return Layout([Block(n, tuple(s), u, role=r, kind=k) for n, s, u, r, k in table])
