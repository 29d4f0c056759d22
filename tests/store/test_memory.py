"""Memory that can be had: under limits of the shell and of cgroups, in units that fit."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import cellsys
from cellsys.errors import MemoryBudgetError
from cellsys.store import memory
from cellsys.store.memory import Room, available_memory, cgroup_room, check_memory, size_text

ROOT = Path(cellsys.__file__).parents[1]


@pytest.mark.parametrize(
    ("amount", "text"),
    [
        (0, "0 bytes"), (999, "999 bytes"), (1000, "1 kB"), (12_345, "12.3 kB"),
        (999_600, "1 MB"), (45.67e6, "45.7 MB"), (1.5e9, "1.5 GB"), (23.4e12, "23400.0 GB"),
    ],
)  # fmt: skip
def test_amounts_in_the_unit_that_fits(amount, text):
    assert size_text(amount) == text


@given(st.floats(1.0, 1e12))
def test_an_amount_in_words_is_the_amount(amount):
    number, unit = size_text(amount).split()
    factor = {"bytes": 1.0, "kB": 1e3, "MB": 1e6, "GB": 1e9}[unit]
    # naive: "needs 0.0 GB and 0.0 GB are free"
    assert float(number) * factor == pytest.approx(amount, rel=0.05, abs=0.5)


def test_a_refusal_says_what_is_needed_what_is_free_and_why():
    said = r"^x needs .* GB of memory and .* are free \(.*\); stop$"
    with pytest.raises(MemoryBudgetError, match=said):
        check_memory(1e30, "x needs", "stop")
    check_memory(1.0, "x needs", "stop", addresses=1.0)


# cgroups, as the kernel writes them


def process(folder, groups, mounts):
    """Folder of a process with these groups and mounts."""
    folder.mkdir(parents=True)
    (folder / "cgroup").write_text("\n".join(groups) + "\n")
    (folder / "mountinfo").write_text("\n".join(mounts) + "\n")
    return folder


def group(folder, **files):
    folder.mkdir(parents=True, exist_ok=True)
    for name, value in files.items():
        (folder / f"memory.{name}").write_text(f"{value}\n")


def mount(point, kind, options="rw", root="/"):
    return f"35 26 0:30 {root} {point} rw,nosuid shared:9 - {kind} cgroup {options}"


MB = 1_000_000


def test_version_2_every_group_above_counts(tmp_path):
    """Pages of files that are not in use are given back when memory is asked for."""
    top = tmp_path / "sys fs"
    group(top / "a", max=900 * MB, current=500 * MB, stat=f"anon 1\ninactive_file {100 * MB}")
    group(top / "a" / "b", max="max", high=300 * MB, current=50 * MB, stat="inactive_file 0")
    at = process(
        tmp_path / "proc", ["12:cpu:/x", "0::/a/b"],
        ["garbage", mount(str(top).replace(" ", "\\040"), "cgroup2")],
    )  # fmt: skip
    assert sorted(r.bytes for r in cgroup_room(at)) == [250 * MB, 500 * MB]
    group(top / "a", current=899 * MB, stat="")
    assert min(cgroup_room(at)).bytes == 1 * MB


def test_version_1_has_its_own_names(tmp_path):
    top = tmp_path / "memory"
    group(
        top / "job", limit_in_bytes=700 * MB, usage_in_bytes=300 * MB,
        stat=f"total_inactive_file {50 * MB}\nhierarchical_memory_limit 9223372036854771712",
    )  # fmt: skip
    group(top, limit_in_bytes=9223372036854771712, usage_in_bytes=10**12)
    mounts = [mount(tmp_path / "cpu", "cgroup", "rw,cpu"), mount(top, "cgroup", "rw,memory")]
    at = process(tmp_path / "proc", ["4:memory:/job", "0::/"], mounts)
    assert [r.bytes for r in cgroup_room(at)] == [450 * MB]
    # the limit of a group above that is not mounted here
    group(top / "job", stat=f"hierarchical_memory_limit {400 * MB}")
    assert min(cgroup_room(at)).bytes == 100 * MB


@pytest.mark.parametrize("root", ["/docker/abc", "/"])
def test_in_a_container_the_mount_is_the_group(root, tmp_path):
    """The path is that of the host, and stands nowhere under the mount."""
    top = tmp_path / "cgroup"
    group(top, max=200 * MB, current=50 * MB, stat="")
    path = "/docker/abc" if root != "/" else "/../../elsewhere"
    at = process(tmp_path / "proc", [f"0::{path}"], [mount(top, "cgroup2", root=root)])
    assert [r.bytes for r in cgroup_room(at)] == [150 * MB]


@pytest.mark.parametrize("text", ["", "::", "0::", "\x00", "1:memory", "4:memory:/gone", "0::/no"])
def test_files_that_say_nothing_bound_nothing(text, tmp_path):
    at = process(tmp_path / "proc", [text], [mount(tmp_path / "none", "cgroup2"), " - ", text])
    assert cgroup_room(at) == []
    assert cgroup_room(tmp_path / "nowhere") == []


def test_the_least_counts(monkeypatch):
    monkeypatch.setattr(memory, "cgroup_room", lambda: [Room(5.0, "cgroup"), Room(7.0, "other")])
    assert available_memory() == 5.0
    with pytest.raises(MemoryBudgetError, match=r"6 bytes of memory and 5 bytes are free \(cg"):
        check_memory(6.0, "x needs", "stop")


# Real limits, of processes of their own

SAID = """
import resource, sys
name, amount = sys.argv[1], int(sys.argv[2])
if amount:
    resource.setrlimit(getattr(resource, name), (amount, amount))
from cellsys.store.memory import memory_room
room = memory_room()
block = bytearray(int(0.9 * room.bytes)) if amount else b""
try:
    bytearray(int(1.1 * room.bytes)) if amount else None
    print("had more", end=" ")
except MemoryError:
    pass
print(int(room.bytes), room.bound)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits are enforced on Linux")
@pytest.mark.parametrize(("name", "option"), [("RLIMIT_AS", "-v"), ("RLIMIT_DATA", "-d")])
def test_limits_of_the_shell_count(name, option):
    """Nine tenths of what is said can be had, and eleven tenths cannot."""
    done = subprocess.run(
        [sys.executable, "-c", SAID, name, str(800 * MB)],
        cwd=ROOT, capture_output=True, text=True, check=False,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    left, bound = done.stdout.strip().split(" ", 1)
    assert bound == f"ulimit {option}"
    assert 100 * MB < int(left) < 800 * MB


CONTROLLER = Path("/sys/fs/cgroup/memory")


@pytest.mark.skipif(not os.access(CONTROLLER, os.W_OK), reason="needs the right to make a cgroup")
def test_a_real_cgroup_counts():
    made = CONTROLLER / f"cellsys-test-{os.getpid()}"
    try:
        made.mkdir()
        (made / "memory.limit_in_bytes").write_text(str(300 * MB))
    except OSError as error:
        pytest.skip(f"no cgroup can be made here: {error}")
    try:
        done = subprocess.run(
            [sys.executable, "-c", SAID, "-", "0"], cwd=ROOT, capture_output=True, text=True,
            check=True, preexec_fn=lambda: (made / "cgroup.procs").write_text(str(os.getpid())),
        )  # fmt: skip
    finally:
        made.rmdir()
    said = done.stdout.replace("had more", "").strip()
    left, bound = said.split(" ", 1)
    assert bound == "limit of the cgroup of this process"
    assert 200 * MB < int(left) < 300 * MB
