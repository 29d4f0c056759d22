"""What commands write: text without the control characters that files may hold."""

from __future__ import annotations

import sys

from cellsys.printable import printable


def show(value: object = "") -> None:
    """One or more lines on standard output."""
    print(printable(str(value)))


def note(value: object) -> None:
    """One or more lines on standard error, beside the result."""
    print(printable(str(value)), file=sys.stderr)


def say(text: str) -> None:
    """One line on standard error, if anybody still listens there."""
    try:
        print(f"cellsys: {printable(' '.join(text.split()))}", file=sys.stderr, flush=True)
    except (OSError, ValueError):
        return
