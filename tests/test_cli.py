"""The command line: exit codes, one-line errors, nothing half-written, JSON for machines."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import cellsys
from cellsys.loop import PolarityLaw
from cellsys.model import LatentModel, StiffnessSensor
from cellsys.reduction import LeastSquares, reduce
from cellsys.samples import snapshots
from cellsys.scene import Scene, run_scene
from cellsys.store import save_archive
from tests.loop.systems import NAMES, make
from tests.study.scenes import TINY, tiny


def refused(result, words, code=2):
    """Exit code 2, one line on standard error that has the words, nothing on standard output."""
    got, out, err = result
    assert got == code, err
    assert out == ""
    lines = err.strip().split("\n")
    assert len(lines) == 1, err
    assert lines[0].startswith("cellsys: ")
    assert "Traceback" not in err
    for word in [words] if isinstance(words, str) else words:
        assert word in err


@pytest.fixture(scope="module")
def model_file(tmp_path_factory):
    loop = make(1, kappa=1 / 20, gain=0.2)
    import dataclasses

    model = dataclasses.replace(loop.model, sensor=loop.sensor)
    return model.save(tmp_path_factory.mktemp("model") / "m.npz")


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    import tomllib

    folder = tmp_path_factory.mktemp("runs")
    run_scene(Scene.parse(tomllib.loads(TINY)), folder)
    return next(folder.iterdir())


# Bad scenes

OTHER = '[[cells]]\nposition = ["{} um", "0 um"]\nradius = "5 um"\n[effects]'
SCENES = {
    "unknown effect": ({"volume = {}": "volum = {}"}, ["volum", "did you mean 'volume'"]),
    "missing unit": ({'"600 pN"': '"600"'}, ["lamellipodium.force", "unit"]),
    "wrong unit": ({'"600 pN"': '"600 um"'}, ["lamellipodium.force", "dimension"]),
    "negative stiffness": (
        {"foundation = {}": 'foundation = { spring = "-1 pN/um" }'}, ["foundation.spring", ">= 0"],
    ),
    "nan": ({'polarity = "60 deg"': 'polarity = "nan deg"'}, ["polarity", "nan"]),
    "nan literal": ({"volume = {}": "volume = { modulus = nan }"}, "volume.modulus"),
    "overlapping cells": ({"[effects]": OTHER.format(4)}, "overlap"),
    "cell outside the disc": ({'["0 um", "0 um"]': '["17 um", "0 um"]'}, "outside the disc"),
    "zero duration": ({'duration = "40 s"\nsample': 'duration = "0 s"\nsample'}, "duration"),
    "not toml": ({"[effects]": "[effects"}, "not a TOML file"),
    "memory": ({'"40 um"\nnodes = 400': '"60000 um"'}, ["GB", "free"]),
    "short training": ({"runs = 3": "runs = 1"}, ["order 10", "7 samples"]),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_a_bad_scene_is_one_line_and_nothing_is_written(name, call, tmp_path):
    replace, words = SCENES[name]
    (tmp_path / "s.toml").write_text(tiny(replace=replace))
    refused(call("run", "s.toml", "-o", "out"), words)
    assert [p.name for p in tmp_path.iterdir()] == ["s.toml"]
    if name != "short training":
        refused(call("effects", "s.toml"), words)


def test_scene_files_that_are_not_there(call, tmp_path):
    refused(call("run", "absent.toml"), "absent.toml")
    refused(call("run", tmp_path), "cannot be read")
    refused(call("effects", "absent.toml"), "absent.toml")
    assert not list(tmp_path.iterdir())


def test_options_of_run_that_cannot_be(call, tmp_path):
    (tmp_path / "s.toml").write_text(TINY)
    (tmp_path / "taken").write_text("mine")
    refused(call("run", "s.toml", "-o", "taken"), ["taken", "file"])
    assert (tmp_path / "taken").read_text() == "mine"
    refused(call("run", "s.toml", "-o", "taken/inside"), "taken")
    refused(call("run", "s.toml", "--order", "500"), ["order 500", "21 samples"])
    refused(call("run", "s.toml", "--order", "0"), "order")
    refused(call("run", "s.toml", "--workers", "0"), "workers")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["s.toml", "taken"]


@pytest.mark.parametrize(
    "arguments", [["fly"], ["run"], ["run", "--fast"], ["reduce", "a.npz"], ["poles"]]
)
def test_wrong_use_is_exit_code_two(arguments, call):
    code, out, err = call(*arguments)
    assert code == 2
    assert "Traceback" not in out + err
    assert "cellsys" in err


def test_help_names_every_command(call):
    code, out, _ = call("--help")
    assert code == 0
    for name in ("run", "reduce", "poles", "bode", "stability", "effects", "schema"):
        assert re.search(rf"\b{name}\b", out)
        assert call(name, "--help")[0] == 0


# Models


def test_poles(call, model_file):
    code, out, err = call("poles", model_file)
    assert (code, err) == (0, "")
    assert "verdict: no card: never measured on data." in out
    code, out, _ = call("poles", model_file, "--json")
    table = json.loads(out)
    poles = np.sort_complex([complex(*p) for p in table["poles"]])
    assert np.abs(poles - np.sort_complex(LatentModel.load(model_file).poles())).max() < 1e-12


def test_stability(call, model_file):
    code, out, _ = call("stability", model_file)
    assert code == 0
    assert "stable" in out
    code, out, _ = call("stability", model_file, "--json")
    table = json.loads(out)
    assert table["verdict"] == "stable"
    assert table["spectral_abscissa"] < 0 < table["numerical_abscissa"] + 1


def test_bode(call, model_file, tmp_path):
    code, out, _ = call("bode", model_file, "-o", "b.png")
    assert code == 0
    assert "gain margin" in out
    assert (tmp_path / "b.png").read_bytes()[:4] == b"\x89PNG"
    code, out, _ = call("bode", model_file, "--json")
    assert code == 0
    assert set(json.loads(out)) == {
        "gain_margin", "phase_margin_deg", "delay_margin_s", "closed_loop_stable", "set_apart",
    }  # fmt: skip


@pytest.mark.parametrize("command", ["poles", "bode", "stability"])
def test_bad_model_files(command, call, model_file, tmp_path):
    whole = Path(model_file).read_bytes()
    for name, content in (
        ("cut.npz", whole[: len(whole) // 2]),
        ("empty.npz", b""),
        ("text.npz", b"hello"),
    ):
        (tmp_path / name).write_bytes(content)
        refused(call(command, name), name)
    np.savez(tmp_path / "foreign.npz", A=np.eye(2))
    refused(call(command, "foreign.npz"), ["foreign.npz", "not written by cellsys"])
    save_archive(tmp_path / "run.npz", "run", 1, {"x": np.eye(2)}, {})
    refused(call(command, "run.npz"), ["run.npz", "expected a 'latent model'"])
    refused(call(command, "absent.npz"), "absent.npz")
    refused(call(command, tmp_path), "cellsys")


@pytest.mark.slow
def test_bode_of_a_scheduled_model_along_time(call, model_file, tmp_path):
    from tests.cell.runs import model

    model().save(tmp_path / "scheduled.npz")
    code, out, _ = call("bode", "scheduled.npz", "--at", "20,100", "-o", "along.png", "--json")
    assert code == 0
    found = json.loads(out)
    assert list(found) == ["20", "100"]
    assert found["20"]["phase_margin_deg"] != found["100"]["phase_margin_deg"]
    assert (tmp_path / "along.png").stat().st_size > 1000
    refused(call("bode", "scheduled.npz", "--at", "soon"), "times in s")
    refused(call("bode", model_file, "--at", "20"), "scheduled model")


def test_bode_refuses_models_without_a_loop(call, tmp_path):
    LatentModel(A=-np.eye(2)).save(tmp_path / "bare.npz")
    refused(call("bode", "bare.npz", "-o", "b.png"), "no sensor")
    LatentModel(A=-np.eye(2), B=np.ones((2, 1)), sensor=StiffnessSensor(K_d=np.ones((3, 3)))).save(
        tmp_path / "other.npz"
    )
    refused(call("bode", "other.npz", "-o", "b.png"), "heading features")
    assert not (tmp_path / "b.png").exists()
    # a plant that runs away: the computation fails, exit code 1
    LatentModel(
        A=np.eye(2),
        B=np.ones((2, 4)),
        input_names=NAMES,
        sensor=StiffnessSensor(K_d=np.ones((3, 3))),
        z_start=np.ones(2),
    ).save(tmp_path / "wild.npz")
    code, _, err = call("bode", "wild.npz", "-o", "b.png")
    assert code in (1, 2)
    # the integrator has a word of its own before the error
    assert err.strip().split("\n")[-1].startswith("cellsys: ")
    assert "Traceback" not in err
    assert not (tmp_path / "b.png").exists()
    assert PolarityLaw().kappa == 1 / 60


# Reduce


def write_csv(path, seed=0, n=3, T=40, bad=None):
    x = np.random.default_rng(seed).standard_normal((T, n)).cumsum(axis=0)
    if bad is not None:
        x[7, 1] = bad
    header = ",".join(["time", *(f"s{i}" for i in range(n))])
    np.savetxt(
        path, np.column_stack([0.5 * np.arange(T), x]), delimiter=",", header=header, comments=""
    )
    return x


def test_reduce_csv_and_npz(call, tmp_path):
    write_csv(tmp_path / "a.csv")
    x = write_csv(tmp_path / "b.csv", 1)
    np.savez(tmp_path / "b.npz", x=x, dt=0.5)
    code, out, _ = call("reduce", "a.csv", "b.npz", "--order", 2, "--method", "LeastSquares")
    assert code == 0
    assert "written: model.npz" in out
    model = LatentModel.load(tmp_path / "model.npz")
    direct = reduce(
        snapshots([tmp_path / "a.csv", tmp_path / "b.npz"]), order=2, method=LeastSquares()
    )
    assert np.array_equal(model.A, direct.A)
    code, out, _ = call(
        "reduce", "a.csv", "--order", 2, "--method", "LeastSquares", "-o", "x/y", "--json"
    )
    assert code == 0
    assert json.loads(out)["order"] == 2
    assert (tmp_path / "x" / "y.npz").exists()


def test_reduce_run_folder(call, run_folder, tmp_path):
    code, out, err = call("reduce", run_folder, "--order", 3, "-o", "m.npz")
    assert (code, err) == (0, "")
    assert "verdict: order 3: no held-out run: training error only" in out
    code, out, _ = call("poles", "m.npz")
    assert code == 0
    assert "verdict: order 3" in out


def test_reduce_refuses(call, run_folder, tmp_path):
    write_csv(tmp_path / "a.csv")
    write_csv(tmp_path / "nan.csv", bad=np.nan)
    (tmp_path / "empty").mkdir()
    least = ("--method", "LeastSquares")
    kept = sorted(p.name for p in tmp_path.iterdir())
    for arguments, words in (
        (("a.csv", "--order", 4, *least), ["order 4", "3"]),
        (("a.csv", "--order", 0, *least), "order"),
        ((run_folder, "--order", 7), ["order 7", "7 samples"]),
        (("a.csv", "--order", 2), "use LeastSquares()"),
        (("a.csv", "--order", 2, "--method", "DMD"), ["--method", "DMD"]),
        (("nan.csv", "--order", 2, *least), "NaN"),
        (("absent.csv", "--order", 2, *least), "absent.csv"),
        (("empty", "--order", 2), "not a complete cellsys run"),
        (("a.csv", run_folder, "--order", 2, *least), "run"),
        (("a.txt", "--order", 2, *least), "a.txt"),
        (("a.csv", "--order", 2, *least, "--dt", 3), "sampled every"),
        (("a.csv", "--order", 2, *least, "--dt", "nan"), "dt"),
    ):  # fmt: skip
        refused(call("reduce", *arguments), words)
        assert sorted(p.name for p in tmp_path.iterdir()) == kept, arguments
    (tmp_path / "m.npz").mkdir()
    refused(call("reduce", "a.csv", "--order", 2, *least, "-o", "m.npz"), "m.npz")
    assert not list((tmp_path / "m.npz").iterdir())
    assert not list(tmp_path.glob(".*"))


def test_partial_run_is_no_run(call, run_folder, tmp_path):
    import shutil

    partial = tmp_path / "r.partial"
    shutil.copytree(run_folder, partial)
    (partial / "run.json").unlink()
    refused(call("reduce", partial, "--order", 2), "not a complete cellsys run")


# Lists


def test_effects_and_schema(call, tmp_path):
    code, out, _ = call("effects")
    assert code == 0
    for name in ("focal_adhesion", "lamellipodium", "matrix_elasticity"):
        assert name in out
    code, out, _ = call("effects", "--json")
    rows = json.loads(out)
    assert all(row["source"] and row["unit"] for row in rows)
    (tmp_path / "s.toml").write_text(TINY)
    code, out, _ = call("effects", "s.toml", "--json")
    assert code == 0
    assert len(json.loads(out)) >= 8
    code, out, _ = call("schema")
    assert code == 0
    assert json.loads(out)
    assert '"duration"' in out


# The whole path


@pytest.mark.slow
def test_run_writes_a_study_and_prints_its_verdict(call, tmp_path):
    (tmp_path / "s.toml").write_text(TINY)
    code, out, err = call("run", "s.toml", "--order", 4, "--workers", 1)
    assert code == 0
    (plan,) = err.splitlines()
    assert re.match(
        r"8 full-order runs of up to 40 s, then models: about \d+ s and .* on disk", plan
    )
    assert "What these models can be trusted for" in out
    folder = tmp_path / "out" / "s"
    assert (folder / "report.html").exists()
    code, out, err = call("run", "s.toml", "--order", 4, "--workers", 1, "--json", "--quiet")
    assert (code, err) == (0, "")
    assert json.loads(out)["scene"] == "tiny"
    # the model it wrote goes on to the other commands
    code, out, _ = call("poles", folder / "model.npz", "--json")
    assert len(json.loads(out)["poles"]) == 4


def environment():
    paths = [str(Path(cellsys.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in paths if p)}


def test_exit_codes_of_a_real_process(tmp_path):
    def run(*arguments):
        return subprocess.run(
            [sys.executable, "-m", "cellsys", *arguments],
            cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=120,
            check=False,
        )  # fmt: skip

    (tmp_path / "s.toml").write_text(tiny(replace={"volume = {}": "volum = {}"}))
    got = run("run", "s.toml")
    assert got.returncode == 2
    assert got.stdout == ""
    assert got.stderr.count("\n") == 1
    assert "did you mean 'volume'" in got.stderr
    assert run("schema").returncode == 0


@pytest.mark.slow
def test_interrupt_says_how_to_go_on(tmp_path):
    """Ctrl-C on a terminal reaches the workers as well: no tracebacks, no run called complete."""
    (tmp_path / "s.toml").write_text(tiny(replace={'"40 s"': '"4000 s"', "runs = 3": "runs = 2"}))
    process = subprocess.Popen(
        [sys.executable, "-m", "cellsys", "run", "s.toml", "-o", "out"],
        cwd=tmp_path, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
        # A shell that runs the tests in the background hands down SIGINT as ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    runs, deadline = tmp_path / "out" / "runs", time.monotonic() + 60
    while not list(runs.glob("*.partial/header.json")) and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Traceback" not in err
    assert "interrupted" in err
    assert "--resume" in err
    assert out == ""
    assert all(p.suffix == ".partial" for p in runs.iterdir())
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["runs"]


@pytest.mark.slow
def test_cost_of_a_disc_and_of_a_chain(call, tmp_path):
    """Table, figure, files and the cheapest setting, on both kinds of scene."""
    (tmp_path / "s.toml").write_text(TINY)
    chain = (Path(cellsys.__file__).parents[1] / "examples" / "crawler.toml").read_text()
    (tmp_path / "c.toml").write_text(chain.replace('"12 s"', '"1 s"'))
    for name, method in (("s", "LinearlyImplicit"), ("c", "LSODA")):
        code, out, err = call(
            "cost", f"{name}.toml", "--probe", 1, "--error", 0.1, "-o", "out", "--json"
        )
        assert code == 0, err
        found = json.loads(out)
        assert method in {p["setup"] for p in found["points"]}
        assert found["integrator"]
        assert found["held_out"] <= 0.1
    assert {p.suffix for p in (tmp_path / "out").iterdir()} == {".csv", ".json", ".png"}
    refused(call("run", "c.toml", "--error", 0.01), "chain", code=2)


@pytest.mark.slow
def test_run_within_an_error_takes_the_step_that_meets_it(call, tmp_path):
    (tmp_path / "s.toml").write_text(TINY)
    code, out, err = call("run", "s.toml", "--order", 4, "--workers", 1, "--error", 0.2)
    assert code == 0, err
    assert re.search(r"motion error 0\.2: (BDF2|RKC|LinearlyImplicit)\(", err)
    assert "report:" in out
