"""Scenes without a model of their own: several cells, none, none that is steered."""

import dataclasses
import json
import sys
import tomllib

import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")

import cellsys as cs
from cellsys.errors import ParameterError
from cellsys.figures import save_png
from cellsys.observe import alone_scenes, observe_neighbours
from cellsys.scene import Scene, run_scene
from cellsys.scene.variants import without
from cellsys.store import load_archive
from cellsys.study import cells as _cells  # noqa: F401  loaded, so that it can be watched
from cellsys.study.leave_one_out import leave_one_out
from cellsys.system import Block, Layout
from cellsys.trajectory import ErrorEstimate, Trajectory
from tests.cell.runs import model as trained
from tests.study.scenes import TINY, tiny

PAIR = (
    '[[cells]]\nposition = ["-6 um", "0 um"]\npolarity = "60 deg"\nradius = "4 um"\n'
    '[[cells]]\nposition = ["6 um", "0 um"]\npolarity = "-90 deg"\nradius = "4 um"\n[effects]'
)
ONE = '[[cells]]\nposition = ["0 um", "0 um"]\npolarity = "60 deg"\nradius = "5 um"\n'


def scene(text):
    return Scene.parse(tomllib.loads(text))


def pair(**more):
    return scene(tiny(replace={ONE: "", "[effects]": PAIR, **more}))


@pytest.mark.slow
def test_several_cells_are_run_beside_each_alone(tmp_path):
    result = cs.study(pair(), tmp_path / "out")
    files = {p.name for p in (tmp_path / "out").iterdir()}
    assert files == {"run.npz", "summary.json", "figures", "report.html", "runs"}
    table = json.loads((tmp_path / "out" / "summary.json").read_text())
    # by hand, from the same functions on the same scenes
    run, *alone = (run_scene(s) for s in (pair(), *alone_scenes(pair())))
    wanted = observe_neighbours(run, alone, cs.build(pair()).matrix.position)
    assert list(table["pairs"]) == ["1-2"]
    assert table["pairs"]["1-2"]["gap_speed_nm_s"] == pytest.approx(
        wanted[0, 1].means()["gap_speed_nm_s"]
    )
    assert set(table["cells"]) == {"cell1", "cell2"}
    assert table["cells"]["cell1"] != table["cells"]["cell2"]
    assert "one of them alone" in str(result)
    assert "--model" in str(result)
    arrays, _ = load_archive(tmp_path / "out" / "run.npz", "run", 1)
    assert np.array_equal(arrays["x"], run.x)
    text = result.report()
    for words in ("cell2:", "crawl, um", "cells 1 and 2: edge gap", "integrator's error"):
        assert words in text
    assert {p.stem for p in (tmp_path / "out" / "figures").iterdir()} == {
        "cells", "centres", "displacement_field", "gaps",
    }  # fmt: skip


@pytest.mark.slow
def test_a_model_of_one_cell_runs_beside_them(tmp_path):
    given = trained()
    apart = pair(**{'sample = "5 s"\nseed': 'sample = "10 s"\nseed'})
    file = given.save(tmp_path / "model.npz")
    result = cs.study(apart, tmp_path / "out", model=file)
    found = result.reduced
    assert found.steered
    small = found.run
    assert np.array_equal(small.t, result.run.t)
    u, v = (r.block("matrix.displacement") for r in (result.run, small))
    assert found.matrix == pytest.approx(np.linalg.norm(v - u) / np.linalg.norm(u))
    assert 0 < found.cells < 1
    assert 0 < found.superposed < found.matrix  # of full-order cells: nothing reduced in it
    table = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert table["reduced"]["error_on_matrix"] == pytest.approx(found.matrix)
    _ = found.latent.error  # made before it is told, however slow the machine is
    assert "two steps of the field" in result.report()
    odd = pair(**{'sample = "5 s"\nseed': 'sample = "4 s"\nseed'})
    with pytest.raises(ParameterError, match=r"sampled every 4 s, .* set sample = '10 s'"):
        cs.study(odd, tmp_path / "b", model=given)
    with pytest.raises(ParameterError, match="learns its own"):
        cs.study(scene(TINY), tmp_path / "c", model=given)
    plain = cs.LatentModel(A=-np.eye(2))
    with pytest.raises(ParameterError, match="got LatentModel"):
        cs.study(pair(), tmp_path / "d", model=plain)
    # refused before anything is run or written
    assert not any((tmp_path / name).exists() for name in "bcd")


