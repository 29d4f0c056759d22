"""How a process ends: signals of all kinds, once and again, and what is left of it afterwards."""

import os
import pty
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import cellsys
from cellsys.store import RunWriter
from tests.study.scenes import tiny

ROOT = Path(cellsys.__file__).parents[1]

# A command that computes for ever, in place of the real ones: only the ending is looked at.
LOOP = """
import sys, time
from cellsys.cli import ending
ending.GRACE = float(sys.argv[2])
with ending.Signals() as signals:
    began, said = time.monotonic(), False
    while time.monotonic() < began + 60.0:
        try:
            if not said:
                said = True
                print("ready", flush=True)
            time.sleep(0.01)
        except KeyboardInterrupt as stop:
            if sys.argv[1] == "swallows":
                continue
            time.sleep(0.3)  # while the end is under way
            code = ending.say_ending(stop, "go on")
            break
sys.exit(signals.code if signals.code is not None else code)
"""


@pytest.fixture
def start():
    """Start Python processes in sessions of their own; what is left of them is killed."""
    made = []

    def begin(*arguments, ignored=(), **options):
        def dispositions():
            # A shell that runs the tests in the background hands down SIGINT as ignored, nohup
            # SIGHUP.
            for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
                signal.signal(number, signal.SIG_DFL)
            for number in ignored:
                signal.signal(number, signal.SIG_IGN)

        process = subprocess.Popen(
            [sys.executable, *map(str, arguments)],
            env={**os.environ, "PYTHONPATH": str(ROOT)}, text=True, start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, preexec_fn=dispositions, **options,
        )  # fmt: skip
        made.append(process)
        return process

    yield begin
    for process in made:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def ready(process):
    """The process, when it has printed its first line."""
    assert process.stdout.readline() == "ready\n", process.communicate()[1]
    return process


@pytest.mark.parametrize(
    ("sent", "code", "line"),
    [
        ("INT", 1, "cellsys: interrupted; go on"),
        ("TERM", 143, "cellsys: ended by SIGTERM; go on"),
        ("HUP", 129, "cellsys: ended by SIGHUP; go on"),
        ("TERM HUP TERM INT", 143, "cellsys: ended by SIGTERM; go on"),
        ("INT INT INT", 1, "cellsys: interrupted; go on"),
    ],
)
def test_the_first_signal_ends_a_command_and_further_ones_do_not_disturb(sent, code, line, start):
    process = ready(start("-c", LOOP, "ends", 8.0))
    for name in sent.split():
        process.send_signal(getattr(signal, f"SIG{name}"))
        time.sleep(0.05)
    _, err = process.communicate(timeout=10)
    assert (process.returncode, err) == (code, f"{line}\n")


def test_a_swallowed_signal_still_ends_the_process(start):
    """Callbacks of libraries swallow exceptions; naive: the process then never ends."""
    process = ready(start("-c", LOOP, "swallows", 1.0))
    process.send_signal(signal.SIGTERM)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=0.2)
    assert process.wait(timeout=5) == 143


def test_a_signal_that_was_ignored_from_the_start_stays_ignored(start):
    process = ready(start("-c", LOOP, "ends", 8.0, ignored=[signal.SIGHUP]))
    process.send_signal(signal.SIGHUP)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=0.3)
    process.terminate()
    process.communicate(timeout=10)
    assert process.returncode == 143


def test_handlers_are_as_before_after_a_command(call):
    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    assert call("--help")[0] == 0
    assert {n: signal.getsignal(n) for n in before} == before


