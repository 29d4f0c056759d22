"""What every command shares: the typer application, options, progress, tables, errors."""

from __future__ import annotations

import json
import os
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cellsys.cli.ending import say_ending
from cellsys.cli.output import note, say, show
from cellsys.printable import printable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rich.progress import TaskID


_NUMBER = 16  # signs, at most, of what is set as a number
_WIDE = 160


class CommandGroup(typer.core.TyperGroup):
    """A signal to end, in any command, is one line and the exit code of the signal."""

    def invoke(self, ctx: Any) -> object:
        """Run the command; see the class."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            sys.exit(say_ending(stop, "finished runs are kept"))


app = typer.Typer(
    cls=CommandGroup,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="A cell on its matrix as a control system.",
)

Json = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print no progress.")]
ModelFile = Annotated[Path, typer.Argument(help="A model written by cellsys (npz).")]
SceneFile = Annotated[Path, typer.Argument(help="A scene file (toml).")]


def say_error(error: Exception, code: int) -> int:
    """One line on standard error; gives the exit code back."""
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.strerror}: {error.filename!r}" if error.filename else error.strerror
    say(text)
    return code


@contextmanager
def progress_bars(quiet: bool) -> Iterator[Callable[[str, float], None]]:
    """A callback (stage, share): rich bars with the time left on a terminal, in a log a line a
    minute.
    """
    if quiet:
        yield lambda stage, share: None
        return
    if not sys.stderr.isatty():
        yield _a_line_a_minute(time.monotonic)
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    name = TextColumn("{task.description:16s}", markup=False)
    columns = (name, BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks: dict[str, TaskID] = {}

        def progress(stage: str, share: float) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(printable(stage), total=1.0)
            bars.update(tasks[stage], completed=share)

        yield progress


def _a_line_a_minute(clock: Callable[[], float]) -> Callable[[str, float], None]:
    """A callback (stage, share) that writes where things stand, at most once in 60 s."""
    last = clock()
    began: dict[str, float] = {}

    def progress(stage: str, share: float) -> None:
        nonlocal last
        now = clock()
        start = began.setdefault(stage, now)
        if now - last < 60.0:
            return
        last = now
        left = (now - start) * (1.0 - share) / share if share > 0 else float("inf")
        rest = f", about {left:.0f} s left" if left < float("inf") else ""
        note(f"{stage}: {100 * share:.0f} %{rest}")

    return progress


def print_table(title: str, head: list[str], rows: list[list[str]]) -> None:
    """A rich table on standard output: numbers to the right, texts to the left, nothing cut."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    def plain(text: str) -> Text:
        return Text(printable(text))  # rich reads markup in a str

    table = Table(title=plain(title), title_justify="left")
    for k, name in enumerate(head):
        number = k > 0 and all(len(row[k]) <= _NUMBER for row in rows)
        justify: Literal["left", "right"] = "right" if number else "left"
        table.add_column(plain(name), justify=justify, overflow="fold")
    for row in rows:
        table.add_row(*map(plain, row))
    if sys.stdout.isatty() or "COLUMNS" in os.environ:
        Console().print(table)
    else:  # a file or a pipe has no width of its own
        Console(width=_WIDE).print(table)


def dump(value: object) -> None:
    """JSON on standard output; NaN and inf as strings."""
    from cellsys.study.files import plain

    show(json.dumps(plain(value), indent=2, allow_nan=False))