@pytest.mark.slow
def test_commanded_cells_follow_their_commands(tmp_path):
    told = {
        "[effects]": PAIR.replace(
            "[effects]",
            '[commands]\nheading = { times = ["0 s", "40 s"], values = ["0 deg", "90 deg"] }\n'
            "[effects]",
        ),
        'polarity = { kappa = "1/60 1/s" }\n': "",
        'sample = "5 s"\nseed': 'sample = "10 s"\nseed',
    }
    commanded = scene(tiny(replace={ONE: "", **told}))
    found = cs.study(commanded, tmp_path / "out", model=trained()).reduced
    assert not found.steered
    angle = np.degrees(np.arctan2(found.run.p[1:, 0, 1], found.run.p[1:, 0, 0]))
    np.testing.assert_allclose(angle, [11.25, 33.75, 56.25, 78.75], atol=1e-9)  # step means


@pytest.mark.slow
def test_it_ends_at_contact_and_controls_are_as_long(tmp_path):
    close = PAIR.replace("-6 um", "-4.2 um").replace('"6 um"', '"4.2 um"')
    close = close.replace('"60 deg"', '"0 deg"').replace('"-90 deg"', '"180 deg"')
    text = tiny(replace={ONE: "", "[effects]": close})
    text = text.replace('duration = "40 s"\nsample = "5 s"\nseed',
                        'until = "contact"\nduration = "400 s"\nsample = "2 s"\nseed')  # fmt: skip
    result = cs.study(scene(text), tmp_path / "out")
    touch = result.run.events[-1]
    assert touch.name == "contact"
    assert result.run.t[-1] < touch.time < 400
    assert f"touch at {touch.time:.0f} s, the run ends there" in str(result)
    assert len(result.pairs[0, 1].gap) == len(result.run)


@pytest.mark.parametrize(
    ("name", "files"),
    [
        ("passive_matrix", {"displacement_field"}),
        ("isolated_membrane", {"cells", "centres"}),
    ],
)
def test_presets_without_a_steered_cell(name, files, tmp_path):
    short = dataclasses.replace(cs.load_scene(name), duration=10.0, sample=5.0)
    result = cs.study(short, tmp_path / "out")
    assert {p.stem for p in (tmp_path / "out" / "figures").iterdir()} == files
    assert "exactly one steered cell on a matrix" in str(result)
    table = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert table["pairs"] == {}
    assert bool(table["matrix"]) == (name == "passive_matrix")


RELAXED = """
name = "let go"
duration = "400 s"
sample = "5 s"
[matrix]
diameter = "30 um"
nodes = 300
[effects]
drag = {}
matrix_elasticity = { law = "buckling" }
foundation = {}
[effects.external_load]
force = "1000 pN"
radius = "5 um"
history = { times = ["0 s", "50 s", "100 s", "150 s"], values = [0, 1, 1, 0] }
"""


def drawn_axes(monkeypatch, tmp_path, text):
    """Read-outs of a study, its text, and the axes of the field as it was drawn."""
    kept = {}

    def keep(figure, path):
        kept[path.stem] = figure
        return save_png(figure, path)

    # the room exports a function of its own name, which hides it from a dotted path
    monkeypatch.setattr(sys.modules["cellsys.study.fields"], "save_png", keep)
    result = cs.study(scene(text), tmp_path / "out")
    axes = [a for a in kept["displacement_field"].axes if a.get_xlabel()]
    return result, axes


def test_a_field_below_its_own_error_is_not_drawn(monkeypatch, tmp_path):
    """Pulled aside and let go: at the end nothing is left but the stepping's error."""
    result, (greatest, end) = drawn_axes(monkeypatch, tmp_path, RELAXED)
    row = result.summary["matrix"]
    u = np.linalg.norm(result.run.block("matrix.displacement"), axis=2)
    assert row["displacement_max_um"] == u.max() > 50 * u[-1].max() > 0
    assert row["displacement_max_at_s"] == result.run.t[u.max(axis=1).argmax()] < 150
    assert row["displacement_rms_end_um"] == pytest.approx(np.sqrt(np.mean(u[-1] ** 2)))
    # the error bound holds against steps a tenth as long while the load rises, and is not idle
    fine = cs.run_scene(
        dataclasses.replace(result.scene, stepper="BDF2", step=0.125, duration=60.0)
    )
    both = [r.block("matrix.displacement")[: len(fine)] for r in (fine, result.run)]
    off = np.linalg.norm(both[0] - both[1], axis=2).max()
    assert u[-1].max() < row["matrix_error_um"]
    # The estimate sums what the laws leave over, whatever its sign: 55 times the error here.
    assert off < row["matrix_error_um"] < 100 * off
    assert greatest.get_title() == f"greatest, t = {row['displacement_max_at_s']:g} s"
    assert len(greatest.collections) == 2  # dots and arrows
    assert end.get_title() == "at the end, t = 400 s"
    assert not end.collections
    assert "by more than the error of" in end.texts[0].get_text()
    text = result.report()
    (told,) = [line for line in text.splitlines() if "displacement max, um" in line]
    assert float(told.split()[-1]) == pytest.approx(row["displacement_max_um"], rel=1e-3)
    assert "below its error, " in text
    assert "below its error, " in (tmp_path / "out" / "report.html").read_text()


