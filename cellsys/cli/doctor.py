"""``cellsys doctor``: versions, threads, memory, and what the extras would give."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys
from pathlib import Path

from cellsys.cli.console import Json, app, dump
from cellsys.cli.output import show
from cellsys.version import __version__

LIBRARIES = (
    "numpy", "scipy", "control", "casadi", "numba", "matplotlib", "pydantic", "rich", "typer",
    "lazy_loader", "threadpoolctl",
)  # fmt: skip
# extra: (distribution, what it gives)
EXTRAS = {
    "data": ("xarray", "runs as xarray data sets and pandas tables"),
    "tracks": ("geff", "tracks in the GEFF format"),
    "images": ("scikit-image", "TIFF masks and movies, cells found in them, polygons"),
    "vtk": ("pyvista", "meshes of other programs"),
    "slicot": ("slycot", "python-control's own H-infinity norms and balanced truncation"),
    "cluster": ("distributed", "runs on a dask cluster: cs.run_ensemble(..., executor=Client())"),
    "test": ("pytest", "the tests: python -m pytest -n 2 --dist loadfile"),
    "dev": ("ruff", "lint, types and the API pages"),
}


def version_of(name: str) -> str | None:
    """Version of an installed distribution; None where there is none."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


@app.command()
def doctor(as_json: Json = False) -> None:
    """Say what is installed, what the machine has, and what would help."""
    from threadpoolctl import threadpool_info

    from cellsys.store.memory import available_memory, size_text
    from cellsys.store.processor import processor_kind

    threads = sorted(
        {f"{i['internal_api']} {i['num_threads']}" for i in threadpool_info()}
    )  # after numpy and scipy were loaded by the two above
    free = available_memory()
    disk = os.statvfs(Path.cwd()) if hasattr(os, "statvfs") else None
    found = {
        "cellsys": __version__,
        "python": f"{platform.python_version()} on {sys.platform}",
        **{name: version_of(name) for name in LIBRARIES},
    }
    machine = {
        "processors": os.cpu_count() or 1,
        "kind": processor_kind(),
        "BLAS threads": ", ".join(threads)
        + " (one wherever small matrices are looped over, whatever is set)",
        "free memory": size_text(free),
        "free disk here": None if disk is None else size_text(disk.f_bavail * disk.f_frsize),
        "compiled code": str(compiled_cache()),
    }
    extras = {
        extra: {"installed": version_of(name), "gives": gives}
        for extra, (name, gives) in EXTRAS.items()
    }
    if as_json:
        dump({"versions": found, "machine": machine, "extras": extras})
        return
    for title, rows in (("versions", found), ("machine", machine)):
        show(f"{title}:")
        for name, value in rows.items():
            show(f"  {name:16s} {'MISSING: pip install cellsys again' if value is None else value}")
    show("extras:")
    for extra, row in extras.items():
        have = row["installed"] or f"not installed: pip install 'cellsys[{extra}]'"
        show(f"  {extra:16s} {have}; {row['gives']}")


def compiled_cache() -> Path:
    """Where numba keeps the machine code of the laws."""
    if own := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(own)
    from cellsys import mechanics

    return Path(mechanics.__file__).parent / "__pycache__"
