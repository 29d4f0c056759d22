"""Who may write a run: locks that die with their holder, leases of holders that are cut off."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import cellsys
from cellsys.errors import LostRunError, ParameterError
from cellsys.store import RunReader, RunWriter, hold
from tests import naive

ROOT = Path(cellsys.__file__).parents[1]
SHAPES = {"x": (4, 3)}

# A writer that has made a checkpoint at row 2 and goes on to write when it is told.
WRITER = """
import sys
import numpy as np
from cellsys.store import RunWriter, hold
hold.LONGEST, hold.BEAT = float(sys.argv[2]), 0.1
writer = RunWriter(sys.argv[1], {"x": (4, 3)}, {})
writer.arrays["x"][:2] = 1.0
writer.checkpoint({"x": np.ones(3)}, {"sample": 1})
print("ready", flush=True)
for line in sys.stdin:
    try:
        writer.arrays["x"][2:] = -7.0
        writer.check()
        print("wrote", flush=True)
    except Exception as error:
        print(type(error).__name__, str(error).split(";")[0], flush=True)
"""


@pytest.fixture
def start():
    """Start a writer in another process; ended afterwards."""
    made = []

    def begin(folder, longest):
        process = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(folder), str(longest)],
            cwd=ROOT, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        made.append(process)
        assert process.stdout.readline() == "ready\n"
        return process

    yield begin
    for process in made:
        process.kill()
        process.communicate()


def says(process):
    process.stdin.write("\n")
    process.stdin.flush()
    return process.stdout.readline()


def test_a_holder_that_lives_is_not_disturbed_and_a_dead_one_holds_nothing(
    tmp_path, start, monkeypatch
):
    monkeypatch.setattr(hold, "PATIENCE", 0.3)
    monkeypatch.setattr(hold, "LONGEST", 0.5)
    process = start(tmp_path / "run", 0.5)
    time.sleep(0.8)  # longer than a lease: it is renewed
    with pytest.raises(ParameterError, match=rf"another process \(number {process.pid} on .* ago"):
        RunWriter(tmp_path / "run", SHAPES, {})
    assert says(process) == "wrote\n"
    process.kill()
    process.wait()
    # naive: a lock that is a file outlives its holder
    assert naive.locked_by_a_file(tmp_path / "run.partial" / "lock")
    again = RunWriter(tmp_path / "run", SHAPES, {})
    assert again.resumed
    assert again.last_checkpoint()[1] == {"sample": 1}


def test_a_holder_that_is_cut_off_loses_its_run_and_is_told(tmp_path, start, monkeypatch):
    """Stopped, its lock still stands: naive, by the lock alone, its run is lost for ever."""
    monkeypatch.setattr(hold, "PATIENCE", 5.0)
    monkeypatch.setattr(hold, "LONGEST", 0.5)
    process = start(tmp_path / "run", 0.5)
    process.send_signal(signal.SIGSTOP)
    began = time.monotonic()
    other = RunWriter(tmp_path / "run", SHAPES, {})
    assert 0.2 < time.monotonic() - began < 4.0
    # it goes on from the checkpoint ...
    assert other.resumed
    assert np.array_equal(other.last_checkpoint()[0]["x"], np.ones(3))
    assert np.array_equal(other.arrays["x"][:2], np.ones((2, 3)))
    # ... in files of its own: what the old holder writes when it wakes up reaches nobody
    process.send_signal(signal.SIGCONT)
    assert says(process).startswith("LostRunError run 'run' was taken over")
    other.arrays["x"][2:] = 5.0
    other.finish({})
    assert np.array_equal(RunReader(tmp_path / "run").arrays["x"][2:], np.full((2, 3), 5.0))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run"]
    assert sorted(p.name for p in (tmp_path / "run").iterdir()) == [
        "header.json", "run.json", "x.npy",
    ]  # fmt: skip


def test_of_two_writers_in_one_process_the_later_goes_on(tmp_path):
    """A traceback keeps an interrupted writer alive; the same cell of a notebook is run again."""
    first = RunWriter(tmp_path / "run", SHAPES, {})
    first.arrays["x"][:2] = 1.0
    first.checkpoint({"x": np.ones(3)}, {"sample": 1})
    second = RunWriter(tmp_path / "run", SHAPES, {})
    assert second.resumed
    first.arrays["x"][:] = -7.0
    with pytest.raises(LostRunError, match="taken over"):
        first.check()
    with pytest.raises(LostRunError, match="taken over"):
        first.finish({})
    assert np.array_equal(second.arrays["x"][:2], np.ones((2, 3)))
    del first
    second.check()
    second.finish({})
    assert np.array_equal(RunReader(tmp_path / "run").arrays["x"][:2], np.ones((2, 3)))


@pytest.mark.parametrize("what", ["folder", "parent", "array"])
def test_a_folder_that_is_removed_is_noticed_at_the_next_write(what, tmp_path):
    writer = RunWriter(tmp_path / "runs" / "run", SHAPES, {})
    partial = tmp_path / "runs" / "run.partial"
    if what == "array":
        (partial / "x.npy").unlink()
    else:
        aside = partial if what == "folder" else partial.parent
        shutil.rmtree(aside)
    writer.arrays["x"][:] = 1.0  # naive: the mapped file takes it, and it is gone
    with pytest.raises(LostRunError, match="removed while"):
        writer.checkpoint({}, {}) if what != "array" else writer.finish({})
    with pytest.raises(LostRunError, match="removed while"):
        writer.finish({})
    assert not (tmp_path / "runs" / "run").exists()


def test_an_old_file_of_the_final_name_gives_way(tmp_path):
    (tmp_path / "run").write_text("in the way")
    RunWriter(tmp_path / "run", SHAPES, {}).finish({})
    assert RunReader(tmp_path / "run").arrays["x"].shape == (4, 3)


def test_interrupted_between_its_last_row_and_its_name_a_run_still_has_its_checkpoint(
    tmp_path, monkeypatch
):
    writer = RunWriter(tmp_path / "run", SHAPES, {})
    writer.checkpoint({"x": np.ones(3)}, {"sample": 1})

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", interrupted)
        with pytest.raises(KeyboardInterrupt):
            writer.finish({})
    assert not (tmp_path / "run").exists()
    again = RunWriter(tmp_path / "run", SHAPES, {})
    assert again.resumed
    assert again.last_checkpoint()[1] == {"sample": 1}


def test_a_disk_without_locks_has_leases(tmp_path, start, monkeypatch):
    monkeypatch.setattr(hold, "PATIENCE", 0.3)
    monkeypatch.setattr(hold, "LONGEST", 1.5)
    process = start(tmp_path / "run", 1.5)
    monkeypatch.setattr(hold, "fcntl", None)
    with pytest.raises(ParameterError, match="another process"):
        RunWriter(tmp_path / "run", SHAPES, {})
    process.kill()
    process.wait()
    monkeypatch.setattr(hold, "PATIENCE", 5.0)
    assert RunWriter(tmp_path / "run", SHAPES, {}).resumed
