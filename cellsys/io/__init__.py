"""Readers and writers of other programs' files, one file per format."""

from cellsys.io.linking import link_spots
from cellsys.io.masks import read_masks
from cellsys.io.recorded import read_recorded, recorded_run
from cellsys.io.recorded_write import write_recorded
from cellsys.io.render import RenderedMovie, render_movie
from cellsys.io.run_file import read_run
from cellsys.io.segment import segment_cells
from cellsys.io.tracks_file import read_tracks

__all__ = [
    "RenderedMovie",
    "link_spots",
    "read_masks",
    "read_recorded",
    "read_run",
    "read_tracks",
    "recorded_run",
    "render_movie",
    "segment_cells",
    "write_recorded",
]
