"""``cellsys cache``: where runs are kept, how much of it, and how to clean it."""

from __future__ import annotations

from typing import Annotated

import typer

from cellsys.cli.console import Json, app, dump
from cellsys.cli.output import show


@app.command()
def cache(
    clear: Annotated[bool, typer.Option("--clear", help="Remove everything.")] = False,
    limit: Annotated[
        float | None, typer.Option(help="Remove the longest unused until so many MB are left.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Say where runs and models are cached, and clean up."""
    from cellsys.errors import ParameterError
    from cellsys.store.cache import cache_folder, entries, prune, told
    from cellsys.store.memory import size_text

    if clear and limit is not None:
        raise ParameterError("--clear leaves nothing; give it or --limit")
    if limit is not None and not 0 <= limit < float("inf"):
        raise ParameterError(f"--limit must be >= 0 MB, got {limit:g}")
    folder = cache_folder()
    removed = []
    if clear or limit is not None:
        removed = prune(folder, 0.0 if limit is None else 1e6 * limit)
    left = entries(folder)
    if as_json:
        dump(
            {
                "folder": str(folder),
                "entries": len(left),
                "bytes": sum(entry.bytes for entry in left),
                "removed": len(removed),
            }
        )
        return
    if removed:
        show(f"removed {len(removed)}, {size_text(sum(entry.bytes for entry in removed))}")
    show(told(folder, left))