POOL = """
import os, signal, sys, threading, time
from cellsys.scene.workers import Workers
from cellsys.store import RunWriter

def write(folder):
    writer = RunWriter(folder, {"x": (4, 3)}, {})
    open(folder + ".pid", "w").write(str(os.getpid()))
    time.sleep(60)

if __name__ == "__main__":
    with Workers(2) as workers:
        main = threading.main_thread().ident

        def begun():
            while not all(os.path.exists(f"{sys.argv[1]}/{k}.pid") for k in range(2)):
                time.sleep(0.01)
            print("ready", flush=True)
            if sys.argv[2] == "raises":
                signal.pthread_kill(main, signal.SIGINT)

        threading.Thread(target=begun).start()
        list(workers.run(write, [(f"{sys.argv[1]}/{k}",) for k in range(2)]))
"""


def alive(pids):
    """Those of some processes that are there and do not merely wait to be collected."""
    found = []
    for pid in pids:
        try:
            text = Path(f"/proc/{pid}/stat").read_text()
        except OSError:
            continue
        if text.rpartition(")")[2].split()[0] not in "ZX":
            found.append(pid)
    return found


def gone_within(seconds, pids):
    """Whether processes end in time."""
    until = time.monotonic() + seconds
    while alive(pids) and time.monotonic() < until:
        time.sleep(0.05)
    return not alive(pids)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="counts processes in /proc")
@pytest.mark.parametrize("way", ["killed", "raises"])
def test_workers_end_with_their_parent_whatever_way_and_their_runs_are_free(way, tmp_path, start):
    (tmp_path / "pool.py").write_text(POOL)
    process = ready(start(tmp_path / "pool.py", tmp_path, way))
    pids = [int((tmp_path / f"{k}.pid").read_text()) for k in range(2)]
    if way == "killed":
        assert len(alive(pids)) == 2
        process.kill()
    process.wait(timeout=5)
    # naive: a pool leaves its workers behind, with their locks; ours are gone in 5 s at the most
    assert gone_within(5.0, pids)
    RunWriter(tmp_path / "0", {"x": (4, 3)}, {}).finish({})


# Real commands


LONG = tiny(replace={'"40 s"': '"4000 s"', "runs = 3": "runs = 2"})


def wait_for(condition, seconds=60.0):
    """Wait until something holds."""
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.02)


def session(leader):
    """Processes of a session."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == leader:
            found.append(int(path.parent.name))
    return alive(found)


def still_running(process, seconds):
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=seconds)
    return True


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "sent", "code"),
    [
        ("run", "TERM", 143),
        ("run", "HUP HUP", 129),
        ("sweep", "TERM TERM", 143),
        ("sweep", "INT", 1),
    ],
)
def test_a_command_and_its_workers_end_and_the_runs_go_on(command, sent, code, tmp_path, start):
    (tmp_path / "s.toml").write_text(LONG)
    more = ["--resume"] if command == "run" else ["--set", "seed=1,2", "-j", "2"]
    arguments = ["-m", "cellsys", command, "s.toml", *more, "-o", "out"]
    process, runs = start(*arguments, cwd=tmp_path), tmp_path / "out" / "runs"
    wait_for(lambda: len(list(runs.glob("*.partial/checkpoint.npz"))) == 2)
    assert len(session(process.pid)) >= 3
    for name in sent.split():
        os.kill(process.pid, getattr(signal, f"SIG{name}"))
    out, err = process.communicate(timeout=20)
    assert process.returncode == code
    assert out == ("" if command == "run" else "2 runs, 194 MB on the disk\n")
    *plan, end = err.splitlines()
    assert [line.split()[:2] for line in plan] == [["7", "full-order"]] * (command == "run"), err
    assert end.startswith("cellsys: "), err
    assert gone_within(1.0, session(process.pid))
    stamps = {p: p.stat().st_mtime_ns for p in runs.glob("*.partial/header.json")}
    assert len(stamps) == len(list(runs.iterdir())) == 2
    # at once again: not refused as being written, and gone on with, not begun anew
    again = start(*arguments, cwd=tmp_path)
    assert still_running(again, 6.0)
    again.terminate()
    assert again.wait(timeout=20) == 143
    for path, stamp in stamps.items():
        assert path.stat().st_mtime_ns == stamp


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["starting", "writing"])
def test_killed_at_any_moment_nothing_is_left_running_or_locked(moment, tmp_path, start):
    """SIGKILL: no handler runs. While workers load and compile, and while they write."""
    (tmp_path / "s.toml").write_text(LONG)
    arguments = ["-m", "cellsys", "run", "s.toml", "-o", "out"]
    process, runs = start(*arguments, cwd=tmp_path), tmp_path / "out" / "runs"
    if moment == "starting":
        wait_for(lambda: len(session(process.pid)) >= 3)
    else:
        wait_for(lambda: len(list(runs.glob("*.partial/checkpoint.npz"))) == 2)
    process.kill()
    process.wait()
    assert gone_within(5.0, session(process.pid))
    again = start(*arguments, cwd=tmp_path)
    assert still_running(again, 6.0)  # it is not refused
    again.terminate()
    assert again.wait(timeout=20) == 143


@pytest.mark.slow
def test_a_terminal_that_is_closed_ends_the_command_and_its_workers(tmp_path):
    """The hangup: standard error is gone too, and the progress bar on it."""
    (tmp_path / "s.toml").write_text(LONG)
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(tmp_path)
        os.execve(
            sys.executable,
            [sys.executable, "-m", "cellsys", "run", "s.toml", "-o", "out"],
            {**os.environ, "PYTHONPATH": str(ROOT)},
        )
    runs = tmp_path / "out" / "runs"
    wait_for(lambda: len(list(runs.glob("*.partial/checkpoint.npz"))) == 2)
    workers = session(child)
    assert len(workers) >= 3
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 129
    assert gone_within(5.0, workers)


IN_A_THREAD = """
import os, signal, sys, threading, time
from pathlib import Path
import cellsys as cs

