"""Runs that cellsys wrote: folders of the run cache, output folders of a study, ``.npz`` files."""

from __future__ import annotations

from pathlib import Path

from cellsys.arguments import checked
from cellsys.errors import FileFormatError
from cellsys.scene.ensemble import read_run as read_cached
from cellsys.trajectory import Trajectory


@checked
def read_run(path: str | Path) -> Trajectory:
    """A run that cellsys wrote, with the names and units of its blocks and its provenance.

    Parameters
    ----------
    path : path
        A run folder of the cache (``run.json`` and arrays, which stay on disk), a file written
        by `Trajectory.save`, or an output folder of `cs.study` (its ``run.npz``, which holds
        states and headings without the loads).

    Returns
    -------
    Trajectory
        `source` holds the scene, the file it was given as, version and platform.

    Raises
    ------
    FileNotFoundError
    FileFormatError
        When it holds no complete run, or a damaged one.
    """
    place = Path(path)
    if not place.exists():
        raise FileNotFoundError(f"no run {str(place)!r}")
    if not place.is_dir():
        return Trajectory.load(place)
    if (place / "run.json").exists():
        return read_cached(place)
    if (place / "run.npz").exists():
        return Trajectory.load(place / "run.npz")
    raise FileFormatError(
        f"{str(place)!r} holds neither run.json nor run.npz; give a run folder of the cache, an "
        "output folder of `cellsys run`, or a file written by Trajectory.save"
    )
