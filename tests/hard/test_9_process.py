"""Process: killed, interrupted, two at once, disk full, damaged and hostile files, odd machines."""

import locale
import os
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellsys.errors import (
    CellsysError,
    FileFormatError,
    MemoryBudgetError,
    ParameterError,
    SceneError,
)
from cellsys.integrate import LinearlyImplicit, simulate
from cellsys.model import LatentModel
from cellsys.scene import Scene, build, load_scene, run_scene, training_scenes
from cellsys.scene.chain import METHOD, ChainScene
from cellsys.store import RunReader, RunWriter, discard_partial, load_archive
from tests import naive
from tests.hard.damage import (
    FULL,
    SAVER,
    SMALL_DISK,
    WRITER,
    bounded,
    model_file,
    mutated,
    nothing_outside,
    same_model,
)
from tests.hard.stress import SEED, Case, Choice, Int, Real, hold
from tests.hard.test_9_files import CASES as FILES
from tests.hard.test_9_runs import CASES as RUNS
from tests.hard.test_9_runs import SHAPES
from tests.mechanics.small_scenes import tiny
from tests.study.scenes import TINY

ROOT = Path(__file__).resolve().parents[2]
PRESETS = ("crawler", "passive_matrix", "isolated_membrane")
SHORT = TINY.replace('duration = "40 s"\nsample = "5 s"', 'duration = "12 s"\nsample = "0.5 s"', 1)


def text_of(name):
    """Text of a preset, or the tiny scene of the study's tests."""
    if name == "tiny":
        return TINY
    return (ROOT / "cellsys" / "scene" / "presets" / f"{name}.toml").read_text("utf-8")


# Scene files


def a_changed_scene_file_is_read_or_refused(base, seed, changes):
    """Read, and where it is small also built and stepped twice."""
    with tempfile.TemporaryDirectory() as name, nothing_outside(Path(name)) as folder:
        path = folder / "scene.toml"
        path.write_text(mutated(text_of(base), seed, changes), "utf-8")
        with bounded(1.0):
            scene = load_scene(path)
            assert len(scene.fingerprint()) > 20
            if isinstance(scene.matrix, ChainScene):
                if scene.matrix.nodes <= 2000:
                    simulate(build(scene), METHOD, [0.0, min(0.05, scene.sample)])
                return
            training_scenes(scene)
            if scene.matrix is not None and scene.matrix.node_count > 1000:
                return
            if len(scene.cells) <= 3:
                system, h = build(scene), scene.step
                simulate(system, LinearlyImplicit(step=h), [0.0, h, 2 * h], seed=scene.seed)


def built(table):
    """Everything that a study makes of a scene before it runs it."""
    scene = Scene.parse(table)
    return training_scenes(scene), build(scene)


@pytest.mark.parametrize(
    ("place", "value", "kind"),
    [
        ("matrix.nodes", 10**9, MemoryBudgetError),
        ("matrix.nodes", 10**30, SceneError),
        ("sample", "4e-11 s", SceneError),  # 1e12 samples
        ("duration", "1e12 s", SceneError),
        ("step", "1e-9 s", SceneError),
        ("training.runs", 10**9, SceneError),
        ("training.runs", 10**400, SceneError),
        ("matrix.diameter", "1e300 um", SceneError),
        ("matrix.thickness", "1e9 um", SceneError),
    ],
)
def test_more_than_a_machine_holds_is_refused_before_it_is_allocated(place, value, kind):
    table = tomllib.loads(TINY)
    inner = table
    *keys, last = place.split(".")
    for key in keys:
        inner = inner[key]
    inner[last] = value
    began = time.monotonic()
    # 50 MB: what parsing and the error itself may take
    with bounded(0.05), pytest.raises(kind, match=r"GB|more than|must be"):
        built(table)
    assert time.monotonic() - began < 5.0
    if last == "nodes":
        # numpy says no only where the numbers are absurd; it promises 24 GB without a word
        assert naive.bytes_promised_without_a_word(10**9) >= 24 * 10**9


def test_a_chain_of_a_billion_nodes_is_refused():
    text = text_of("crawler")
    table = tomllib.loads(text)
    table["matrix"]["nodes"] = 10**9
    with bounded(0.05), pytest.raises(MemoryBudgetError, match="GB"):
        build(Scene.parse(table))