def study():
    cs.study("s.toml", "out")

if __name__ == "__main__":
    threading.Thread(target=study, daemon=True).start()
    time.sleep(60)
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["TERM", "KILL", "INT"])
def test_a_study_in_a_thread_of_a_script_leaves_no_workers(name, tmp_path, start):
    """No handler can be installed there: the workers see themselves that nobody is left."""
    (tmp_path / "s.toml").write_text(LONG)
    (tmp_path / "script.py").write_text(IN_A_THREAD)
    process, runs = start("script.py", cwd=tmp_path), tmp_path / "out" / "runs"
    wait_for(lambda: len(list(runs.glob("*.partial/checkpoint.npz"))) == 2)
    workers = session(process.pid)
    assert len(workers) >= 3
    process.send_signal(getattr(signal, f"SIG{name}"))
    process.wait(timeout=20)
    assert gone_within(5.0, workers)


POOL_OF_ANOTHER = """
import multiprocessing, sys, tomllib
from concurrent.futures import ProcessPoolExecutor
import cellsys as cs

if __name__ == "__main__":
    table = tomllib.load(open("s.toml", "rb"))
    scenes = [cs.Scene.parse({**table, "seed": k}) for k in (1, 2)]
    with ProcessPoolExecutor(2, multiprocessing.get_context(sys.argv[1])) as pool:
        cs.run_ensemble(scenes, "out/runs", executor=pool)
"""


@pytest.mark.slow
@pytest.mark.parametrize("way", ["fork", "spawn", "forkserver"])
def test_runs_in_a_pool_of_the_user_end_with_its_owner_too(way, tmp_path, start):
    """Naive: processes of a pool whose owner was killed go on, and wait for ever for more work."""
    (tmp_path / "s.toml").write_text(LONG)
    (tmp_path / "script.py").write_text(POOL_OF_ANOTHER)
    process, runs = start("script.py", way, cwd=tmp_path), tmp_path / "out" / "runs"
    wait_for(lambda: len(list(runs.glob("*.partial/checkpoint.npz"))) == 2)
    assert len(session(process.pid)) >= 3
    process.kill()
    process.wait()
    assert gone_within(5.0, session(process.pid))
