"""Meshes of other programs over time: VTK, VTU and PVD files, read by pyvista."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import DataError, FileFormatError, ParameterError
from cellsys.io.extras import extra
from cellsys.io.xml_events import read_elements
from cellsys.samples import RunData, Snapshots, snapshots
from cellsys.units import real_number

_ENDINGS = (".vtk", ".vtu", ".vtp", ".pvd")
_MOST_BYTES = 2e9  # of one file


@checked
def read_mesh_series(
    files: str | Path | Sequence[str | Path],
    *,
    dt: float | None = None,
    fields: Sequence[str] | None = None,
) -> Snapshots:
    """Snapshots of a series of meshes with the same points.

    Parameters
    ----------
    files : path or sequence of paths
        A ``.pvd`` file, which lists its files and times, or the files in order of time.
    dt : float, optional
        Interval, s; needed for a list of files, refused beside a ``.pvd`` of another interval.
    fields : sequence of str, optional
        Point arrays to take besides the places; default: all that every file has.

    Returns
    -------
    Snapshots
        Blocks ``position`` (points from the first file on) and one per field.

    Raises
    ------
    ParameterError
        Without pyvista (extra ``vtk``), or without the interval.
    FileFormatError, DataError
        A file of another kind or size, other points, a field that is missing, NaN.
    """
    pyvista = extra("pyvista", "vtk", "read_mesh_series")
    paths, times = _listed(files)
    if times is not None:
        steps = np.diff(times)
        if not len(steps) or np.ptp(steps) > 1e-6 * abs(steps[0]):
            raise DataError("the times of a .pvd file must be at equal steps, three at least")
        if dt is not None and abs(dt - steps[0]) > 1e-6 * abs(steps[0]):
            raise ParameterError(f"dt = {dt!r}, but the .pvd file has steps of {steps[0]:.9g}")
        dt = float(steps[0])
    if dt is None:
        raise ParameterError("dt is missing: give the interval between the files in s")
    if not real_number(dt, "dt") > 0:
        raise ParameterError(f"dt must be > 0 s, got {dt!r}")
    rows: list[np.ndarray] = []
    names: list[str] = []
    shapes: dict[str, tuple[int, ...]] = {}
    for path in paths:
        if not path.exists():
            raise FileNotFoundError(f"no file {str(path)!r}")
        if path.stat().st_size > _MOST_BYTES:
            raise FileFormatError(f"{path.name} has more than {_MOST_BYTES / 1e9:g} GB")
        mesh = pyvista.read(path)
        arrays = {str(k): np.asarray(mesh.point_data[k], dtype=float) for k in mesh.point_data}
        found = {"position": np.asarray(mesh.points, dtype=float), **arrays}
        if not names:
            names = ["position", *(sorted(arrays) if fields is None else fields)]
            shapes = {n: found[n].shape for n in names if n in found}
        for name in names:
            if name not in found or found[name].shape != shapes.get(name, ()):
                raise FileFormatError(
                    f"{path.name} lacks the point array {name!r}, or has it for other points than "
                    f"{paths[0].name}; the arrays are {', '.join(arrays) or 'none'}"
                )
        rows.append(np.concatenate([found[n].ravel() for n in names]))
    blocks, start = {}, 0
    for name in names:
        size = int(np.prod(shapes[name]))
        blocks[name] = range(start, start + size)
        start += size
    return snapshots([RunData(x=np.array(rows), label=paths[0].stem)], dt=dt, blocks=blocks)


def _listed(
    files: str | Path | Sequence[str | Path],
) -> tuple[list[Path], np.ndarray | None]:
    one = isinstance(files, (str, Path))
    paths = [Path(files)] if isinstance(files, (str, Path)) else [Path(f) for f in files]
    for path in paths:
        if path.suffix.lower() not in _ENDINGS:
            raise FileFormatError(f"{path.name}: meshes are read from {', '.join(_ENDINGS)}")
    if not (one and paths[0].suffix.lower() == ".pvd"):
        if len(paths) < 3:
            raise DataError(f"{len(paths)} files; a series needs at least three")
        return paths, None
    listed: list[tuple[float, str, str]] = []

    def element(tag: str, a: object) -> None:
        if tag == "DataSet" and isinstance(a, dict):
            try:
                listed.append((float(a["timestep"]), str(a["file"]), str(a.get("part", "0"))))
            except (KeyError, ValueError) as error:
                raise FileFormatError(f"{paths[0].name}: a data set without {error}") from error

    read_elements(paths[0], element)
    first = [row for row in listed if row[2] == listed[0][2]]
    base = paths[0].parent
    for _, name, _ in first:
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise FileFormatError(f"{paths[0].name} names {name!r}, outside its folder")
    return [base / name for _, name, _ in first], np.array([t for t, _, _ in first])
