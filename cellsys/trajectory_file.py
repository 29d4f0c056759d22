"""What a file says of a run: its arrays by name, and blocks, events and provenance as JSON."""

from __future__ import annotations

import platform
from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp

from cellsys.errors import CellsysError, FileFormatError
from cellsys.system import Block, Event, Layout
from cellsys.version import __version__

KIND, SCHEMA = "run", 1
STATES = ("t", "x", "p", "d", "amplitude")  # what is kept without the loads
LOADS = ("eta", "u", "eta_start", "virial", "stiffness")
_MATRICES = ("W_x", "W_eta")


def layout_table(layout: Layout) -> list[list[object]]:
    """[name, shape, unit, role, kind] of every block."""
    return [[b.name, list(b.shape), b.unit, b.role, b.kind] for b in layout]


def layout_of(table: object, what: str) -> Layout:
    """The layout that `layout_table` wrote.

    Raises
    ------
    FileFormatError
    """
    try:
        return Layout(
            [
                Block(str(name), tuple(int(n) for n in shape), str(unit), role=role, kind=kind)
                for name, shape, unit, role, kind in table  # type: ignore[attr-defined]
            ]
        )
    except (TypeError, ValueError, CellsysError) as error:
        raise FileFormatError(f"the names of {what} in this file are damaged: {error}") from error


def plain(value: object) -> object:
    """What JSON can hold of a value; of other objects their text."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    return value if value is None or isinstance(value, (bool, int, float, str)) else str(value)


def provenance(source: Mapping[str, object]) -> dict[str, object]:
    """What is known of a run's origin, and the program and platform that writes it now."""
    told = {str(k): plain(v) for k, v in source.items()}
    return {"cellsys": __version__, "platform": platform.platform(), **told}


def packed(fields: Mapping, loads: bool) -> tuple[dict[str, np.ndarray], dict[str, object]]:
    """Arrays and metadata of the fields of a run; without its loads only states and headings."""
    names = STATES + LOADS if loads else STATES
    arrays = {n: np.asarray(fields[n]) for n in names if fields[n] is not None}
    for name in _MATRICES if loads else ():
        if fields[name] is not None:
            matrix = sp.csr_array(fields[name])
            arrays |= {f"{name}.{part}": getattr(matrix, part) for part in _PARTS}
            arrays[f"{name}.shape"] = np.array(matrix.shape)
    arrays |= {f"geometry.{k}": np.asarray(v) for k, v in fields["geometry"].items()}
    described: dict[str, object] = {
        "states": layout_table(fields["states"]),
        "auxiliaries": layout_table(fields["auxiliaries"] if loads else Layout()),
        "events": [list(e) for e in fields["events"]],
        "statistics": plain(fields["statistics"]),
        "label": fields["label"],
        "model_error": plain(fields["model_error"]),
        "source": provenance(fields["source"]),
    }
    return arrays, described


_PARTS = ("data", "indices", "indptr")


def unpacked(arrays: Mapping[str, np.ndarray], described: Mapping) -> dict:
    """The fields that `packed` was given.

    Raises
    ------
    FileFormatError
    """
    try:
        fields: dict = {n: arrays[n] for n in STATES + LOADS if n in arrays}
        for name in _MATRICES:
            if f"{name}.shape" in arrays:
                rows, columns = (int(n) for n in arrays[f"{name}.shape"])
                parts = tuple(arrays[f"{name}.{part}"] for part in _PARTS)
                fields[name] = sp.csr_array(parts, shape=(rows, columns))
        geometry = {
            k.removeprefix("geometry."): v
            for k, v in arrays.items()
            if k.startswith("geometry.")
        }  # fmt: skip
        # Files of version 0.2.0 say what happened but not when, and have no auxiliaries.
        events = tuple(
            Event(float("nan"), e, "") if isinstance(e, str) else Event(float(e[0]), *e[1:])
            for e in _rows(described["events"])
        )
        return {
            **fields,
            "states": layout_of(described["states"], "the states"),
            "auxiliaries": layout_of(described.get("auxiliaries", []), "the auxiliaries"),
            "events": events,
            "statistics": dict(described["statistics"]),
            "label": str(described["label"]),
            "model_error": dict(described.get("model_error", {})),
            "source": dict(described.get("source", {})),
            "geometry": geometry,
        }
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"this file of a run is damaged: {error}") from error


def _rows(value: object) -> list:
    if not isinstance(value, list):
        raise FileFormatError("this file of a run has no list of events")
    return value
