"""A run as a series of VTK files that ParaView opens, without the VTK library."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DataError, ParameterError, UnknownNameError
from cellsys.store.atomic import atomic_path, write_text
from cellsys.system import Block
from cellsys.trajectory import Trajectory, cell_names

_TRIANGLE, _LINE, _VERTEX = 5, 3, 1
_TYPES = {"f": "Float32", "i": "Int32", "u": "UInt8"}


@checked
def write_vtk(
    run: Trajectory,
    folder: str | Path,
    *,
    fields: Sequence[str] | None = None,
    every: int = 1,
) -> Path:
    """Write a run as one ``run.pvd`` and a VTU file per sample and part, which ParaView opens.

    Parts are the membrane of each cell (triangles) and the matrix (fibres, where the run knows
    their ends, points otherwise) at their deformed places, um. Every block of the run with a value
    or vector per node is a field of its part under its own name: forces by effect (pN) over the
    interval after the sample, zero at the last one; ``displacement`` and ``velocity`` (um/s)
    besides.

    Parameters
    ----------
    run : Trajectory
    folder : path
        Where the files go; files of the same names are replaced.
    fields : sequence of str, optional
        Only these fields, by their names (``"displacement"``, ``"cell1.focal_adhesion"``);
        default: all. An empty one writes shapes alone.
    every : int
        Write every so many samples.

    Returns
    -------
    Path
        The ``.pvd`` file.

    Raises
    ------
    DataError
        A run without nodes in space.
    UnknownNameError
        A field that the run does not have; the message lists those it has.
    """
    if every < 1:
        raise ParameterError(f"every must be at least 1, got {every}")
    parts = _parts(run)
    if not parts:
        raise DataError("the run has neither a membrane nor a matrix with nodes in space")
    known = list(dict.fromkeys(name for part in parts for name in part.fields))
    for name in fields or ():
        if name not in known:
            raise UnknownNameError(f"no field {name!r}; there are {', '.join(known)}")
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    lines = []
    for k in range(0, len(run), every):
        for number, part in enumerate(parts):
            name = f"{part.name}_{k:05d}.vtu"
            chosen = [f for f in part.fields if fields is None or f in fields]
            part.write(out / name, run, k, chosen)
            lines.append(
                f'<DataSet timestep="{float(run.t[k])!r}" group="" part="{number}" '
                f"name={quoteattr(part.name)} file={quoteattr(name)}/>"
            )
    text = (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="1.0" '
        'byte_order="LittleEndian">\n<Collection>\n' + "\n".join(lines)
    )
    write_text(out / "run.pvd", f"{text}\n</Collection>\n</VTKFile>\n")
    return out / "run.pvd"


def _parts(run: Trajectory) -> list[_Part]:
    parts = []
    for name in cell_names(run.states):
        shape = run.states[f"{name}.position"].shape
        if len(shape) == 2 and shape[1] == 3:
            faces = run.geometry.get(f"{name}.triangles")
            cells = np.arange(shape[0])[:, None] if faces is None else np.asarray(faces)
            parts.append(_Part(run, name, f"{name}.position", None, cells))
    rest = run.geometry.get("matrix.rest")
    if rest is not None and "matrix.displacement" in run.states:
        ends = run.geometry.get("matrix.fibres")
        cells = np.arange(len(rest))[:, None] if ends is None else np.asarray(ends)
        parts.append(_Part(run, "matrix", "matrix.displacement", np.asarray(rest), cells))
    return parts


class _Part:
    """One mesh of a run: its places, its elements and the fields on its nodes."""

    def __init__(
        self, run: Trajectory, name: str, state: str, rest: np.ndarray | None, cells: np.ndarray
    ) -> None:
        self.name, self._state, self._rest, self._cells = name, state, rest, cells
        self._kind = {1: _VERTEX, 2: _LINE, 3: _TRIANGLE}[cells.shape[1]]
        n = run.states[state].shape[0]
        self._blocks: dict[str, tuple[str, Block]] = {}
        for where, layout in (("state", run.states), ("load", run.auxiliaries)):
            if where == "load" and run.eta is None:
                continue
            for block in layout:
                per_node = block.shape in ((n,), (n, 3), (n, 2))
                if block.name.startswith(f"{name}.") and block.name != state and per_node:
                    self._blocks[block.name] = (where, block)
        self.fields = ["displacement", "velocity", *self._blocks]

    def _places(self, run: Trajectory, k: int) -> np.ndarray:
        x = run.states.view(np.asarray(run.x[k]), self._state)
        return x if self._rest is None else self._rest + x

    def _field(self, run: Trajectory, k: int, name: str) -> np.ndarray:
        if name == "displacement":
            start = self._places(run, 0) if self._rest is None else self._rest
            return self._places(run, k) - start
        if name == "velocity":
            if k + 1 >= len(run):
                return np.zeros(run.states[self._state].shape)
            moved = self._places(run, k + 1) - self._places(run, k)
            return np.asarray(moved / (run.t[k + 1] - run.t[k]))
        where, block = self._blocks[name]
        if where == "state":
            return run.states.view(np.asarray(run.x[k]), name)
        if run.eta is None or k >= len(run.eta):
            return np.zeros(block.shape)
        return run.auxiliaries.view(np.asarray(run.eta[k]), name)

    def write(self, path: Path, run: Trajectory, k: int, fields: Sequence[str]) -> None:
        """One VTU file with its arrays appended in binary."""
        values = {name: self._field(run, k, name) for name in fields}
        cells = self._cells
        arrays: list[np.ndarray] = []

        def declared(name: str, array: np.ndarray) -> str:
            plain = np.ascontiguousarray(
                array, dtype={"f": "<f4", "i": "<i4", "u": "u1"}[array.dtype.kind]
            )
            offset = sum(4 + a.nbytes for a in arrays)
            arrays.append(plain)
            width = 1 if plain.ndim == 1 else plain.shape[1]
            return (
                f'<DataArray type="{_TYPES[plain.dtype.kind]}" Name={quoteattr(name)} '
                f'NumberOfComponents="{width}" format="appended" offset="{offset}"/>'
            )

        n, m = len(self._places(run, k)), len(cells)
        point_data = "".join(declared(name, _three(v)) for name, v in values.items())
        points = declared("Points", self._places(run, k))
        topology = (
            declared("connectivity", cells.ravel().astype(np.int32))
            + declared("offsets", cells.shape[1] * np.arange(1, m + 1, dtype=np.int32))
            + declared("types", np.full(m, self._kind, dtype=np.uint8))
        )
        head = (
            '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" '
            'byte_order="LittleEndian" header_type="UInt32">\n<UnstructuredGrid>'
            f"<FieldData>{_unit_notes(self._units(fields))}</FieldData>"
            f'<Piece NumberOfPoints="{n}" NumberOfCells="{m}">\n<PointData>{point_data}'
            f"</PointData>\n<Points>{points}</Points>\n<Cells>{topology}</Cells>\n</Piece>"
            '</UnstructuredGrid>\n<AppendedData encoding="raw">\n_'
        )
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            file.write(head.encode())
            for array in arrays:
                file.write(struct.pack("<I", array.nbytes))
                file.write(array.tobytes())
            file.write(b"\n</AppendedData>\n</VTKFile>\n")

    def _units(self, fields: Sequence[str]) -> Mapping[str, str]:
        known = {"displacement": "um", "velocity": "um/s"}
        return {f: known.get(f) or self._blocks[f][1].unit for f in fields}


def _unit_notes(units: Mapping[str, str]) -> str:
    """The unit of every field as a text of the file, named ``FIELD [unit]``."""
    notes = []
    for name, unit in units.items():
        letters = " ".join(str(b) for b in (*unit.encode(), 0))
        notes.append(
            f'<Array type="String" Name={quoteattr(name + " unit")} NumberOfTuples="1" '
            f'format="ascii">{letters}</Array>'
        )
    return "".join(notes)


def _three(values: np.ndarray) -> np.ndarray:
    """Vectors in the plane get a third component of zero, as ParaView's arrows need it."""
    array = np.asarray(values, dtype=float)
    if array.ndim == 2 and array.shape[1] == 2:
        return np.column_stack([array, np.zeros(len(array))])
    return array
