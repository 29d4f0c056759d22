"""The cache of runs and models that studies of one user share: where it is, how large it may be.

Everything in it can be made again. It is found by `CELLSYS_CACHE`, else it is the user's cache
folder; runs are named by the fingerprint of their scene, so that the output folder of a study does
not matter.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from cellsys.arguments import checked
from cellsys.errors import ParameterError
from cellsys.store.hold import LEASE, LONGEST, Hold
from cellsys.store.memory import size_text

LIMIT = 4e9  # bytes that studies leave in the cache
MODELS = "models"


@checked
def cache_folder() -> Path:
    """`$CELLSYS_CACHE`, or ``cellsys`` in the user's cache folder."""
    own = os.environ.get("CELLSYS_CACHE")
    if own:
        return Path(own)
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or str(Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = str(Path.home() / "Library" / "Caches")
    else:
        base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "cellsys"


@dataclass(frozen=True, kw_only=True)
class CacheEntry:
    """A folder of the cache: a run, an interrupted run or what was learned from runs.

    Attributes
    ----------
    path : Path
    bytes : int
    used : float
        When it was last written or read by a study, s since 1970.
    """

    path: Path
    bytes: int
    used: float


@checked
def entries(folder: str | Path) -> list[CacheEntry]:
    """What a cache holds, the longest unused first. Anything that is not ours is left out."""
    found = []
    top = Path(folder)
    for place in (*_folders(top), *_folders(top / MODELS)):
        if place.name == MODELS or not _ours(place):
            continue
        try:
            size = sum(f.stat().st_size for f in place.iterdir() if f.is_file())
            found.append(CacheEntry(path=place, bytes=size, used=place.stat().st_mtime))
        except OSError:  # removed by somebody else meanwhile
            continue
    return sorted(found, key=lambda entry: entry.used)


def _folders(folder: Path) -> list[Path]:
    try:
        return [p for p in folder.iterdir() if p.is_dir() and not p.is_symlink()]
    except OSError:
        return []


def _ours(place: Path) -> bool:
    """Whether a folder is a run (finished or not) or what was learned from runs."""
    learned = place.parent.name == MODELS and not any(f.suffix != ".npz" for f in place.iterdir())
    return learned or place.suffix == ".partial" or (place / "run.json").is_file()


def touch(places: Collection[Path]) -> None:
    """Note that these entries were used now."""
    for place in places:
        try:
            os.utime(place)
        except OSError:  # on a disk that is only read, nothing is removed either
            continue


@checked
def prune(
    folder: str | Path, limit: float = LIMIT, keep: Collection[Path] = ()
) -> list[CacheEntry]:
    """Remove the longest unused entries until the rest is within `limit` bytes.

    Runs that are being written are left alone, and so are those in `keep`. What another process
    has open stays readable to it.

    Returns
    -------
    list of CacheEntry
        What was removed.

    Raises
    ------
    ParameterError
        For a limit below 0.
    """
    if not limit >= 0:
        raise ParameterError(f"limit must be >= 0 bytes, got {limit!r}")
    known = entries(folder)
    total, removed = sum(entry.bytes for entry in known), []
    spared = {Path(p).resolve() for p in keep}
    for entry in known:
        if total <= limit:
            break
        if entry.path.resolve() in spared or not _removed(entry.path):
            continue
        total -= entry.bytes
        removed.append(entry)
    return removed


def _sign_of_life(partial: Path) -> float:
    """When the holder of a partial run last said that it lives, s since 1970."""
    try:
        return (partial / LEASE).stat().st_mtime
    except FileNotFoundError:
        return 0.0


def _removed(path: Path) -> bool:
    """Remove an entry; False where it is in use or cannot be removed."""
    try:
        if path.suffix != ".partial":
            shutil.rmtree(path)
            return True
        if time.time() - _sign_of_life(path) < LONGEST:
            return False  # also of this process, whose later writers take a folder over
        hold = Hold(path, patience=0.0)
    except (OSError, ParameterError):
        return False
    try:
        shutil.rmtree(path)
    except OSError:
        return False
    finally:
        hold.release()
    return True


def told(folder: Path, known: Collection[CacheEntry]) -> str:
    """A cache in one line."""
    total = size_text(sum(entry.bytes for entry in known))
    count = f"{len(known)} entr{'y' if len(known) == 1 else 'ies'}"
    return f"{folder}: {count}, {total} (studies keep at most {size_text(LIMIT)})"