@pytest.mark.slow
def test_a_hundred_thousand_cells_are_refused():
    one = Scene.parse(tiny("membrane_elasticity", cells=1, matrix=False))
    places = ((30.0 * (k % 300), 30.0 * (k // 300)) for k in range(10**5))
    cells = tuple(replace(one.cells[0], position=at) for at in places)
    began = time.process_time()
    scene = replace(one, cells=cells)
    with pytest.raises(SceneError, match=r"cells\[3\] and cells\[99999\] overlap"):
        replace(one, cells=(*cells[:-1], replace(cells[0], position=(91.0, 1.0))))
    # every cell is compared with its neighbours alone; naive: with all others
    assert time.process_time() - began < 20.0
    assert naive.pairs_compared(len(cells)) > 4e9
    began = time.process_time()
    with bounded(0.05), pytest.raises(MemoryBudgetError, match=r"100000 cells of .* GB"):
        build(scene)
    assert time.process_time() - began < 5.0


# Runs


def scene_of(text):
    return Scene.parse(tomllib.loads(text))


class _Stop(Exception):
    pass


def an_interrupted_run_goes_on_bit_for_bit(at, kinetics, again):
    """Stopped after a sample, `again` times more, and resumed: the same bits."""
    scene = scene_of(SHORT.replace('"clutch"', f'"{kinetics}"'))
    whole = run_scene(scene)

    def stop(share):
        if share >= at:
            raise _Stop

    with tempfile.TemporaryDirectory() as name:
        for _ in range(again):
            with pytest.raises(_Stop):
                run_scene(scene, name, progress=stop)
        resumed = run_scene(scene, name)
        for key in ("x", "eta", "u", "p", "d", "amplitude", "eta_start"):
            assert np.array_equal(getattr(resumed, key), getattr(whole, key)), key
        assert resumed.events == whole.events


def test_a_new_run_from_the_last_state_is_another_run():
    an_interrupted_run_goes_on_bit_for_bit(0.5, "clutch", 1)
    scene = scene_of(SHORT)
    system, method = build(scene), LinearlyImplicit(step=scene.step)
    t = np.arange(0.0, 6.5, 0.5)
    whole = simulate(system, method, t, seed=1, auxiliaries=False)
    # naive: the stepper's velocity is no part of the state
    half = naive.restarted(simulate, system, method, t[6:], whole.x[6], 1)
    assert not np.array_equal(half.x[-1], whole.x[-1])


def python(code, *arguments, **options):
    """A Python process started in the repository."""
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        cwd=ROOT, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options,
    )  # fmt: skip


def test_two_processes_do_not_write_one_run(tmp_path):
    first = python(WRITER, tmp_path / "run")
    try:
        assert first.stdout.readline() == "writing\n"
        with pytest.raises(ParameterError, match="another process"):
            RunWriter(tmp_path / "run", SHAPES, {})
        with pytest.raises(ParameterError, match="another process"):
            discard_partial(tmp_path / "run.partial")
        assert (tmp_path / "run.partial" / "x.npy").exists()
        RunWriter(tmp_path / "other", SHAPES, {}).finish({})
        # naive: a lock that is a file keeps the run locked after its writer was killed
        assert naive.locked_by_a_file(tmp_path / "run.partial" / "lock")
    finally:
        first.kill()
        first.communicate()
    assert naive.locked_by_a_file(tmp_path / "run.partial" / "lock")
    RunWriter(tmp_path / "run", SHAPES, {}).finish({})
    assert RunReader(tmp_path / "run").arrays["x"].shape == (40, 3)


def test_killed_while_it_saves_the_file_is_old_or_new(tmp_path):
    rng = np.random.default_rng(4)
    for _ in range(3):
        saver = python(SAVER, tmp_path / "m.npz")
        assert saver.stdout.readline() == "saving\n"
        while not (tmp_path / "m.npz").exists():
            time.sleep(0.01)
        time.sleep(float(rng.uniform(0.0, 0.1)))
        saver.send_signal(signal.SIGKILL)
        saver.communicate()
        arrays, meta = load_archive(tmp_path / "m.npz", "m", 1)
        assert np.all(arrays["A"] == meta["k"])
    # naive: written in place and stopped half-way, neither the old nor the new is there
    old = (tmp_path / "m.npz").read_bytes()
    naive.write_in_place(tmp_path / "m.npz", old, stop=len(old) // 2)
    with pytest.raises(FileFormatError):
        load_archive(tmp_path / "m.npz", "m", 1)


def test_a_file_that_cannot_grow_leaves_the_old_one(tmp_path):
    """A limit on file size stands for a full disk: writes fail in the middle."""
    out, err = python(SMALL_DISK, tmp_path).communicate(timeout=60)
    assert out.split() == ["OSError", "OSError", "10"], err
    assert [p.name for p in tmp_path.iterdir()] == ["m.npz"]


def full_disk(folder):
    """A file system of 2 MB at `folder`; skips where none can be mounted."""
    folder.mkdir()
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=2m", "none", str(folder)],
        capture_output=True, check=False,
    )  # fmt: skip
    if done.returncode:
        pytest.skip("no file system can be mounted here")


def test_a_full_disk_is_an_error_not_a_dead_process(tmp_path):
    """A sparse file that is mapped into memory kills its writer when the blocks run out."""
    disk = tmp_path / "disk"
    full_disk(disk)
    try:
        out, err = python(FULL, disk, "ours").communicate(timeout=60)
        assert out.split() == ["MemoryBudgetError"], err
        assert list(disk.iterdir()) == []
        dead = python(FULL, disk, "naive")
        dead.communicate(timeout=60)
        assert dead.returncode == -signal.SIGBUS
    finally:
        subprocess.run(["umount", str(disk)], check=False)


# Machines


ODD_MACHINE = {
    "LC_ALL": "C", "LANG": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0",
    "HOME": "/nonexistent", "NO_COLOR": "1", "COLUMNS": "80",
}  # fmt: skip


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "arguments",
    [
        ["poles"],
        pytest.param(["stability"], marks=SLOW),
        pytest.param(["couple", "--cells", "3"], marks=SLOW),
    ],
)
def test_ascii_only_no_display_no_home(arguments, tmp_path):
    path, _ = model_file(tmp_path)
    kept = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "MPLBACKEND", "PYTHONPATH")}
    done = subprocess.run(
        [sys.executable, "-m", "cellsys", arguments[0], str(path), *arguments[1:]],
        cwd=ROOT, capture_output=True, check=False, timeout=120, env=kept | ODD_MACHINE,
    )  # fmt: skip
    # a model without rows of V cannot be coupled: one line, exit code 2
    assert done.returncode == (2 if arguments[0] == "couple" else 0), done.stderr.decode()
    assert b"Traceback" not in done.stderr


