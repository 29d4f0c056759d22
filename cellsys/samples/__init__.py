"""Samples of runs: snapshots gathered from runs, arrays and files; commands; provenance."""

from cellsys.samples.gather import snapshots
from cellsys.samples.snapshots import RunData, Snapshots

__all__ = ["RunData", "Snapshots", "snapshots"]
