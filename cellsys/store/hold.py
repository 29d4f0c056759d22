"""The right to write one run: a lock that its holder's death opens, and a lease it must renew.

The system drops the lock when the holding process dies, however it dies. A holder that is alive
and cut off (stopped, or on a machine that no longer reaches the folder) keeps its lock, but not
its lease: whoever waits for the run then takes the folder over, and goes on with a copy from the
last checkpoint. What the old holder still writes goes into files that nobody reads, and it is told
at its next write. Of two writers in one process the later one takes over in the same way.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import threading
import time
import uuid
import weakref
from pathlib import Path

from cellsys.errors import LostRunError, ParameterError
from cellsys.store.atomic import write_json

try:
    import fcntl
except ImportError:  # a system without POSIX locks: the lease alone tells two writers apart
    fcntl = None  # type: ignore[assignment]

LOCK, LEASE, CLAIM = "lock", "lease.json", "claim"
OWN = frozenset({LOCK, LEASE, CLAIM})

LONGEST = 120.0  # s without a sign of life: the longest that one factorisation may take
BEAT = 10.0  # s between two signs of life
PATIENCE = 1.5  # s: workers of a process that was killed are gone after one
_PROCESS = uuid.uuid4().hex  # a number of a process is used again, in containers soon


class Hold:
    """The lock and the lease of the folder of a partial run, taken when made.

    Parameters
    ----------
    partial : path
        Folder; made when missing.
    patience : float
        Seconds to wait for a holder to finish, die or be cut off.

    Raises
    ------
    ParameterError
        When another process holds it.
    """

    def __init__(self, partial: Path, patience: float | None = None) -> None:
        self.partial = partial
        until = time.monotonic() + (PATIENCE if patience is None else patience)
        while (descriptor := _attempt(partial)) is None:
            if time.monotonic() >= until:
                raise ParameterError(
                    f"run {partial.stem!r} is being written by another process"
                    f"{_whose(partial)} into {str(partial.parent)!r}; wait for it, or give "
                    "another output folder"
                )
            time.sleep(0.05)
        self._descriptor = descriptor
        stop = threading.Event()
        threading.Thread(
            target=_beat, args=(partial / LEASE, stop), name="cellsys lease", daemon=True
        ).start()
        # Let go of when the writer is done, dropped, or its process ends.
        self._release = weakref.finalize(self, _let_go, partial, descriptor, stop, os.getpid())

    def check(self) -> None:
        """Refuse to go on where the folder is no longer the holder's.

        Raises
        ------
        LostRunError
        """
        if _same(self._descriptor, self.partial / LOCK):
            return
        if (self.partial / LOCK).exists():
            raise LostRunError(
                f"run {self.partial.stem!r} was taken over by another writer"
                f"{_whose(self.partial)}: a later one of this process, or one that saw no sign of "
                f"life of this for {LONGEST:g} s; what it finds will be in "
                f"{str(self.partial.parent)!r}"
            )
        raise LostRunError(
            f"the folder {str(self.partial)!r} was removed while its run was written; run the "
            "scene again"
        )

    def rename(self, folder: Path) -> None:
        """Give the folder its final name, and let go of it.

        Raises
        ------
        LostRunError
            When it was removed or taken over.
        """
        claim = _claim(self.partial)
        try:
            self.check()
            if folder.is_dir() and not folder.is_symlink():
                shutil.rmtree(folder)
            else:
                folder.unlink(missing_ok=True)
            os.replace(self.partial, folder)
        finally:
            if claim is not None:
                os.close(claim)
        self.release()
        for name in OWN:
            (folder / name).unlink(missing_ok=True)

    def release(self) -> None:
        """Let go of the folder."""
        self._release()


def _let_go(partial: Path, descriptor: int, stop: threading.Event, pid: int) -> None:
    stop.set()
    if os.getpid() == pid and _same(descriptor, partial / LOCK):
        (partial / LEASE).unlink(missing_ok=True)
    os.close(descriptor)


def _beat(lease: Path, stop: threading.Event) -> None:
    while not stop.wait(BEAT):
        try:
            os.utime(lease)
        except OSError:
            return  # removed, or out of reach: `check` says so


def _same(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except OSError:
        return False


def _attempt(partial: Path) -> int | None:
    """Descriptor of the locked lock file; None where somebody else holds it."""
    partial.mkdir(parents=True, exist_ok=True)
    if _ours(partial):
        # An earlier writer of this process, interrupted and perhaps kept alive by a traceback.
        # (Its lock would not keep us out, and a second descriptor of it would open it.)
        _take_over(partial)
    descriptor = -1
    try:
        descriptor = os.open(partial / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
        if _locked(descriptor) is None and (age := _age(partial)) < float("inf"):
            os.close(descriptor)
            if age >= LONGEST:
                _take_over(partial)
            return None
        # Another process may have finished, and renamed the folder, in between.
        if not _same(descriptor, partial / LOCK):
            os.close(descriptor)
            return None
        write_json(partial / LEASE, {"process": _PROCESS, "pid": os.getpid(), "host": _host()})
    except OSError as error:
        if descriptor >= 0:
            os.close(descriptor)
        if isinstance(error, FileNotFoundError):
            return None
        if error.errno not in (errno.EACCES, errno.EAGAIN):
            raise
        # Between lock and lease, and in runs of older versions, there is no lease.
        if LONGEST <= _age(partial) < float("inf"):
            _take_over(partial)
        return None
    return descriptor


def _locked(descriptor: int) -> bool | None:
    """Lock an open file; None where system or disk know no locks, and the lease has to do.

    Raises
    ------
    OSError
        EACCES or EAGAIN when another process has it locked.
    """
    if fcntl is None:
        return None
    try:
        fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP):
            return None
        raise
    return True


def _host() -> str:
    return os.uname().nodename if hasattr(os, "uname") else os.environ.get("COMPUTERNAME", "")


def _lease(partial: Path) -> dict[str, object]:
    try:
        found = json.loads((partial / LEASE).read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _ours(partial: Path) -> bool:
    found = _lease(partial)
    return (found.get("process"), found.get("pid")) == (_PROCESS, os.getpid())


def _whose(partial: Path) -> str:
    found, age = _lease(partial), _age(partial)
    if not found or not 0 <= age < float("inf"):
        return ""
    return f" (number {found.get('pid')} on {found.get('host')}, last sign of life {age:.0f} s ago)"


def _age(partial: Path) -> float:
    """Seconds since the last sign of life, by the clock of the disk; inf without a lease.

    The file has the time of the machine that has the disk, which need not be ours.
    """
    probe = partial / f".now.{uuid.uuid4().hex}"
    try:
        last = os.stat(partial / LEASE).st_mtime
        probe.touch()
        return max(os.stat(probe).st_mtime - last, 0.0)
    except OSError:
        return float("inf") if not (partial / LEASE).exists() else 0.0
    finally:
        probe.unlink(missing_ok=True)


def _claim(partial: Path) -> int | None:
    """Lock for renaming the folder: whoever finishes or takes over keeps the other out."""
    if fcntl is None:
        return None
    try:
        descriptor = os.open(partial / CLAIM, os.O_RDWR | os.O_CREAT, 0o666)
        fcntl.lockf(descriptor, fcntl.LOCK_EX)
    except OSError:
        return None  # removed, which `check` says; or a disk without locks
    return descriptor


def _take_over(partial: Path) -> None:
    """Put a copy in place of a folder whose holder is cut off, or an earlier one of this process.

    The old files stay with the old holder: it has them mapped, and may wake up and write.
    """
    claim = _claim(partial)
    aside = partial.with_name(f"{partial.name}.{uuid.uuid4().hex[:8]}")
    fresh = aside.with_name(f"{aside.name}.copy")
    try:
        if claim is not None and not _same(claim, partial / CLAIM):
            return
        if not (_ours(partial) or LONGEST <= _age(partial) < float("inf")):
            return  # somebody else has it already
        os.replace(partial, aside)
    except FileNotFoundError:
        return
    finally:
        if claim is not None:
            os.close(claim)
    try:
        fresh.mkdir()
        for path in aside.iterdir():
            if path.is_file() and path.name not in OWN:
                shutil.copyfile(path, fresh / path.name)
        os.rename(fresh, partial)
    except OSError:
        # No room for a copy, or somebody began anew meanwhile: the run starts from its beginning.
        shutil.rmtree(fresh, ignore_errors=True)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
