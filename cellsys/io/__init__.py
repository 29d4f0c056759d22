"""Readers and writers of other programs' files, one file per format."""

from cellsys.io.recorded import read_recorded, recorded_run
from cellsys.io.recorded_write import write_recorded
from cellsys.io.run_file import read_run

__all__ = ["read_recorded", "read_run", "recorded_run", "write_recorded"]
