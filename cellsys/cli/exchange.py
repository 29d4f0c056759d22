"""Commands for other programs' data: export, import, observe."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cellsys.cli.console import Json, app, dump
from cellsys.cli.output import show

if TYPE_CHECKING:
    from cellsys.contours import CellOutlines
    from cellsys.tracks import Tracks
    from cellsys.trajectory import Trajectory

_RUN = typer.Argument(help="A run folder, an output folder of `cellsys run`, or a run's npz.")
_PIXEL = typer.Option("--pixel-size", help="um per px, where the file counts pixels.")
_INTERVAL = typer.Option("--frame-interval", help="s per frame, where the file counts frames.")


@app.command("export")
def export_run(
    run: Annotated[Path, _RUN],
    to: Annotated[str, typer.Option("--to", help="vtk, netcdf, csv, recorded or movie.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="File or folder to write.")
    ] = None,
) -> None:
    """Write a run for other programs: ParaView, NetCDF, a table of read-outs, recorded files."""
    from cellsys.errors import ParameterError
    from cellsys.figures import write_movie
    from cellsys.io import read_run, to_xarray, write_recorded, write_vtk
    from cellsys.observe import observe

    endings = {"vtk": "-vtk", "netcdf": ".nc", "csv": ".csv", "recorded": "-recorded",
               "movie": ".gif"}  # fmt: skip
    if to not in endings:
        raise ParameterError(f"--to must be one of {', '.join(endings)}, got {to!r}")
    loaded = read_run(run)
    target = Path(run.stem + endings[to]) if out is None else out
    if to == "vtk":
        target = write_vtk(loaded, target)
    elif to == "netcdf":
        to_xarray(loaded).to_netcdf(target, engine="scipy")
    elif to == "csv":
        target = observe(loaded).to_csv(target)
    elif to == "recorded":
        target = write_recorded(loaded, target)
    else:
        target = write_movie(loaded, target)
    show(f"written: {target}")


@app.command("import")
def import_data(
    path: Annotated[Path, typer.Argument(help="A file or folder of another program.")],
    kind: Annotated[
        str, typer.Option("--as", help="recorded, tracks, physicell or masks.")
    ] = "tracks",
    out: Annotated[Path | None, typer.Option("-o", "--out", help="File to write.")] = None,
    pixel_size: Annotated[float | None, _PIXEL] = None,
    frame_interval: Annotated[float | None, _INTERVAL] = None,
) -> None:
    """Read data of another program and keep them in a form of this one.

    Recorded runs become a run (npz), tracks and PhysiCell cells a table of spots (csv), masks
    their contours (geojson).
    """
    from cellsys.errors import ParameterError
    from cellsys.io import (
        read_masks,
        read_physicell,
        read_tracks,
        recorded_run,
        write_outlines,
        write_tracks,
    )

    kinds = ("recorded", "tracks", "physicell", "masks")
    if kind not in kinds:
        raise ParameterError(f"--as must be one of {', '.join(kinds)}, got {kind!r}")
    scaled = pixel_size is not None or frame_interval is not None
    if kind in ("recorded", "physicell") and scaled:
        raise ParameterError(f"--pixel-size, --frame-interval: {kind} has units of its own")
    found: Trajectory | Tracks | CellOutlines
    if kind == "recorded":
        found = recorded_run(path)
        target = found.save(Path(f"{path.stem}.npz") if out is None else out)
    elif kind == "masks":
        found = read_masks(path, pixel_size=pixel_size, frame_interval=frame_interval)
        target = write_outlines(found, Path(f"{path.stem}-cells.geojson") if out is None else out)
    else:
        if kind == "physicell":
            found = read_physicell(path)
        else:
            found = read_tracks(path, pixel_size=pixel_size, frame_interval=frame_interval)
        target = write_tracks(found, Path(f"{path.stem}-tracks.csv") if out is None else out)
    show(found)
    show(f"written: {target}")


@app.command("observe")
def observe_path(
    path: Annotated[Path, typer.Argument(help="A run, tracks, or masks.")],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="CSV of cells to write.")] = None,
    pairs: Annotated[Path | None, typer.Option(help="CSV of pairs to write.")] = None,
    pixel_size: Annotated[float | None, _PIXEL] = None,
    frame_interval: Annotated[float | None, _INTERVAL] = None,
    as_json: Json = False,
) -> None:
    """Read-outs per cell and time, and per pair, of a run, tracks or masks."""
    from cellsys.errors import ParameterError
    from cellsys.io import read_masks, read_run, read_tracks
    from cellsys.observe import observe

    kind = path.suffix.lower()
    is_run = kind == ".npz" or any((path / n).exists() for n in ("run.json", "run.npz"))
    found: Trajectory | Tracks | CellOutlines
    if is_run:
        if pixel_size is not None or frame_interval is not None:
            raise ParameterError("--pixel-size, --frame-interval: a run is in um and s already")
        found = read_run(path)
    elif kind in (".tif", ".tiff", ".npy", ".geojson"):
        found = read_masks(path, pixel_size=pixel_size, frame_interval=frame_interval)
    else:
        found = read_tracks(path, pixel_size=pixel_size, frame_interval=frame_interval)
    table = observe(found)
    for target, part in ((out, "cells"), (pairs, "pairs")):
        if target is not None:
            table.to_csv(target, part=part)
    if as_json:
        dump({"cells": dict(table.cells), "pairs": dict(table.pairs), "motion": dict(table.motion)})
        return
    show(table)
    for target in (out, pairs):
        if target is not None:
            show(f"written: {target}")
