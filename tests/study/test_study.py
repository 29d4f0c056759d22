"""The study on a tiny scene: what it writes, reuses and refuses; runs resume bit for bit."""

import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import time
from html.parser import HTMLParser
from pathlib import Path

import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")

import tomllib

import cellsys as cs
from cellsys.errors import CellsysError, FileFormatError, ParameterError, RankError
from cellsys.observe import heading_deg
from cellsys.scene import Scene, run_scene
from cellsys.store import RunReader, load_archive
from cellsys.study.files import plain
from cellsys.study.plan import study_plan
from tests.study.scenes import TINY, tiny


def scene(text=TINY):
    return Scene.parse(tomllib.loads(text))


def refuse_constant(name):
    raise ValueError(f"{name} is not JSON")


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("study") / "out"
    stages = []
    result = cs.study(
        scene(),
        out,
        order=4,
        workers=1,
        cache=out / "runs",
        progress=lambda stage, share: stages.append((stage, share)),
    )
    return result, out, stages


def test_what_is_written(done):
    result, out, _ = done
    assert sorted(p.name for p in out.iterdir()) == [
        "figures", "model.npz", "model_equivariant.npz", "report.html", "run.npz", "runs",
        "summary.json",
    ]  # fmt: skip
    assert {p.name for p in (out / "figures").iterdir()} == {
        "bode.png", "cell_and_matrix.png", "charges.png", "displacement_field.png",
        "error_against_order.png",
        "polarity.png", "pole_map.png", "traction_field.png",
    }  # fmt: skip
    for picture in (out / "figures").iterdir():
        assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
        assert picture.stat().st_size > 5000
    model = cs.LatentModel.load(out / "model.npz")
    assert np.array_equal(model.A, result.model.A)
    assert model.card == result.model.card
    cell = cs.LatentModel.load(out / "model_equivariant.npz")
    assert cell.dynamics.norm() <= 1.0 + 1e-12
    assert cell.card.verdict in (out / "report.html").read_text("utf-8")
    arrays, meta = load_archive(out / "run.npz", "run", 1)
    assert np.array_equal(arrays["x"], result.run.x)
    assert np.array_equal(arrays["p"], result.run.p)
    assert meta["label"] == "tiny"
    assert not list(out.rglob("*.partial"))
    assert not list(out.rglob(".*"))


def test_summary_is_strict_json_and_says_what_the_model_is_worth(done):
    result, out, _ = done
    text = (out / "summary.json").read_text()
    table = json.loads(text, parse_constant=refuse_constant)
    assert table["scene"] == "tiny"
    assert len(table["poles"]) == 4
    assert table["trust"].startswith("What these models can be trusted for: the equivariant model:")
    assert "PCR: order 4: held out" in table["trust"]
    assert set(table["card"]["held_out"]) == {"cells", "matrix"}
    row = table["card"]["held_out"]["cells"]
    assert row["nothing moves"] == 1.0
    assert 0 < row["floor"] < 1
    assert table["margins"]["gain_margin_on_kappa"] is not None
    assert set(table["loop"]["sensor_error_of_g"]) == {"training", "held_out", "constant_direction"}
    assert [r["order"] for r in table["orders"] if r["method"] == "PCR"] == [4, 5, 10, 20]
    assert table["step_residual_share"]["cell1.position"] < 0.05
    assert table["wall_time_s"] > 0
    assert "worse than" in str(result) or "better than" in str(result)
    assert table["trust"] in result.report()