def test_leaving_an_effect_out_is_judged_over_the_run():
    """At the end of this one nothing is left with or without the foundation."""
    let_go = dataclasses.replace(scene(RELAXED), sample=10.0)
    whole = {w.effect: w for w in leave_one_out(let_go)}["foundation"]
    run, bare = run_scene(let_go), run_scene(without(let_go, "foundation")[0])
    u, v = (r.block("matrix.displacement") for r in (run, bare))
    assert whole.motion == pytest.approx(np.linalg.norm(v - u) / np.linalg.norm(u))
    naive = np.linalg.norm(v[-1] - u[-1]) / np.linalg.norm(u[-1])
    assert naive > 3 * whole.motion  # what is left of both, over what is left of one
    peaks = [np.linalg.norm(w, axis=2).max() for w in (u, v)]
    changed = whole.changes["matrix_displacement_max_um"]
    assert changed == pytest.approx(peaks[1] / peaks[0] - 1)
    assert np.isnan(whole.changes["matrix_displacement_rms_end_um"])  # below its error
    assert f"the matrix by {100 * abs(changed):.0f} %" in str(whole)


def test_a_field_that_is_greatest_at_the_end_is_drawn_once(monkeypatch, tmp_path):
    held = RELAXED.replace('"400 s"', '"40 s"')
    result, (only,) = drawn_axes(monkeypatch, tmp_path, held)
    assert only.get_title() == "greatest, t = 40 s"
    assert len(only.collections) == 2
    assert "below its error" not in result.report()


def test_the_error_of_a_block_is_kept_in_one_place():
    states = Layout([Block("a.position", (2, 3), "um"), Block("b", (2,), "1")])
    x = np.zeros((4, 8))
    x[2] = [3.0, 0, 4.0, 0, 0, 0, 0, 1000.0]
    bare = Trajectory(t=np.arange(4.0), x=x, states=states)
    eps = 4 * np.finfo(float).eps  # the rounding of the states themselves
    assert bare.error_of("a.position") == pytest.approx(5 * eps)
    assert bare.error_of("b") == pytest.approx(1000 * eps)
    found = ErrorEstimate(np.array([0.0, 0.3, 0.4, 0, 0, 0, 0.01, 0.02]), np.ones(8), "given")
    known = dataclasses.replace(bare, estimator=lambda: found)
    assert known.error_of("a.position") == pytest.approx(0.5)
    assert known.error_of("b") == 0.02


def test_a_cell_without_a_lamellipodium_is_run_too(tmp_path):
    text = tiny(replace={'lamellipodium = { force = "600 pN" }\n': ""})
    result = cs.study(scene(text), tmp_path / "out")
    assert set(result.summary["cells"]) == {"cell1"}
    assert result.summary["cells"]["cell1"]["contact_radius_end_um"] > 0


@pytest.mark.slow
def test_the_command_takes_a_model(call, tmp_path):
    slower = {'sample = "5 s"\nseed': 'sample = "10 s"\nseed'}
    text = tiny(replace={ONE: "", "[effects]": PAIR, **slower})
    (tmp_path / "pair.toml").write_text(text)
    trained().save(tmp_path / "model.npz")
    code, out, _ = call("run", "pair.toml", "--model", "model.npz")
    assert code == 0
    assert "reduced cells miss" in out
    assert (tmp_path / "out" / "pair" / "report.html").exists()
    code, _, err = call("run", "pair.toml", "--model", "absent.npz")
    assert code == 2
    assert "absent.npz" in err


def test_an_error_is_kept_without_a_matrix_too(call, tmp_path):
    (tmp_path / "free.toml").write_text(
        'extends = "isolated_membrane"\nduration = "10 s"\nsample = "5 s"\n'
    )
    code, out, err = call("run", "free.toml", "--error", "0.05")
    assert code == 0, err
    assert "1 cell, 10 s" in out


@pytest.mark.slow
def test_leaving_out_compares_at_one_time():
    """The whole scene would end at 14 s; without what moves the cells they never touch."""
    close = PAIR.replace("-6 um", "-4.02 um").replace('"6 um"', '"4.02 um"')
    close = close.replace('"60 deg"', '"0 deg"').replace('"-90 deg"', '"180 deg"')
    whole = dataclasses.replace(scene(tiny(replace={ONE: "", "[effects]": close})), sample=2.0)
    ending = dataclasses.replace(whole, until="contact")
    assert run_scene(ending).t[-1] < 20 < whole.duration
    first, second = ({w.effect: w.motion for w in leave_one_out(s)} for s in (whole, ending))
    for name, motion in first.items():
        assert second[name] == pytest.approx(motion, nan_ok=True)
