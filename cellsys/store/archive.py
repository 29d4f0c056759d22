"""npz archives with a kind, a schema version and JSON metadata; never pickle."""

from __future__ import annotations

import json
import struct
import tokenize
import zipfile
import zlib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from cellsys.arguments import checked
from cellsys.errors import FileFormatError, ParameterError
from cellsys.kinds import Takes, shown
from cellsys.store.atomic import atomic_path
from cellsys.store.regular import open_regular

_HEADER = "cellsys"
# What numpy's reader raises on truncated, damaged or foreign files.
READ_ERRORS = (
    ValueError,
    OSError,
    EOFError,
    KeyError,
    SyntaxError,
    MemoryError,
    OverflowError,
    RuntimeError,  # encrypted entries; packed in an unknown way; nested without end
    tokenize.TokenError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)
# Deflate packs zeros a thousandfold: a small file must not ask for all of memory. Arrays of
# measured numbers shrink less than tenfold.
_MOST_GROWTH, _SMALL = 50, 1e8


@checked
def save_archive(
    path: str | Path,
    kind: str,
    version: int,
    arrays: Annotated[Mapping[str, np.ndarray], Takes(Mapping[str, object])],
    metadata: Mapping[str, object],
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
    if not isinstance(path, (str, Path)) or not Path(path).name or "\0" in str(path):
        raise ParameterError(f"path must name a file such as 'm.npz', got {path!r}")
    target = Path(path)
    if target.suffix != ".npz":
        target = target.with_name(target.name + ".npz")
    for name, value in arrays.items():
        if np.asarray(value).dtype.hasobject:
            raise FileFormatError(f"array {name!r} holds objects; only numbers can be stored")
    header = json.dumps({"kind": kind, "version": version, "metadata": dict(metadata)})
    with atomic_path(target) as temporary, temporary.open("wb") as file:
        # An array called allow_pickle would be taken for numpy's option.
        stored: dict[str, Any] = {_HEADER: np.array(header), **arrays}
        np.savez(file, **stored)
    return target


def check_members(archive: np.lib.npyio.NpzFile, source: Path) -> None:
    """Refuse an archive before it is unpacked: with two entries of one name, or far larger inside.

    Raises
    ------
    FileFormatError
    """
    if archive.zip is None:
        raise FileFormatError(f"{source.name!r} is closed; open it again")
    entries = archive.zip.infolist()
    names = Counter(i.filename.removesuffix(".npy") for i in entries)
    if twice := [name for name, times in names.items() if times > 1]:
        raise FileFormatError(
            f"{source.name!r} holds {shown(twice[0])} twice; save its arrays again with numpy.savez"
        )
    size, packed = sum(i.file_size for i in entries), source.stat().st_size
    if size > max(_SMALL, _MOST_GROWTH * packed):
        raise FileFormatError(
            f"{source.name!r} has {packed / 1e6:.3g} MB and says it unpacks to {size / 1e6:.3g} "
            f"MB, more than {_MOST_GROWTH} times as much; save its arrays again with numpy.savez"
        )


def archive_kind(path: str | Path) -> str:
    """What a file written by `save_archive` holds; errors as of `load_archive`."""
    return str(_read(Path(path), arrays=False)[1].get("kind"))


@checked
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
    arrays, header = _read(source)
    if header.get("kind") != kind:
        found = header.get("kind")
        raise FileFormatError(f"{source.name!r} holds a {found!r}, expected a {kind!r}")
    if header.get("version") != version:
        raise FileFormatError(
            f"{source.name!r} has {kind} schema {header.get('version')!r}, this cellsys reads "
            f"{version}; write it again with this version"
        )
    return arrays, header["metadata"]


def _read(source: Path, arrays: bool = True) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays (none unless asked for) and header of a file."""
    if not source.exists():
        raise FileNotFoundError(f"no file {str(source)!r}")
    names: dict[str, np.ndarray] = {}
    try:
        # Opened here: np.load leaves the file open when it is not a zip archive after all.
        with open_regular(source) as file:
            archive = np.load(file, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile) or _HEADER not in archive.files:
                raise FileFormatError(
                    f"{source.name!r} was not written by cellsys: it has no {_HEADER!r} header"
                )
            check_members(archive, source)
            with archive:
                header = json.loads(str(archive[_HEADER]))
                if arrays:
                    names = {name: archive[name] for name in archive.files if name != _HEADER}
    except FileFormatError:
        raise
    except READ_ERRORS as error:
        raise FileFormatError(f"{source.name!r} is truncated or not a cellsys file: {error}") from (
            error
        )
    if odd := [name for name, value in names.items() if not isinstance(value, np.ndarray)]:
        raise FileFormatError(f"{source.name!r} is damaged: entry {odd[0]!r} is no array")
    if isinstance(header, dict) and not isinstance(header.get("metadata"), dict):
        raise FileFormatError(f"{source.name!r} is damaged: its header has no table of metadata")
    if not isinstance(header, dict):
        raise FileFormatError(f"{source.name!r} has the header {header!r}, expected a mapping")
    return names, header