class Sources(HTMLParser):
    def __init__(self):
        super().__init__()
        self.found, self.tags = [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.found += [v for k, v in attrs if k in ("src", "href", "srcset", "data", "action")]


def test_report_is_one_self_contained_file(done):
    _, out, _ = done
    text = (out / "report.html").read_text(encoding="utf-8")
    parser = Sources()
    parser.feed(text)
    assert len(parser.found) == 8
    assert all(s.startswith("data:image/png;base64,") for s in parser.found)
    assert not {"script", "link", "iframe"} & set(parser.tags)
    assert "url(" not in text
    assert not re.search(r"https?://", text)
    # the verdict stands beside the poles, the loop and the plant
    assert text.count("order 4: held out its error on cells") >= 3
    assert "gain margin: factor on kappa" in text
    assert str(out) not in text


def test_names_are_escaped_in_the_report(done, tmp_path):
    from cellsys.study.report import write_report

    result, out, _ = done
    named = dataclasses.replace(
        result, scene=dataclasses.replace(result.scene, name="<b>a & b</b><script>")
    )
    figures = {p.stem: p for p in (out / "figures").iterdir()}
    write_report(named, figures, tmp_path / "r.html")
    assert "<script>" not in (tmp_path / "r.html").read_text()


def test_progress_names_its_stages(done):
    _, _, stages = done
    assert list(dict.fromkeys(s for s, _ in stages)) == [
        "full-order runs", "basis", "reduced models", "loop", "equivariant", "report",
    ]  # fmt: skip
    assert all(0 <= share <= 1 for _, share in stages)
    for name in ("full-order runs", "basis", "reduced models", "loop", "report"):
        assert [share for s, share in stages if s == name][-1] == 1.0


@pytest.mark.slow
def test_second_call_reuses_the_runs_and_gives_the_same_numbers(done):
    result, out, _ = done
    runs = {p: p.stat().st_mtime_ns for p in (out / "runs").rglob("*.*")}
    again = cs.study(scene(), out, order=4, workers=1, cache=out / "runs")
    assert {p: p.stat().st_mtime_ns for p in (out / "runs").rglob("*.*")} == runs
    assert np.array_equal(again.model.A, result.model.A)
    assert np.array_equal(again.poles.error_bound, result.poles.error_bound)
    assert again.margins.gain_margin == result.margins.gain_margin
    # another order uses the same runs
    other = cs.study(scene(), out, order=3, workers=1, cache=out / "runs")
    assert other.model.order == 3
    kept = {p: p.stat().st_mtime_ns for p in (out / "runs").rglob("*.npy")}
    assert kept == {p: t for p, t in runs.items() if p.suffix == ".npy"}


@pytest.mark.slow
def test_a_damaged_coordinate_file_is_made_again(done):
    result, out, _ = done
    (path,) = (out / "runs").rglob("coordinates.npz")
    path.write_bytes(path.read_bytes()[:1000])
    again = cs.study(scene(), out, order=4, workers=1, cache=out / "runs")
    assert np.array_equal(again.model.A, result.model.A)
    load_archive(path, "coordinates", 1)


def test_loop_errors_are_those_of_the_runs(done):
    result, _, _ = done
    gap = heading_deg(result.reduced.p[:, 0]) - heading_deg(np.asarray(result.run.p)[:, 0])
    table = result.summary["loop"]["heading_error_deg"]
    assert abs(table["rms"] - np.sqrt(np.mean(gap**2))) < 1e-9
    assert abs(table["end"] - gap[-1]) < 1e-9
    # both start from the scene's heading
    assert np.allclose(result.reduced.p[0, 0], result.run.p[0, 0])


@pytest.mark.slow
def test_without_polarity_there_is_no_loop_and_the_reason_is_written(tmp_path):
    text = tiny(replace={'polarity = { kappa = "1/60 1/s" }': ""})
    result = cs.study(scene(text), tmp_path / "out", order=3, workers=1)
    assert result.loop is None
    assert result.margins is None
    report = (tmp_path / "out" / "report.html").read_text()
    assert "No loop: the scene has no polarity effect" in report
    assert "no polarity loop: the scene has no polarity effect" in result.report()
    table = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert table["margins"] is None
    assert not (tmp_path / "out" / "figures" / "bode.png").exists()


@pytest.mark.parametrize("order", [0, -1, 2.5, True, float("nan")])
def test_orders_that_are_none(order, tmp_path):
    with pytest.raises(ParameterError, match="order"):
        cs.study(scene(), tmp_path / "out", order=order)
    assert not (tmp_path / "out").exists()


def test_an_order_beyond_what_the_runs_can_span_is_refused_before_they_are_run(tmp_path):
    began = time.perf_counter()
    with pytest.raises(RankError, match="21"):
        cs.study(scene(), tmp_path / "out", order=500, workers=1)
    assert time.perf_counter() - began < 1.0
    assert not (tmp_path / "out").exists()


def test_out_must_be_a_folder(tmp_path):
    (tmp_path / "taken").write_text("mine")
    with pytest.raises((CellsysError, OSError), match="taken"):
        cs.study(scene(), tmp_path / "taken", order=3)
    assert (tmp_path / "taken").read_text() == "mine"


def test_plain_values():
    got = plain({"a": np.float64(1.5), "b": (np.inf, -np.inf, np.nan), 3: np.int64(4), "c": None,
                 "d": np.bool_(True), "e": np.arange(3), "f": "text"})  # fmt: skip
    assert json.loads(json.dumps(got, allow_nan=False)) == {
        "a": 1.5, "b": ["inf", "-inf", "nan"], "3": 4, "c": None, "d": True, "e": [0, 1, 2],
        "f": "text",
    }  # fmt: skip


# Resume

KILLED = """
import os, sys, tomllib
import cellsys.store.runs as store
from cellsys.scene import Scene, run_scene
written = store.RunWriter.checkpoint
def checkpoint(self, arrays, metadata):
    written(self, arrays, metadata)
    os.kill(os.getpid(), 9)
store.RunWriter.checkpoint = checkpoint
run_scene(Scene.parse(tomllib.loads(sys.stdin.read())), sys.argv[1])
"""


def long_scene(kinetics):
    adhesion = f'focal_adhesion = {{ kinetics = "{kinetics}" }}'
    return tiny(
        replace={
            'duration = "40 s"\nsample = "5 s"\nseed': 'duration = "40 s"\nsample = "0.5 s"\nseed',
            'focal_adhesion = { kinetics = "clutch" }': adhesion,
        }
    )


@pytest.mark.parametrize("kinetics", ["clutch", "switching"])
def test_a_killed_run_goes_on_bit_for_bit(kinetics, tmp_path):
    text = long_scene(kinetics)
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path / "runs")],
        input=text.encode(), capture_output=True, timeout=120, check=False,
    )  # fmt: skip
    assert killed.returncode == -signal.SIGKILL, killed.stderr.decode()
    left = list((tmp_path / "runs").iterdir())
    assert [p.suffix for p in left] == [".partial"]
    with pytest.raises(FileFormatError):
        RunReader(left[0])
    steps = []
    resumed = run_scene(scene(text), tmp_path / "runs", progress=steps.append)
    assert 0 < len(steps) < 80  # it went on, it did not start again
    fresh = run_scene(scene(text))
    for name in ("x", "eta", "u", "p", "d", "amplitude", "eta_start"):
        assert np.array_equal(getattr(resumed, name), getattr(fresh, name)), name
    assert resumed.events == fresh.events
    assert not list((tmp_path / "runs").glob("*.partial"))