@pytest.mark.slow
def test_the_main_job_on_an_odd_machine(tmp_path):
    """A study as a user without rights, home, display or any language but C."""
    (tmp_path / "s.toml").write_text(TINY)
    kept = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "MPLBACKEND")}
    done = subprocess.run(
        [sys.executable, "-m", "cellsys", "run", str(tmp_path / "s.toml"), "-o",
         str(tmp_path / "out"), "--order", "3"],
        cwd=ROOT, capture_output=True, check=False, timeout=300, env=kept | ODD_MACHINE,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr.decode()[-2000:]
    assert (tmp_path / "out" / "report.html").exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out", "s.toml"]


def decimal_commas_change_nothing(seed):
    """With a locale whose decimal mark is a comma, numbers are read and written as before."""
    before = locale.setlocale(locale.LC_NUMERIC)
    for name in ("de_DE.UTF-8", "de_DE.utf8", "fr_FR.UTF-8", before):
        try:
            locale.setlocale(locale.LC_NUMERIC, name)
            break
        except locale.Error:
            continue
    try:
        with tempfile.TemporaryDirectory() as folder:
            path, model = model_file(Path(folder), seed)
            assert same_model(LatentModel.load(path), model)
        scene = scene_of(TINY)
        assert scene.effects["lamellipodium"].force == 600.0
        assert scene.fingerprint() == scene_of(TINY).fingerprint()
    finally:
        locale.setlocale(locale.LC_NUMERIC, before)


def test_decimal_commas():
    decimal_commas_change_nothing(0)
    assert naive.float_of_locale("0,5") == 0.5
    with pytest.raises(CellsysError):
        Scene.parse({"name": "a", "duration": "0,5 s"})


CASES = (
    Case(
        "scene file changed",
        a_changed_scene_file_is_read_or_refused,
        {"base": Choice("tiny", *PRESETS), "changes": Int(1, 6), "seed": SEED},
    ),
    *FILES,
    *RUNS,
    Case(
        "run interrupted",
        an_interrupted_run_goes_on_bit_for_bit,
        {"at": Real(0.05, 0.99), "kinetics": Choice("clutch", "switching"), "again": Int(1, 3)},
    ),
    Case("decimal comma", decimal_commas_change_nothing, {"seed": SEED}),
)


@pytest.mark.parametrize("case", [c for c in CASES if c not in FILES + RUNS], ids=lambda c: c.name)
def test_random_instances(case):
    hold(case, 3)
