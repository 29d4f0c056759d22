"""Readers and writers of other programs' files, one file per format."""

from cellsys.io.fibre_field import MeasuredFibreField, read_fibre_field
from cellsys.io.linking import link_spots
from cellsys.io.masks import read_masks
from cellsys.io.mesh_series import read_mesh_series
from cellsys.io.own_tables import write_outlines, write_tracks
from cellsys.io.physicell import read_physicell
from cellsys.io.recorded import read_recorded, recorded_run
from cellsys.io.recorded_write import write_recorded
from cellsys.io.render import RenderedMovie, render_movie
from cellsys.io.run_file import read_run
from cellsys.io.segment import segment_cells
from cellsys.io.tracks_file import read_tracks
from cellsys.io.vtk_write import write_vtk
from cellsys.io.xarray_form import to_xarray

__all__ = [
    "MeasuredFibreField",
    "RenderedMovie",
    "link_spots",
    "read_fibre_field",
    "read_masks",
    "read_mesh_series",
    "read_physicell",
    "read_recorded",
    "read_run",
    "read_tracks",
    "recorded_run",
    "render_movie",
    "segment_cells",
    "to_xarray",
    "write_outlines",
    "write_recorded",
    "write_tracks",
    "write_vtk",
]
