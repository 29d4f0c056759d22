"""npz archives with a kind, a schema version and JSON metadata; never pickle."""

from __future__ import annotations

import json
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cellsys.errors import FileFormatError
from cellsys.store.atomic import atomic_path

_HEADER = "cellsys"
# What numpy's reader raises on truncated, damaged or foreign files.
READ_ERRORS = (
    ValueError,
    OSError,
    EOFError,
    KeyError,
    SyntaxError,
    MemoryError,
    NotImplementedError,
    tokenize.TokenError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)


def save_archive(
    path: str | Path,
    kind: str,
    version: int,
    arrays: Mapping[str, np.ndarray],
    metadata: Mapping[str, Any],
) -> Path:
    """Write arrays and JSON metadata as one npz, atomically.

    Parameters
    ----------
    path : path
        Target; ``.npz`` is appended when missing.
    kind, version : str, int
        What the file holds, and the version of that schema; checked when loading.
    arrays : mapping of str to array
        Numeric arrays; object arrays are refused.
    metadata : mapping
        Anything JSON can hold.
    """
    target = Path(path)
    if target.suffix != ".npz":
        target = target.with_name(target.name + ".npz")
    for name, value in arrays.items():
        if np.asarray(value).dtype.hasobject:
            raise FileFormatError(f"array {name!r} holds objects; only numbers can be stored")
    header = json.dumps({"kind": kind, "version": version, "metadata": dict(metadata)})
    with atomic_path(target) as temporary, temporary.open("wb") as file:
        np.savez(file, **{_HEADER: np.array(header)}, **dict(arrays))
    return target


def load_archive(
    path: str | Path, kind: str, version: int
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read back what `save_archive` wrote.

    Raises
    ------
    FileNotFoundError
        When there is no such file.
    FileFormatError
        When the file is truncated, not ours, of another kind or of a newer schema.
    """
    source = Path(path)
    if not source.exists():
        raise FileNotFoundError(f"no file {str(source)!r}")
    try:
        # Opened here: np.load leaves the file open when it is not a zip archive after all.
        with source.open("rb") as file:
            archive = np.load(file, allow_pickle=False)
            if not hasattr(archive, "files") or _HEADER not in archive.files:
                raise FileFormatError(
                    f"{source.name!r} was not written by cellsys: it has no {_HEADER!r} header"
                )
            with archive:
                header = json.loads(str(archive[_HEADER]))
                arrays = {name: archive[name] for name in archive.files if name != _HEADER}
    except FileFormatError:
        raise
    except READ_ERRORS as error:
        raise FileFormatError(f"{source.name!r} is truncated or not a cellsys file: {error}") from (
            error
        )
    if not isinstance(header, dict) or header.get("kind") != kind:
        found = header.get("kind") if isinstance(header, dict) else header
        raise FileFormatError(f"{source.name!r} holds a {found!r}, expected a {kind!r}")
    if header.get("version") != version:
        raise FileFormatError(
            f"{source.name!r} has {kind} schema {header.get('version')!r}, this cellsys reads "
            f"{version}; write it again with this version"
        )
    return arrays, header["metadata"]
