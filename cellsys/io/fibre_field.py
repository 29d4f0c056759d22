"""Displacements and forces of a matrix from traction microscopy in fibres: results of saenopy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DimensionError, FileFormatError
from cellsys.shown import Shown
from cellsys.store.archive import READ_ERRORS, check_members
from cellsys.store.regular import open_regular
from cellsys.units import shaped_array


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class MeasuredFibreField(Shown):
    """A measured matrix: nodes at rest, their displacements and forces over time.

    Parameters
    ----------
    nodes : (N, 3)
        um.
    displacement : (T, N, 3)
        um; the first axis is the time step.
    force : (T, N, 3) or None
        pN.
    """

    nodes: np.ndarray
    displacement: np.ndarray
    force: np.ndarray | None = None

    def __post_init__(self) -> None:
        nodes = shaped_array(self.nodes, "nodes", (None, 3))
        object.__setattr__(self, "nodes", nodes)
        for name in ("displacement", "force"):
            if (value := getattr(self, name)) is not None:
                array = shaped_array(value, name, (None, len(nodes), 3))
                object.__setattr__(self, name, array)

    def __str__(self) -> str:
        size = np.linalg.norm(self.displacement, axis=2)
        return (
            f"MeasuredFibreField: {len(self.nodes)} nodes at {len(self.displacement)} times, "
            f"displaced by up to {size.max(initial=0.0):.3g} um, "
            f"{'with' if self.force is not None else 'no'} forces"
        )


@checked
def read_fibre_field(path: str | Path) -> MeasuredFibreField:
    """A ``.saenopy`` file, or an npz of the same names: metres and newtons in, um and pN out.

    Looked for are nodes (``R`` or ``nodes``, (N, 3)), displacements (``U`` or
    ``displacements``) and forces (``f`` or ``forces``), whatever stands before their names
    (``mesh_piv/0/``, ``solvers/0/mesh/``), one set per time step in the order of the numbers.

    Raises
    ------
    FileNotFoundError
    FileFormatError
        No npz file, pickled arrays (which are refused by name), or none of the names.
    DimensionError
        Time steps of different nodes.
    """
    source = Path(path)
    if not source.exists():
        raise FileNotFoundError(f"no file {str(source)!r}")
    arrays: dict[str, np.ndarray] = {}
    pickled: list[str] = []
    try:
        with open_regular(source) as file:
            archive = np.load(file, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise FileFormatError(f"{source.name} holds one array, not the named ones")
            check_members(archive, source)
            with archive:
                for name in archive.files:
                    if _role(name) is None:
                        continue
                    try:
                        arrays[name] = np.asarray(archive[name])
                    except ValueError:  # an array of objects
                        pickled.append(name)
    except FileFormatError:
        raise
    except READ_ERRORS as error:
        raise FileFormatError(f"{source.name} is no npz file that can be read: {error}") from error
    if pickled:
        raise FileFormatError(
            f"{source.name}: {', '.join(pickled[:4])} hold pickled objects, which can run any code "
            "when they are opened: never read; save plain arrays with numpy.savez"
        )
    sets: dict[str, list[np.ndarray]] = {"nodes": [], "displacement": [], "force": []}
    for name in sorted(arrays, key=_order):
        sets[str(_role(name))].append(arrays[name])
    if not sets["nodes"] or not sets["displacement"]:
        raise FileFormatError(
            f"{source.name} has no nodes (R) or no displacements (U) among {sorted(arrays)[:8]}"
        )
    nodes, displacement = sets["nodes"][0], _steps(sets["displacement"], "displacements")
    force = _steps(sets["force"], "forces") if sets["force"] else None
    if any(n.shape != nodes.shape or not np.allclose(n, nodes) for n in sets["nodes"]):
        raise DimensionError(f"{source.name}: the time steps have different nodes")
    return MeasuredFibreField(
        nodes=1e6 * nodes,
        displacement=1e6 * displacement,
        force=None if force is None else 1e12 * force,
    )


_ROLES = {"R": "nodes", "nodes": "nodes", "U": "displacement", "displacements": "displacement",
          "f": "force", "forces": "force"}  # fmt: skip


def _role(name: str) -> str | None:
    return _ROLES.get(name.replace(".", "/").rpartition("/")[2])


def _order(name: str) -> tuple[object, ...]:
    parts = name.replace(".", "/").split("/")
    return tuple((0, int(p), "") if p.isdigit() else (1, 0, p) for p in parts)


def _steps(found: list[np.ndarray], what: str) -> np.ndarray:
    if any(a.shape != found[0].shape for a in found):
        raise DimensionError(f"{what} of the time steps have different shapes")
    stacked = np.stack(found)
    return stacked[0] if stacked.ndim == 4 and len(stacked) == 1 else stacked