@pytest.mark.slow
def test_study_discards_partial_runs_unless_told_to_resume(tmp_path):
    text = long_scene("clutch")
    out = tmp_path / "out"
    subprocess.run(
        [sys.executable, "-c", KILLED, str(out / "runs")],
        input=text.encode(), capture_output=True, timeout=120, check=False,
    )  # fmt: skip
    partial = next((out / "runs").glob("*.partial"))
    stamp = (partial / "header.json").stat().st_mtime_ns
    assert os.path.exists(partial / "checkpoint.npz")
    result = cs.study(scene(text), out, order=3, workers=1, resume=True)
    folder = Path(str(partial).removesuffix(".partial"))
    assert (folder / "header.json").stat().st_mtime_ns == stamp  # the same folder, renamed
    fresh = run_scene(scene(text))
    assert np.array_equal(result.run.x, fresh.x)


def test_a_scene_without_training_is_run_and_read_out_only(tmp_path):
    text = tiny(replace={TINY[TINY.index("[training]") :]: ""})
    short = scene(text)
    assert not short.learn
    result = cs.study(short, tmp_path / "out")
    assert not list((tmp_path / "out").glob("model*.npz"))
    assert "[training]" in str(result)
    plan, learned = study_plan(short), study_plan(short, learn=True)
    assert (plan.runs, plan.learns) == (1, False)
    # itself, 8 + 2 of the plan, 3 floors
    assert (learned.runs, learned.learns) == (14, True)
    assert learned.seconds > plan.seconds
    made = sum(f.stat().st_size for f in (tmp_path / "out" / "runs").rglob("*.npy"))
    assert 0.5 < made / plan.bytes < 1.5
    assert "1 full-order run of" in str(plan)
    with pytest.raises(ParameterError, match="exactly one steered cell"):
        study_plan(cs.load_scene("passive_matrix"), learn=True)


def test_models_are_learned_where_the_scene_has_a_training_table():
    assert study_plan(scene()).learns
    assert not study_plan(scene(), learn=False).learns
