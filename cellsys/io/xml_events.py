"""XML read as a stream of its elements, without entities and without anything from outside."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from xml.parsers import expat

from cellsys.errors import FileFormatError
from cellsys.store.regular import open_regular

_PIECE = 1 << 20
MOST_BYTES = 1e9


def read_elements(
    path: Path,
    start: Callable[[str, Mapping[str, str]], None],
    end: Callable[[str, str], None] | None = None,
) -> None:
    """Call ``start(tag, attributes)`` and ``end(tag, text)`` for every element of a file.

    Raises
    ------
    FileFormatError
        No XML; a document type, which may hold entities that grow without end or name files and
        addresses outside; more than 1 GB.
    """
    parser = expat.ParserCreate()
    parser.buffer_text = True
    texts: list[str] = []

    def refuse(*_: object) -> None:
        raise FileFormatError(
            f"{path.name}, line {parser.CurrentLineNumber}: a document type or entity, which "
            "cellsys does not read; remove the <!DOCTYPE ...> from the file"
        )

    def opened(tag: str, attributes: dict[str, str]) -> None:
        texts.clear()
        start(tag, attributes)

    def closed(tag: str) -> None:
        if end is not None:
            end(tag, "".join(texts))
        texts.clear()

    parser.StartElementHandler, parser.EndElementHandler = opened, closed
    if end is not None:
        parser.CharacterDataHandler = texts.append
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.ExternalEntityRefHandler = refuse  # type: ignore[assignment]
    try:
        with open_regular(path, MOST_BYTES) as file:
            while piece := file.read(_PIECE):
                parser.Parse(piece, False)
            parser.Parse(b"", True)
    except expat.ExpatError as error:
        raise FileFormatError(
            f"{path.name}, line {error.lineno}, column {error.offset + 1}: no XML: {error}"
        ) from error
