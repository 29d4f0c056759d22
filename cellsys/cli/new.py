"""``cellsys new``: a commented scene to start from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cellsys.cli.console import app
from cellsys.cli.output import show


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="Of the scene; NAME.toml is written.")],
    kind: Annotated[
        str, typer.Option(help="cell, pair, ten, chain, passive or membrane.")
    ] = "cell",
) -> None:
    """Write a commented scene file to start from."""
    from cellsys.errors import ParameterError
    from cellsys.scene.outlines import outline
    from cellsys.store.atomic import write_text

    path = Path(name if name.endswith(".toml") else f"{name}.toml")
    text = outline(kind, path.stem)
    if path.exists():
        raise ParameterError(f"{str(path)!r} exists; give another name or remove it")
    write_text(path, text)
    show(f"written: {path}; run it with: cellsys run {path}")
