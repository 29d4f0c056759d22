"""Memory that can be had: of the machine, and under the limits of the shell and of cgroups.

Sources: proc(5) (meminfo, status, cgroup, mountinfo), getrlimit(2), and the kernel's
documentation of cgroups, "Memory" of version 2 and "Memory Resource Controller" of version 1.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from cellsys.arguments import checked
from cellsys.errors import MemoryBudgetError

try:
    import resource
except ImportError:  # a system without POSIX limits
    resource = None  # type: ignore[assignment]

_PROC = Path("/proc/self")
_MEMINFO = Path("/proc/meminfo")
_OVERCOMMIT = Path("/proc/sys/vm/overcommit_memory")
_NO_LIMIT = 2**60  # version 1 writes "unlimited" as the largest multiple of a page


class Room(NamedTuple):
    """Bytes that can still be had, and what bounds them."""

    bytes: float
    bound: str


_UNBOUND = Room(float("inf"), "nothing bounds it")


@checked
def size_text(amount: float) -> str:
    """Bytes in the unit that fits: ``950 kB``, ``12.3 MB``, ``1.5 GB``."""
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if amount >= 0.9995 * size:  # 999.6 kB is 1 MB
            return f"{amount / size:.1f} GB" if unit == "GB" else f"{amount / size:.3g} {unit}"
    return f"{amount:.0f} bytes"


@checked
def available_memory() -> float:
    """Bytes of memory that this process can still have without swapping.

    The least of what the machine has free, what ``ulimit -v`` and ``ulimit -d`` leave, and what
    the cgroups of this process leave; inf where the system says none of these.
    """
    return memory_room().bytes


def memory_room() -> Room:
    """`available_memory` with what bounds it."""
    return min((*_machine(), *_limits(), *cgroup_room()), default=_UNBOUND)


def mapping_room() -> Room:
    """Bytes of files that can still be mapped: what ``ulimit -v`` leaves."""
    return min((room for room in _limits() if room.bound == "ulimit -v"), default=_UNBOUND)


def address_room() -> Room:
    """Bytes that can still be asked for, touched or not.

    What ``ulimit -v`` leaves, and what the system promises at all: the whole machine, or by its
    strict rule the rest of its commit limit.
    """
    rooms = [mapping_room()]
    table = _sizes(_MEMINFO)
    try:
        rule = _OVERCOMMIT.read_text("ascii").strip()
    except OSError:
        rule = "1"
    if rule == "0" and "MemTotal" in table:
        rooms.append(Room(table["MemTotal"] + table.get("SwapTotal", 0.0), "all of this machine"))
    if rule == "2" and {"CommitLimit", "Committed_AS"} <= table.keys():
        left = max(table["CommitLimit"] - table["Committed_AS"], 0.0)
        rooms.append(Room(left, "commit limit of this machine"))
    return min(rooms)


@checked
def check_memory(need: float, what: str, cure: str, *, addresses: float = 0.0) -> None:
    """Refuse what needs more memory than can be had.

    Parameters
    ----------
    need : float
        Bytes that will be touched beyond what the process holds.
    what : str
        Subject and verb of the message, such as ``"a matrix of 9 nodes needs about"``.
    cure : str
        What to do about it.
    addresses : float
        Bytes that will be asked for, where that is more than will be touched.

    Raises
    ------
    MemoryBudgetError
    """
    room = memory_room()
    if need > room.bytes:
        raise MemoryBudgetError(
            f"{what} {size_text(need)} of memory and {size_text(room.bytes)} are free "
            f"({room.bound}); {cure}"
        )
    left = address_room()
    if addresses > left.bytes:
        raise MemoryBudgetError(
            f"{what} {size_text(addresses)} of addresses and {size_text(left.bytes)} are free "
            f"({left.bound}); {cure}"
        )


def resident() -> float:
    """Bytes of memory that this process holds now; 0 where the system does not say."""
    return _sizes(_PROC / "status").get("VmRSS", 0.0)


def _machine() -> Iterator[Room]:
    table = _sizes(_MEMINFO)
    if "MemAvailable" in table:
        yield Room(table["MemAvailable"], "memory of this machine")


def _sizes(path: Path) -> dict[str, float]:
    """Sizes by name, bytes, of a file of lines such as ``VmSize:  1234 kB``."""
    found: dict[str, float] = {}
    try:
        for line in path.read_text("utf-8", "replace").splitlines():
            name, _, value = line.partition(":")
            if value.endswith(" kB"):
                found[name] = 1024.0 * float(value.split()[0])
    except (OSError, ValueError):
        pass
    return found


def _limits() -> Iterator[Room]:
    """What the limits of this process leave."""
    if resource is None:
        return
    used: dict[str, float] | None = None
    for name, key, option in (("RLIMIT_AS", "VmSize", "-v"), ("RLIMIT_DATA", "VmData", "-d")):
        soft = resource.getrlimit(getattr(resource, name))[0]
        if soft == resource.RLIM_INFINITY:
            continue
        used = _sizes(_PROC / "status") if used is None else used
        # Without a number for what is in use, what is resident is the least that can be.
        in_use = used[key] if key in used else _peak()
        yield Room(max(soft - in_use, 0.0), f"ulimit {option}")


def _peak() -> float:
    """Largest resident memory so far, bytes."""
    found = float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return found if os.uname().sysname == "Darwin" else 1024.0 * found


def cgroup_room(process: Path = _PROC) -> list[Room]:
    """What every cgroup of this process leaves, its own and those it lies in; both versions.

    Pages of files that are not in use count as free: they are dropped when memory is asked for.

    Parameters
    ----------
    process : path
        Folder of the process with ``cgroup`` and ``mountinfo``.
    """
    try:
        groups = (process / "cgroup").read_text("utf-8").splitlines()
        mounts = (process / "mountinfo").read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return []
    found: list[Room] = []
    for mount in mounts:
        first, _, rest = mount.partition(" - ")
        fields, tail = first.split(), rest.split()
        if len(fields) < 5 or len(tail) < 3:
            continue
        root, point = (_plain(fields[k]) for k in (3, 4))
        for line in groups:
            number, controllers, path = (line.split(":", 2) + ["", ""])[:3]
            if tail[0] == "cgroup2" and number == "0" and controllers == "":
                found += _along(point, root, path, _version_2)
            elif (
                tail[0] == "cgroup"
                and "memory" in controllers.split(",")
                and "memory" in tail[2].split(",")
            ):
                found += _along(point, root, path, _version_1)
    return found


def _plain(path: str) -> str:
    """A path of mountinfo: blanks and the like are written as octal numbers."""
    return re.sub(r"\\([0-7]{3})", lambda m: chr(int(m[1], 8)), path)


def _along(
    point: str, root: str, path: str, read: Callable[[Path], tuple[float, float]]
) -> Iterator[Room]:
    """Rooms of the group `path` and of all it lies in, as far as they are mounted here.

    In a container the group is the mount itself, whatever path the host knows it by.
    """
    inside = path.removeprefix(root.rstrip("/")) if path.startswith(root) else ""
    top = Path(point)
    here = top.joinpath(*(p for p in inside.split("/") if p not in ("", "..", ".")))
    while True:
        if here.is_dir():
            limit, used = read(here)
            if limit < _NO_LIMIT:
                yield Room(max(limit - used, 0.0), "limit of the cgroup of this process")
        if here == top or top not in here.parents:
            return
        here = here.parent


def _version_2(group: Path) -> tuple[float, float]:
    """Limit and use, bytes. Beyond memory.high a process is stopped until others let go."""
    limit = min(_number(group / "memory.max"), _number(group / "memory.high"))
    used = _number(group / "memory.current") - _table(group).get("inactive_file", 0.0)
    return limit, used if used < _NO_LIMIT else 0.0


def _version_1(group: Path) -> tuple[float, float]:
    """Limit and use, bytes."""
    table = _table(group)
    limit = min(
        _number(group / "memory.limit_in_bytes"),
        table.get("hierarchical_memory_limit", float("inf")),
    )
    used = _number(group / "memory.usage_in_bytes") - table.get("total_inactive_file", 0.0)
    return limit, used if used < _NO_LIMIT else 0.0


def _number(path: Path) -> float:
    """Bytes in a file; inf where there is no limit or no file."""
    try:
        text = path.read_text("ascii").strip()
        return float("inf") if text == "max" else float(int(text))
    except (OSError, ValueError):
        return float("inf")


def _table(group: Path) -> dict[str, float]:
    """memory.stat of a group."""
    found = {}
    try:
        for line in (group / "memory.stat").read_text("ascii").splitlines():
            name, _, value = line.partition(" ")
            found[name] = float(value)
    except (OSError, ValueError):
        pass
    return found
